"""Episodes in scenes of agents, on a straight road or one of highway-env's."""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.error import ResetNeeded

from charms_bench.engine.endings import ENDINGS, RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.envs.episodes import NO_SCENES, Decided, Episodes, Seeds, Spaces, spread
from charms_bench.envs.given_actions import array_of
from charms_bench.envs.learners import Learners
from charms_bench.envs.rendering import Frame, frame_of, moment_of
from charms_bench.envs.seeds import random_seeds
from charms_bench.errors import InputError
from charms_bench.foundation.generator import State, seeded, word
from charms_bench.world.scene import EVALUATION_SEEDS, Bools, Floats, Ints, Observations, Vehicles


class OfScenes:
    """An environment of `SceneEpisodes`."""

    _episodes: Any

    @property
    def simulation(self) -> Simulation:
        """The simulation of all scenes."""
        found: Simulation = self._episodes.simulation
        return found


class EpisodesState(NamedTuple):
    """The state of every running episode, and the environment's counters."""

    scenes: SceneState
    returns: Floats
    """[B L] sums of the rewards so far."""
    next_seed: int | None
    """None if the generators draw the next seeds."""
    generators: State | None = None
    """[B, 6] the random generators of the scenes; None leaves them as they are."""
    places: Ints | None = None
    """[B L] the learners' places; None if the egos are the only learners."""
    alive: Bools | None = None
    """[B L] which of them drive."""


class SceneEpisodes(Episodes):
    """The episodes of learners.

    The seed of an episode is drawn by the scene's generator where none is given, as
    `numpy.random.default_rng(seed)` draws numbers below 2**62.

    Args:
        learners: The learners of all scenes.
    """

    def __init__(self, learners: Learners) -> None:
        self.learners, self.title = learners, learners.title
        self.scenes, self.environments = learners.simulation.seeds.size, learners.returns.size
        self.decision_hz = learners.simulation.settings.decision_hz
        self.spaces = learners.spaces
        self.numbers = learners.numbers
        self.action_names = learners.actions.names
        self._generators = seeded(random_seeds(self.scenes))
        self._endings: Ints = np.full(self.environments, RUNNING)

    @property
    def simulation(self) -> Simulation:
        """The simulation of all scenes."""
        return self.learners.simulation

    def check_started(self, what: str) -> None:
        self.learners.check_started(what)

    def reseed(self, rows: Ints, seeds: Seeds) -> None:
        for row, own in zip(rows.tolist(), seeds, strict=True):
            if own is not None:
                self._generators[row] = seeded(np.array([own], dtype=np.uint64))[0]

    def start(self, rows: Ints, seeds: Seeds) -> None:
        chosen = np.empty(rows.size, dtype=np.uint64)
        for k, (row, own) in enumerate(zip(rows.tolist(), seeds, strict=True)):
            if own is None:  # `integers(2**62)` are the upper bits of a word
                own = EVALUATION_SEEDS + (int(word(self._generators[row])) >> 2)
            chosen[k] = own
        self.learners.reset(chosen, rows)

    def observe(self) -> Observations:
        return self._observed(self.learners.vehicles, self.learners.alive)

    def _observed(self, vehicles: Vehicles, alive: Bools) -> Observations:
        """Observations (B L, rows, columns), zeros where a learner does not drive."""
        return spread(self.learners.observe(vehicles), alive, 0)

    def begin(self, observations: Observations, rows: Ints) -> None:
        learners = self.learners
        which = learners.of_scenes(rows)
        which = which[learners.alive[which]]
        vehicles = learners.scene_of[which], learners.places[which]
        observations[which] = learners.observe(vehicles)

    def decide(self, actions: Any, due: Ints = NO_SCENES) -> Decided:
        learners = self.learners
        vehicles, drove = learners.vehicles, learners.alive
        rewards, terminated, truncated, self._endings = learners.step(actions)
        return Decided(self._observed(vehicles, drove), rewards, terminated, truncated)

    def over(self, ended: Bools) -> Bools:
        return np.asarray(~self.learners.alive.reshape(self.scenes, -1).any(axis=1))

    def of_scenes(self, rows: Ints) -> Ints:
        return self.learners.of_scenes(rows)

    def scenes_of(self, mask: Any) -> Any:
        return self.learners.scenes_of(mask)

    def final(self, ended: Bools) -> dict[str, Any]:
        simulation, scene_of = self.simulation, self.learners.scene_of
        found = {
            "ending": self._endings,
            "steps": simulation.steps[scene_of],
            "episode_return": self.learners.returns,
            "seed": simulation.seeds[scene_of],
        }
        return {name: np.where(ended, values, 0) for name, values in found.items()}

    def always(self) -> dict[str, Any]:
        """The action masks; continuous actions have none."""
        return {"action_mask": self.masks()} if self.learners.actions.kind == "meta" else {}

    def masks(self) -> Any:
        """The action masks (B L, A); all 1 for learners that do not drive any more."""
        learners = self.learners
        return spread(learners.masks(learners.vehicles), learners.alive, 1)

    def frame(self, row: int) -> Frame:
        return frame_of(moment_of(self.simulation, row, self.title))

    def saved(self, next_seed: int | None) -> EpisodesState:
        learners = self.learners
        state = EpisodesState(
            self.simulation.state(), learners.returns.copy(), next_seed, self._generators.copy()
        )
        if len(self.numbers) == 1:
            return state
        return state._replace(places=learners.places.copy(), alive=learners.alive.copy())

    def load(self, state: Any) -> int | None:
        if not isinstance(state, EpisodesState):
            raise InputError(
                f"found {type(state).__name__}, expected an EpisodesState; a SceneState continues "
                'with reset(options={"state": state})'
            )
        self.learners.restore(state.scenes, state.places, state.alive)
        self.learners.returns[:] = state.returns
        if state.generators is not None:
            self._generators[:] = state.generators
        return state.next_seed

    def state(self) -> SceneState:
        return self.simulation.state()

    def restore(self, state: Any) -> None:
        self.learners.restore(state)

    def decide_one(self, action: Any) -> Decided:
        if self.simulation.ending[0] != RUNNING:
            raise ResetNeeded("step after the end of the episode; reset starts the next one")
        return self.decide(array_of(action)[None])

    def result(self, decided: Decided, action: Any) -> Any:
        observations, *outcome = decided
        reward, terminated, truncated = (part[0].item() for part in outcome)
        info = {name: values[0] for name, values in self.always().items()}
        if terminated or truncated:
            info["ending"] = ENDINGS[self.simulation.ending[0]]
        return observations[0], reward, terminated, truncated, info

    def first_info(self) -> dict[str, Any]:
        always = {name: values[0] for name, values in self.always().items()}
        return {"seed": int(self.simulation.seeds[0]), **always}

    def spaces_of_agents(self) -> list[Spaces]:
        return [self.spaces for _ in self.numbers]

    def driving(self) -> Bools:
        return self.learners.alive

    def decide_each(self, chosen: Ints) -> tuple[list[float], list[bool], list[bool]]:
        *outcome, self._endings = self.learners.step(chosen)
        rewards, terminated, truncated = (part.tolist() for part in outcome)
        return rewards, terminated, truncated

    def seen_by(self, which: Ints) -> Observations:
        return self.learners.observe(self._vehicles(which))

    def infos_of(self, which: Ints, *, starts: bool = False) -> list[dict[str, Any]]:
        infos: list[dict[str, Any]] = [
            {"seed": int(self.simulation.seeds[0])} if starts else {} for _ in which
        ]
        masks = self.learners.masks(self._vehicles(which))
        for info, mask, ending in zip(infos, masks, self._endings[which], strict=True):
            info["action_mask"] = mask
            if not starts and ending != RUNNING:
                info["ending"] = ENDINGS[ending]
        return infos

    def _vehicles(self, which: Ints) -> Vehicles:
        """The vehicles of learners in the first scene."""
        return np.zeros_like(which), self.learners.places[which]
