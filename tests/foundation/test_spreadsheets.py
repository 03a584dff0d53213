"""CSV: no text is a formula, and reading gives back what was written."""

from io import BytesIO

import polars as pl
import pytest

from charms_bench.foundation.spreadsheets import from_csv, in_csv

FORMULAS = ('=HYPERLINK("http://x")', "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "＝1")


@pytest.mark.parametrize("text", FORMULAS)
def test_a_text_that_a_spreadsheet_would_compute_begins_with_an_apostrophe(text: str) -> None:
    written = in_csv(pl.DataFrame({"agent": [text]})).decode()
    assert written.split("\n", 1)[1].lstrip('"').startswith("'")


def test_numbers_and_other_texts_stay_as_they_are() -> None:
    table = pl.DataFrame({"agent": ["idm_mobil", "it's"], "value": [-1.5, 2.0]})
    assert in_csv(table) == b"agent,value\nidm_mobil,-1.5\nit's,2.0\n"


def test_reading_gives_back_every_text() -> None:
    table = pl.DataFrame({"agent": [*FORMULAS, "'=1", "''-1", "'quoted'", "a-b"]})
    read = pl.read_csv(BytesIO(in_csv(table)), infer_schema=False)
    assert from_csv(read)["agent"].to_list() == table["agent"].to_list()
