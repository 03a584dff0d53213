"""Whether the values of the plan's test meet its criteria, cell by cell and as a table."""

from typing import Any

import numpy as np
import polars as pl
from plan_criteria import (
    CHARMS,
    CONFLICTS,
    CRITERIA,
    RULE,
    Criterion,
    Frames,
    Measured,
    undone,
)
from plan_seeds import furthest, mean_of

from charms_bench.report.formatting import NOTHING, write_column
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Column, Table

NOTE = """\
Of several cells, the one is shown whose mean is furthest beyond its limit or closest to it; the
worst seed is that of all of them. The worst seed may be twice a largest value and half a smallest
value, so a range reaches from half its lower end to twice its upper end. Likeness and the faults of
known size are measured by other commands. The CSV file has every cell.
"""
CELLS = {
    **dict.fromkeys(("row", "part"), int),
    **dict.fromkeys(("quantity", "limit", "cell"), str),
    "seeds": int,
    **dict.fromkeys(("mean", "low", "high", "worst", "least", "most", "excess"), float),
    **dict.fromkeys(("mean_holds", "worst_holds"), bool),
}
"""The columns of `judged`; `excess` is by how much the mean exceeds the limit."""


def judged(frames: Frames) -> pl.DataFrame:
    """Every cell of every criterion: the values of the seeds, and whether they meet the limits.

    The worst seed may be twice a largest value and half a smallest value.
    """
    records: list[dict[str, Any]] = []
    for row, criterion in enumerate(CRITERIA):
        found, texts = criterion.measured(frames), criterion.texts
        for part in range(max([len(texts), *(each.part + 1 for each in found)])):
            text = texts[min(part, len(texts) - 1)]
            known = {"row": row, "part": part, "quantity": criterion.quantity, "limit": text}
            cells = [_judged(criterion, text, each) for each in found if each.part == part]
            records += [known | cell for cell in cells or [{}]]
    return pl.DataFrame(records, schema=CELLS).with_columns(pl.selectors.float().round_sig_figs(6))


def _judged(criterion: Criterion, text: str, measured: Measured) -> dict[str, Any]:
    values = measured.values
    largest = 1.0 if criterion.form.endswith("%") else np.inf
    number = mean_of(values) if criterion.signed else mean_of(values, 0.0, largest)
    facts: dict[str, Any] = {"cell": measured.cell, "seeds": len(values)}
    facts |= {"mean": number.value, "low": number.low, "high": number.high}
    if text == "an interval without 0":
        is_apart = number.low is not None and number.low * (number.high or 0.0) > 0
        return facts | {"mean_holds": is_apart}
    low, high = measured.limits or criterion.limits(text)
    excess = _excess(float(values.mean()), low, high)
    facts |= {"least": low, "most": high, "excess": excess, "mean_holds": excess <= 0}
    if len(values) < 2:
        return facts
    worst = furthest(low, high)(values)
    return facts | {"worst": worst, "worst_holds": _excess(worst, low / 2, 2 * high) <= 0}


def _excess(value: float, low: float, high: float) -> float:
    """By how much a value is outside its limits, but for rounding; negative inside."""
    return round(max(low - value, value - high), 9)


def criteria_table(cells: pl.DataFrame) -> str:
    """One row per limit: the cell whose mean exceeds it most, and the worst seed of all cells."""
    records: list[dict[str, Any]] = []
    for (row, part), of_limit in cells.group_by("row", "part", maintain_order=True):
        criterion = CRITERIA[int(str(row))]
        shown = of_limit.sort("excess", descending=True, nulls_last=True).row(0, named=True)
        mean = Number(shown["mean"], shown["low"], shown["high"])
        worst = of_limit["worst"].drop_nulls().to_numpy()
        if len(worst):
            shown["worst"] = furthest(shown["least"], shown["most"])(worst)
        its_own = f": {_text(criterion, Number(shown['most']))}" * (criterion.of is undone)
        records.append(
            {
                "quantity": "" if part else criterion.quantity,
                "limit": shown["limit"] + its_own,
                "aim": "" if part else criterion.aim,
                "cell": shown["cell"] or "",
                "mean of the seeds": _text(criterion, mean),
                "worst seed": _text(criterion, Number(shown["worst"])),
                "mean within the limit": _word(of_limit["mean_holds"]),
                "worst seed within twice": _word(of_limit["worst_holds"]),
            }
        )
    keys = ("quantity", "limit", "aim", "cell")
    table = markdown(Table.plain(records, keys, dict.fromkeys(list(records[0])[4:], "")))
    return table.replace(r"\](", "](") + f"\n{NOTE}"


TRIALS = {"at fault": ".2%", "conflicts caused per 1,000 km": ".0f", "speed, m/s": ".2f"}
"""The means of both traffic models that stand beside the limits that a trial meets."""


def trials_table(values: pl.DataFrame) -> str:
    """The trials of the baselines, those first that meet most limits of the main test.

    Of several, the one comes first with the fewest crashes at fault, then the fastest. `values` has
    one row per traffic model and ego.
    """
    values = values.with_columns(condition=pl.lit("main"))
    records: list[dict[str, Any]] = []
    for (trial,), its in values.group_by("ego", maintain_order=True):
        if trial == RULE:
            continue
        as_ours = its.with_columns(ego=pl.lit(CHARMS))
        cells = judged({"driving": pl.concat([as_ours, values.filter(ego=RULE)])})
        means = its.select("crashed_at_fault", CONFLICTS, "speed_mean").mean().row(0)
        met = cells["mean_holds"].drop_nulls()
        records.append({"trial": trial, "limits met": int(met.sum()), "of": len(met)})
        records[-1] |= dict(zip(TRIALS, means, strict=True))
    found = pl.DataFrame(records).sort(
        pl.col("trial").str.head(3), -pl.col("limits met"), "at fault", -pl.col("speed, m/s")
    )
    forms = {"limits met": ".0f", "of": ".0f", **TRIALS}
    return markdown(Table.plain(found.to_dicts(), ("trial",), forms))


def _text(criterion: Criterion, number: Number) -> str:
    (written,) = write_column(Column("", form=criterion.form), [number])
    interval = f" [{written.interval(', ')}]" if written.low else ""
    is_p = criterion.form == "p" and number.value is not None
    return f"{'p: ' * is_p}{written.value}{interval}"


def _word(holds: pl.Series) -> str:
    known = holds.drop_nulls()
    return ("yes" if known.all() else "no") if len(known) else NOTHING
