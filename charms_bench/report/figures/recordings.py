"""The content of a folder of recordings, as a figure."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from charms_bench.humans.survey import Learnable, Survey
from charms_bench.report.figures.drawing import GREY, SERIES, panels
from charms_bench.world.following_bins import FOLLOWING_RANGE_M


def draw(found: Survey, learnable: Mapping[str, Learnable]) -> Figure:
    """Draws speeds, distances while following and, for each sampler, the proportions of labels."""
    figure, (speeds, distances, *labels) = panels(2 + len(learnable), 3.7, 3.6)
    speed = found.decisions["speed"].to_numpy()
    speeds.hist(speed, bins=np.arange(np.floor(speed.min()), speed.max() + 1), color=SERIES[0])
    speeds.axvline(speed.mean(), color="black", linewidth=1)
    title = f"Speed, mean {speed.mean():z.1f} m/s"
    speeds.set(title=title, xlabel="m/s", ylabel="vehicles at a decision")
    following = found.decisions["leader_distance"].drop_nulls().to_numpy()
    distances.hist(following, bins=40, range=(0, FOLLOWING_RANGE_M), color=SERIES[0])
    distances.set(
        title="Distance headway",
        xlabel=f"m to a leader within {FOLLOWING_RANGE_M:g} m, centre to centre",
    )
    for axes, (name, each) in zip(labels, learnable.items(), strict=True):
        sets = zip(each.label_shares.items(), (-0.2, 0.2), (GREY, SERIES[0]), strict=True)
        for (title, proportions), offset, colour in sets:
            places = np.arange(len(proportions))
            axes.barh(places + offset, proportions.values(), 0.38, color=colour, label=title)
            names = [action.replace("_", " ").lower() for action in proportions]
            axes.set_yticks(places, names)
        axes.invert_yaxis()
        axes.xaxis.set_major_formatter(lambda proportion, _: f"{proportion:z.0%}")
        axes.set(title=f"Labels: {name}")
        axes.legend(frameon=False, fontsize=9)
    return figure
