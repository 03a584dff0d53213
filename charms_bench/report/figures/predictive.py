"""Posterior predictive checks: what drawn drivers do behind the leaders of held-out drivers."""

import numpy as np
from matplotlib.figure import Figure

from charms_bench.humans.calibrated import Calibration
from charms_bench.humans.held_out import HORIZONS_S, SEED, drawn, starts
from charms_bench.humans.trips import RATE_HZ
from charms_bench.report.figures.drawing import GREY, LINE_STYLES, SERIES, panels
from charms_bench.world.gaps import time_headway
from charms_bench.world.scene import Floats

_RANGES = {"time gap, s": (0.0, 6.0), "acceleration, m/s²": (-2.0, 2.0), "jerk, m/s³": (-1.5, 1.5)}
_BINS = 40


def draw(found: Calibration) -> Figure:
    """Draws distributions of recorded and drawn drivers, and the ranks of recorded gaps."""
    rng = np.random.default_rng(SEED)
    predict = drawn(found.fit, found.noise)
    parts = starts(found.held_out)
    recorded = [_quantities(part.gap[None], part.speed[None]) for part in parts]
    predicted = [predict(part, rng) for part in parts]
    simulated = [_quantities(*each) for each in predicted]
    figure, (*distributions, ranks) = panels(4, 3.3, 3.2)
    for k, (axes, (name, limits)) in enumerate(zip(distributions, _RANGES.items(), strict=True)):
        for values, colour, label in (
            (recorded, GREY, "held-out drivers"),
            (simulated, SERIES[0], "drawn drivers"),
        ):
            every = np.clip(np.concatenate([each[k].ravel() for each in values]), *limits)
            kind = "stepfilled" if colour == GREY else "step"
            options = {"density": True, "histtype": kind, "color": colour, "label": label}
            axes.hist(every, bins=_BINS, range=limits, **options)
        axes.set(xlabel=name, yticks=[])
    distributions[0].legend(frameon=False, fontsize=9)
    for k, horizon_s in enumerate(HORIZONS_S):
        at, both = horizon_s * RATE_HZ, zip(parts, predicted, strict=True)
        rank = np.sort([(gaps[:, at] < part.gap[at]).mean() for part, (gaps, _) in both])
        proportions = np.arange(1, rank.size + 1) / rank.size
        style = {"color": SERIES[k], "linestyle": LINE_STYLES[k], "label": f"{horizon_s} s"}
        ranks.step(rank, proportions, **style)
    ranks.plot([0, 1], [0, 1], color="black", linewidth=0.8)
    ranks.set(xlabel="quantile of the recorded gap", ylabel="proportion")
    ranks.legend(frameon=False, fontsize=9)
    return figure


def _quantities(gaps: Floats, speeds: Floats) -> tuple[Floats, Floats, Floats]:
    """Time gaps, and accelerations and jerks as means over 1 s, of gaps and speeds (M, n)."""
    speeds, gaps = speeds[:, ::RATE_HZ], gaps[:, ::RATE_HZ]
    acceleration = np.diff(speeds, axis=1)
    return time_headway(gaps, speeds), acceleration, np.diff(acceleration, axis=1)
