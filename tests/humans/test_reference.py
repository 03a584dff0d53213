"""Human driving as histograms."""

from pathlib import Path

import make_references
import numpy as np
import pytest
from trios import Row, write_trio

from charms_bench.errors import DataError
from charms_bench.humans.reference import (
    REFERENCES,
    Reference,
    ReferenceSpec,
    histograms,
    read_references,
)

PROJECT = Path(__file__).parents[2]
DATA = PROJECT / "../shared/data"
SHIPPED = sorted(path.stem for path in REFERENCES.glob("*.json"))


def read(folder: Path = Path(), **spec: object) -> Reference:
    (reference,) = read_references([ReferenceSpec.model_validate(spec)], folder)
    return reference


def test_values_are_counted_in_bins_of_a_half_and_the_last_takes_the_rest() -> None:
    (counts,) = np.array(histograms(np.array([0.0, 0.49, 0.5, 49.9, 50.0, 80.0]), np.full(6, 3)))
    assert counts.size == 100
    assert {int(k): int(counts[k]) for k in counts.nonzero()[0]} == {0: 2, 1: 1, 99: 3}


def test_values_are_counted_unit_by_unit() -> None:
    counts = np.array(histograms(np.array([1.0, 2.0, 1.0]), np.array([7, 4, 7])))
    assert [row.nonzero()[0].tolist() for row in counts] == [[4], [2]]
    assert counts[1, 2] == 2


@pytest.mark.parametrize(
    ("name", "unit", "speeds", "headways"), [("i24", 60, 63765, 0), ("us101", 32, 15542, 49)]
)
def test_shipped_references_know_their_independent_units(
    name: str, unit: int, speeds: int, headways: int
) -> None:
    reference = read(name=name)
    assert len(reference.units("speed")) == unit
    assert reference.units("speed").sum() == speeds
    assert reference.units("dhw").sum() == headways


def test_a_label_renames_a_shipped_reference() -> None:
    reference = read(name="us101", label="US-101, congested")
    assert reference.name == "US-101, congested"
    assert np.array_equal(reference.counts("speed"), read(name="us101").counts("speed"))


@pytest.mark.parametrize("name", SHIPPED)
def test_what_is_shipped_says_where_it_is_from_and_what_it_counts(name: str) -> None:
    reference = read(name=name)
    assert reference.name == name
    assert reference.origin
    assert reference.terms
    assert reference.counts("speed") is not None
    assert reference.to_json() == (REFERENCES / f"{name}.json").read_text(encoding="utf-8")


def test_a_quantity_that_was_not_recorded_has_no_counts() -> None:
    assert read(name="i24").counts("dhw") is None


def test_recordings_of_ones_own_are_counted_and_named_as_the_suite_names_them(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine").mkdir()
    write_trio(tmp_path / "mine", [Row(vehicle=1, vx=31.2), Row(vehicle=2, x=120.0)])
    reference = read(tmp_path, recordings="mine")
    assert reference.name == "mine"
    speeds = reference.counts("speed")
    assert speeds is not None
    assert speeds.nonzero()[0].tolist() == [62]  # 31.0 to 31.5
    assert reference.counts("dhw") is None  # nobody changes lanes


def test_a_folder_without_recordings_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="nowhere: cannot be read: No such file or directory"):
        read(tmp_path, recordings="nowhere")


@pytest.mark.skipif(not DATA.exists(), reason=f"no recordings in {DATA}")
def test_the_shipped_histograms_are_made_from_the_recordings(tmp_path: Path) -> None:
    make_references.main(DATA, tmp_path)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert made == {path.name: path.read_bytes() for path in REFERENCES.iterdir()}
