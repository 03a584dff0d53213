"""What `render` of the environments returns and shows."""

from typing import TYPE_CHECKING

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.errors import InputError

if TYPE_CHECKING:
    from charms_bench.envs.window import Window

RENDER_MODES = ["rgb_array", "human"]
SHOWN = 4
"""The most scenes that a window shows, one below another."""


class Renderer:
    """Draws the scenes of a simulation as animations of replays do; without a mode, nothing.

    Args:
        simulation: The simulation.
        mode: One of `RENDER_MODES`, or None.

    Raises:
        InputError: There is no such mode.
    """

    def __init__(self, simulation: Simulation, mode: str | None) -> None:
        if mode not in (None, *RENDER_MODES):
            known = " or ".join(map(repr, RENDER_MODES))
            raise InputError(f"{ID}: no render_mode {mode!r}; expected {known}")
        self._simulation, self._mode = simulation, mode
        self._window: Window | None = None

    def show(self) -> None:
        """Shows the first scenes in a window if the mode is `human`, not faster than real time."""
        if self._mode != "human":
            return
        if self._window is None:
            from charms_bench.envs.window import Window

            self._window = Window(ID)
        rows = range(min(SHOWN, self._simulation.seeds.size))
        picture = np.concatenate([frame_of(self._simulation, row) for row in rows])
        self._window.show(picture, self._simulation.settings.decision_hz)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The frames (height, width, 3) of all scenes in the mode `rgb_array`."""
        if self._mode == "rgb_array":
            return tuple(frame_of(self._simulation, k) for k in range(self._simulation.seeds.size))
        if self._mode is None:
            gymnasium.logger.warn(f"{ID}: render needs a render_mode: {' or '.join(RENDER_MODES)}")
        self.show()
        return None

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()
            self._window = None


def frame_of(simulation: Simulation, row: int) -> NDArray[np.uint8]:
    """The picture (height, width, 3) of a scene; its height is even, as most videos demand."""
    from charms_bench.world.picture import Moment, picture  # Pillow and matplotlib

    scene, settings = simulation.scene, simulation.settings
    ego = int(scene.ego[row])
    gap, ttc = _to_leader(simulation, row, ego)
    moment = Moment(
        settings=settings,
        title=ID,
        episode=int(simulation.seeds[row]),
        t_s=simulation.steps[row] / settings.decision_hz,
        ego=ego,
        agents=simulation.drivers[row].tolist(),
        traffic=[name for name in sorted(simulation.agents) if name],
        x=scene.x[row],
        y=scene.y[row],
        heading=scene.heading[row],
        speed=scene.speed[row],
        acceleration=scene.acceleration[row],
        lane=scene.lane[row],
        target_lane=scene.target_lane[row],
        crashed=scene.crashed[row],
        action=simulation.action[row],
        has_action=simulation.has_action[row],
        gap_ahead=gap,
        ttc=ttc,
    )
    frame = np.asarray(picture(moment))
    return frame[: frame.shape[0] // 2 * 2]


def _to_leader(simulation: Simulation, row: int, ego: int) -> tuple[float, float]:
    """The gap to the ego's leader, m, and the time to collision, s; NaN where there is none."""
    scene = simulation.scene
    vehicle = (np.array([row]), np.array([ego]))
    leader, found = scene.leader(vehicle, scene.lane[vehicle])
    gap = scene.x[row, leader[0]] - scene.x[row, ego] - scene.constants.length
    if not found[0] or scene.crashed[row, ego] or gap <= 0:
        return np.nan, np.nan
    closing = scene.speed[row, ego] - scene.speed[row, leader[0]]
    return gap, gap / closing if closing > 0 else np.nan
