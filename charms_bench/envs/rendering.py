"""What `render` of the environments returns and shows."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.errors import InputError
from charms_bench.world.gaps import time_to_collision

if TYPE_CHECKING:
    from charms_bench.envs.window import Window
    from charms_bench.world.picture import Moment

Frame = NDArray[np.uint8]
RENDER_MODES = ["rgb_array", "human"]
LEARNER = "learner"
"""What pictures call the driver of a vehicle other than the ego that the caller drives."""
SHOWN = 4
"""The most scenes that a window shows, one below another."""
STATE = ("x", "y", "heading", "speed", "acceleration", "lane", "target_lane", "crashed")
"""What a moment takes from the scene, besides the sizes of the vehicles."""


class Renderer:
    """Draws scenes as animations of replays do; without a mode, nothing.

    It keeps no scene, so a copy of an environment draws its own.

    Args:
        scenes: How many there are.
        hz: Their decisions per second.
        mode: The mode.
        title: The environment's name, for messages.

    Raises:
        InputError: There is no such mode.
    """

    def __init__(
        self,
        scenes: int,
        hz: float,
        mode: str | None,
        title: str = ID,
    ) -> None:
        if mode not in (None, *RENDER_MODES):
            known = " or ".join(map(repr, RENDER_MODES))
            raise InputError(f"{title}: no render_mode {mode!r}; expected {known}")
        self._scenes, self._hz = scenes, hz
        self.mode, self._title = mode, title
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        """A copy opens a window of its own."""
        return {**vars(self), "_window": None}

    def show(self, frame: Callable[[int], Frame]) -> None:
        """Shows the first scenes in a window if the mode is `human`, not faster than real time.

        Args:
            frame: Draws the scene with a number.
        """
        if self.mode != "human":
            return
        if self._window is None:
            from charms_bench.envs.window import Window

            self._window = Window(self._title)
        frames = [*map(frame, range(min(SHOWN, self._scenes)))]
        self._window.show(np.concatenate(frames), self._hz)

    def render(self, frame: Callable[[int], Frame]) -> tuple[Frame, ...] | None:
        """The frames (height, width, 3) of all scenes in the mode `rgb_array`; see `show`."""
        if self.mode == "rgb_array":
            return tuple(map(frame, range(self._scenes)))
        if self.mode is None:
            modes = " or ".join(RENDER_MODES)
            gymnasium.logger.warn(f"{self._title}: render needs a render_mode: {modes}")
        self.show(frame)
        return None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()
            self._window = None


def frame_of(moment: "Moment") -> Frame:
    """The picture (height, width, 3) of a moment; its height is even, as most videos demand."""
    from charms_bench.world.picture import picture  # Pillow and matplotlib

    frame = np.asarray(picture(moment))
    return frame[: frame.shape[0] // 2 * 2]


def moment_of(simulation: Simulation, row: int, title: str) -> "Moment":
    """The present moment of a scene."""
    from charms_bench.world.picture import Moment

    scene, settings = simulation.scene, simulation.settings
    ego = int(scene.ego[row])
    gap, ttc = _to_leader(simulation, row, ego)
    agents = [name or LEARNER for name in simulation.drivers[row].tolist()]
    agents[ego] = str(simulation.drivers[row, ego])
    traffic = {name for name in simulation.agents if name} | ({LEARNER} & {*agents})
    t_s = simulation.steps[row] / settings.decision_hz + simulation.phase / settings.simulation_hz
    return Moment(
        settings=settings,
        title=title,
        episode=int(simulation.seeds[row]),
        t_s=t_s,
        ego=ego,
        agents=agents,
        traffic=sorted(traffic),
        action=simulation.named_actions[row],
        action_names=simulation.action_names,
        has_action=simulation.has_action[row],
        plan=simulation.engine.plan(row),
        gap_ahead=gap,
        ttc=ttc,
        **{name: getattr(scene, name)[row] for name in ("present", "length", "width", *STATE)},
    )


def _to_leader(simulation: Simulation, row: int, ego: int) -> tuple[float, float]:
    """The gap to the ego's leader, m, and the time to collision, s; NaN if undefined."""
    scene = simulation.scene
    vehicle = (np.array([row]), np.array([ego]))
    leader, found = scene.leader(vehicle, scene.lane[vehicle])
    gap = float(scene.gap_to(vehicle, leader)[0])
    if not found[0] or scene.crashed[row, ego] or gap <= 0:
        return np.nan, np.nan
    closing = scene.speed[row, ego] - scene.speed[row, leader[0]]
    return gap, float(time_to_collision(gap, closing))
