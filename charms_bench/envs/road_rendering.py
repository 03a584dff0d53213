"""Pictures of highway-env's roads."""

from typing import TYPE_CHECKING

import numpy as np

from charms_bench.envs.rendering import Frame, frame_of
from charms_bench.roads.episodes import Episodes, plan_of
from charms_bench.world.plan_view import Lines, lines_of
from charms_bench.world.scene import SceneSettings

if TYPE_CHECKING:
    from charms_bench.world.picture import Moment

TRAFFIC = "IDM of highway-env"
"""What pictures call the driver of the other vehicles."""


class RoadPictures:
    """Draws the scenes of episodes on a road."""

    def __init__(self) -> None:
        self._lines: Lines | None = None
        self._of: Episodes | None = None

    def frame(self, episodes: Episodes, row: int) -> Frame:
        """The picture (height, width, 3) of a scene."""
        if self._lines is None or self._of is not episodes:
            self._lines, self._of = lines_of(episodes.scenes.road), episodes
        return frame_of(moment_of_road(episodes, row, self._lines))


def moment_of_road(episodes: Episodes, row: int, lines: Lines) -> "Moment":
    """The present moment of a scene, whose road has these lines."""
    from charms_bench.world.picture import Moment

    settings, vehicles = SceneSettings(), episodes.scenes.vehicles[row]
    plan, first = plan_of(lines, episodes.scenes, row), episodes.scenes.road.lanes["first"]
    lane, target = vehicles["lane"], vehicles["target_lane"]
    number = lane - first[lane]
    # On another road, a target lane says nothing of a lane change.
    aside = np.where(first[lane] == first[target], target - lane, 0)
    copied = ("length", "width", "speed", "acceleration", "crashed")
    is_moving = plan.present & ~plan.is_obstacle
    return Moment(
        settings=settings,
        title=episodes.name,
        episode=None,
        t_s=float(episodes.scenes.time[row]),
        ego=0,
        agents=["", *[TRAFFIC] * (number.size - 1)],
        traffic=[TRAFFIC],
        present=is_moving,
        x=plan.x,
        y=number * settings.profile.lane_width_m,
        heading=plan.heading,
        lane=number,
        target_lane=number + aside,
        action=np.zeros(number.size, dtype=np.int64),
        has_action=np.zeros(number.size, dtype=np.bool_),
        gap_ahead=np.nan,
        ttc=np.nan,
        plan=plan,
        **{name: vehicles[name] for name in copied},
    )
