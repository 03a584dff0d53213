"""Says in a few sentences what the run of a suite found, and how sure that is.

Who crashes least is chosen after the results are known. So the p-value of its paired test against
the next agent is multiplied by the number of all pairs that could have been chosen (Bonferroni).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from charms_bench.foundation.words import counted
from charms_bench.report.number import Number
from charms_bench.report.preventable_table import crashed
from charms_bench.report.realism_table import FLOOR, WITHIN_LIMITS
from charms_bench.report.table import Table
from charms_bench.runs.cells import CellRows, title_of
from charms_bench.runs.suite import Suite
from charms_bench.statistics.intervals import CONFIDENCE

CRASHED, SPEED = "crashed_episodes", "speed_mean"
INTERVAL = "95\N{NO-BREAK SPACE}% interval"
NAMED = 3
"""Agents or traffic models that a sentence names at most."""
Cells = Mapping[tuple[str, str], CellRows]
"""By the labels of the ego and of its surroundings."""
Rates = list[tuple[str, Number]]
"""Labels with their proportions of crashed episodes, the smallest first."""


def finding(
    suite: Suite, metrics: Table, realism: Table | None, cells: Callable[[], Sequence[CellRows]]
) -> str:
    """What a run found, in sentences; empty if its table does not say how often egos crash.

    `cells` reads its rows, which only the paired test of egos needs.
    """
    if realism is not None:
        return _nearest(realism)
    places = metrics.places(CRASHED)
    if places is None:
        return ""
    rates = {
        (row.labels[0], title_of(row.labels[1:])): row.numbers[places[0]] for row in metrics.rows
    }
    if any(number.value is None for number in rates.values()):
        return ""
    if len(suite.egos) > 1:
        by_label = {(cell.agent, cell.surroundings): cell for cell in cells()}
        if len(suite.surroundings) > 1:
            return _of_matrix(suite, rates, by_label)
        return _of_egos(suite, rates, by_label) + _speeds(metrics)
    ego = suite.egos[0].title
    found = _sorted((traffic, number) for (_, traffic), number in rates.items())
    return (
        _of_traffics(ego, found, f"{place(suite)}s") if len(found) > 1 else _of_one(ego, found[0])
    )


def _of_egos(suite: Suite, rates: Mapping[tuple[str, str], Number], cells: Cells) -> str:
    found = _sorted((ego, number) for (ego, _), number in rates.items())
    number = found[0][1]
    tied = [name for name, each in found if each.value == number.value]
    if len(tied) == len(found):
        return f"All {len(found)} agents crashed equally often: {_rate(number)} each."
    following = found[len(tied)]
    traffic = suite.surroundings[0].title
    # Of agents that share the lowest rate, the one that is hardest to separate from the next.
    tests = [_paired(cells[following[0], traffic], cells[name, traffic]) for name in tied]
    value, low, high, p = max(tests, key=lambda test: test[-1])
    pairs = _pairs(suite)
    return (
        f"{_listed(tied)} crashed in the fewest episodes: {_rate(number)}"
        f"{' each' * (len(tied) > 1)}. {following[0]} is next with {_rate(following[1])}. The "
        f"difference is {_percent(value)} percentage points ({INTERVAL} {_percent(low)} to "
        f"{_percent(high)}), and the paired test {_verdict(min(1.0, p * pairs))}, corrected for "
        f"{counted(pairs, 'possible pair')})."
    )


def _verdict(p: float) -> str:
    said = "p < 0.001" if p < 0.001 else f"p = {p:z.3f}" if p < 1 else "p = 1"
    return f"{'separates' if p < 1 - CONFIDENCE else 'does not separate'} them ({said}"


def _of_matrix(suite: Suite, rates: Mapping[tuple[str, str], Number], cells: Cells) -> str:
    wins: dict[str, list[str]] = {}
    apart = tied = 0
    for entry in suite.surroundings:
        found = _sorted((ego, each) for (ego, name), each in rates.items() if name == entry.title)
        (best, number), (second, following) = found[:2]
        if number.value == following.value:
            tied += 1
            continue
        wins.setdefault(best, []).append(entry.title)
        *_, p = _paired(cells[second, entry.title], cells[best, entry.title])
        apart += p * _pairs(suite) < 1 - CONFIDENCE
    count, places = len(suite.surroundings), f"{place(suite)}s"
    ranked = sorted(wins.items(), key=lambda each: -len(each[1]))
    sentences = [f"{ego} crashed least in {_listed(where)}" for ego, where in ranked[:NAMED]]
    more = sum(len(where) for _, where in ranked[NAMED:])
    sentences += [f"other agents crashed least in {more} {places}"] if more else []
    sentences += [f"two or more agents share the lowest rate in {tied} of {count}"] if tied else []
    tested = count - tied
    if not tested:
        return f"In each of the {count} {places}, two or more agents share the lowest crash rate."
    verdict, where = "separates", f"{apart} of the {tested} {places}"
    if tested == 1:
        verdict, where = verdict if apart else "does not separate", f"the one {place(suite)}"
    return (
        f"{'; '.join(sentences)}. The paired test {verdict} the "
        f"agent that crashed least from the next in {where} without a tie "
        f"(p < 0.05, corrected for {_pairs(suite):,} possible pairs)."
    )


def _of_traffics(ego: str, found: Rates, places: str) -> str:
    (least, low), (most, high) = found[0], found[-1]
    if low.value == high.value:
        return f"{ego} crashed equally often in all {len(found)} {places}: {_rate(low)}."
    is_apart = low.high is not None and high.low is not None and low.high < high.low
    verdict = "do not overlap." if is_apart else "overlap: the difference may be chance."
    return (
        f"{ego} crashed most often in {most}: {_rate(high)}; and least often in {least}: "
        f"{_rate(low)}. The two intervals {verdict}"
    )


def _of_one(ego: str, found: tuple[str, Number]) -> str:
    traffic, number = found
    if number.value:
        return f"{ego} crashed in {_rate(number)} in {traffic}."
    limit = "" if number.high is None else f" The {INTERVAL} ends at {_percent(number.high)} %."
    return (
        f"{ego} crashed in none of {counted(number.n or 0, 'episode')} in {traffic}.{limit} "
        "`charms-bench rare` estimates smaller probabilities."
    )


def _nearest(realism: Table) -> str:
    """How often one traffic model is nearest to human driving, by the marks of the table."""
    wins: Counter[str] = Counter()
    models = [row for row in realism.rows if row.labels[0] not in (FLOOR, WITHIN_LIMITS)]
    tested = 0
    for place in range(len(realism.columns)):
        tested += sum(row.numbers[place].value is not None for row in models) > 1
        wins.update(row.labels[0] for row in models if row.numbers[place].marked)
    if not tested:
        return ""
    separated = wins.total()
    if not separated:
        return (
            f"In none of {tested} comparisons with human driving is one traffic model separated "
            "from all others as the nearest."
        )
    who = _listed([f"{name} in {count}" for name, count in wins.most_common()], len(wins))
    return (
        f"In {separated} of {tested} comparisons with human driving, one traffic model is nearest "
        f"and separated from all others: {who}."
        + (f" In the other {tested - separated}, none is." if tested > separated else "")
    )


def _speeds(metrics: Table) -> str:
    """The range of mean speeds, because slow driving crashes less."""
    places = metrics.places(SPEED)
    numbers = metrics.column(places[0]) if places else []
    known = [number.value for number in numbers if number.value is not None]
    if len(known) < 2:
        return ""
    return f" Mean speeds range from {min(known):z.1f} to {max(known):z.1f} m/s."


def _paired(first: CellRows, second: CellRows) -> tuple[float, float, float, float]:
    """The difference of crashed episodes, its interval and the p-value of the paired test."""
    from charms_bench.statistics.paired import mcnemar, tango  # imports scipy.stats

    ours, theirs = crashed(first), crashed(second)
    only = int((ours & ~theirs).sum()), int((theirs & ~ours).sum())
    return (only[0] - only[1]) / ours.size, *tango(*only, ours.size), mcnemar(*only)


def _pairs(suite: Suite) -> int:
    """How many pairs of egos in the same surroundings there are."""
    return len(suite.surroundings) * len(suite.egos) * (len(suite.egos) - 1) // 2


def place(suite: Suite) -> str:
    """What the surroundings of a suite are."""
    if suite.roads:
        return "road" if len(suite.traffics) == 1 else "road and traffic model"
    of_scenarios = all(entry.traffic.scenario for entry in suite.traffics)
    return "scenario" if of_scenarios else "traffic model"


def _sorted(rates: Iterable[tuple[str, Number]]) -> Rates:
    return sorted(rates, key=lambda each: each[1].value or 0.0)


def _rate(number: Number) -> str:
    said = f"{_percent(number.value or 0.0)}\N{NO-BREAK SPACE}%"
    if number.n:
        said += f" of {counted(number.n, 'episode')}"
    if number.low is None or number.high is None:
        return said
    return f"{said} ({INTERVAL} {_percent(number.low)} to {_percent(number.high)})"


def _percent(proportion: float) -> str:
    digits = 2 if 0 < abs(proportion) < 0.001 else 1
    return f"{100 * proportion:z.{digits}f}".replace("-", "−")


def _listed(names: Sequence[str], most: int = NAMED) -> str:
    if len(names) > most:
        names = [*names[:most], f"{len(names) - most} more"]
    *firsts, last = names
    return f"{', '.join(firsts)} and {last}" if firsts else last
