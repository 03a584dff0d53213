"""What a folder of recordings holds, as a figure."""

from pathlib import Path

import numpy as np

from charms_bench.engine.following import FOLLOWING_RANGE_M
from charms_bench.people.samples import Collected
from charms_bench.people.survey import survey
from charms_bench.report.figures import BLUE, GREY, panels, save
from charms_bench.world.actions import ACTIONS


def draw(collected: Collected, path: Path) -> None:
    """Draws speeds, distances while following, and the labels' shares.

    Raises:
        InputError: The file's ending is not a format's, or it cannot be written.
    """
    found = survey(collected)
    figure, (speeds, distances, labels) = panels(3, 3.7, 3.6)
    speed = collected.decisions["speed"].to_numpy()
    speeds.hist(speed, bins=np.arange(np.floor(speed.min()), speed.max() + 1), color=BLUE)
    speeds.axvline(found["speed_mean_mps"], color="black", linewidth=1)
    speeds.set(
        title=f"Speed, mean {found['speed_mean_mps']:.1f} m/s",
        xlabel="m/s",
        ylabel="vehicles at a decision",
    )
    following = collected.decisions["leader_distance"].drop_nulls().to_numpy()
    distances.hist(following, bins=40, range=(0, FOLLOWING_RANGE_M), color=BLUE)
    distances.set(
        title="Headway while following",
        xlabel=f"m to a leader within {FOLLOWING_RANGE_M:g} m, centre to centre",
    )
    before, after = found["label_shares"].values()
    places = np.arange(len(ACTIONS))
    labels.barh(places - 0.2, before.values(), 0.38, color=GREY, label="all rows")
    labels.barh(places + 0.2, after.values(), 0.38, color=BLUE, label="IDLE undersampled")
    labels.set_yticks(places, [action.replace("_", " ").lower() for action in ACTIONS])
    labels.invert_yaxis()
    labels.xaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    labels.set(title="Labels")
    labels.legend(frameon=False, fontsize=9)
    save(figure, path)
