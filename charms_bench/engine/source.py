"""Sources: where the vehicles of episodes come from, and when they leave."""

from typing import ClassVar

from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.stepping import Put
from charms_bench.world.scene import Floats, Ints


class Source:
    """Places and removes vehicles; by default, every method does nothing.

    What a source draws beside the engine's draws comes from random streams of its own, so that it
    changes no other draw.
    """

    is_foreseen: ClassVar[bool] = True
    """Whether the vehicles of a planner's rollouts come and go by it, too."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        self._episodes = episodes

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        """Places vehicles in the scenes `rows` (R,), whose episodes begin.

        `seats` (R, N) are the agent of the ego, and then those of the other vehicles. `draws`
        (R, D) place drawn vehicles instead of the seeds; see `engine.draws`.
        """

    def resume(self, rows: Ints) -> None:
        """Goes on in the scenes `rows` (R,), which have been restored from a state."""

    def before_step(self) -> None:
        """Lets vehicles leave before a simulation step."""

    def before_move(self) -> Put | None:
        """Decides about vehicles after all agents have acted; returns where their step ends."""
        return None

    def after_step(self) -> None:
        """Lets vehicles leave and enter after a simulation step."""

    def after_decision(self) -> None:
        """Ends episodes after a decision interval."""


class Drawn(Source):
    """Vehicles that the engine draws, or that the task of a road of highway-env places."""

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        episodes = self._episodes
        episodes.engine.reset(rows, episodes.seeds[rows], seats, draws)
