"""Vehicles that enter and leave a road of highway-env while an episode lasts."""

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.engine.open_road import AGENTS_STREAM
from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.source import Source
from charms_bench.world.scene import Floats, Ints


class Crossing(Source):
    """Vehicles that the road lets enter and leave; see `Engine.renew`."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        super().__init__(episodes)
        count = max(episodes.settings.vehicles, episodes.engine.arrivals)
        self._agents = np.zeros((episodes.seeds.size, count), dtype=np.int64)
        """[B, A] the agents of the vehicles that enter, in their order."""

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        self.resume(rows)

    def resume(self, rows: Ints) -> None:
        """Draws the agents of the vehicles that will enter."""
        count = self._agents.shape[1]
        self._agents[rows] = self._episodes.seats_of(AGENTS_STREAM, rows, count)

    def after_step(self) -> None:
        """Lets vehicles leave and enter in every so manieth simulation step."""
        episodes = self._episodes
        engine, state = episodes.engine, episodes.engine.state
        frames = episodes.frames
        rows = np.nonzero(state.active & (frames % engine.renewal_steps == 0))[0]
        if not rows.size:
            return
        times_s = frames[rows] / episodes.settings.simulation_hz
        entered = engine.renew(rows, self._agents[rows], times_s)
        if not entered[0].size:
            return
        state.memory[entered], state.repeats[entered] = 0.0, 0
        episodes.has_action[entered], episodes.collision[entered] = False, NO_COLLISION
        set_parameters(episodes, *entered)
