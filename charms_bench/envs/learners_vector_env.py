"""Many learners as arrays: the caller drives L vehicles in each of B scenes."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import TrafficLike, drivers_of, scene_settings
from charms_bench.envs.highway_reward import highway_rewards
from charms_bench.envs.learners import Learners, VehicleReward
from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.envs.vector_env import final_infos, mask_infos, spaces_of
from charms_bench.errors import InputError
from charms_bench.world.action_mask import ActionMasks, action_masks
from charms_bench.world.actions import ACTIONS, Actions
from charms_bench.world.observations import ObservationLike, observation_of
from charms_bench.world.scene import (
    EVALUATION_SEEDS,
    Bools,
    Floats,
    Ints,
    Observations,
    Vehicles,
)


class LearnersVectorEnv(VectorEnv[Observations, Actions, NDArray[Any]]):
    """B scenes with L learners each, as a Gymnasium vector environment of B L environments.

    The learners of the first scene come first, so that `array.reshape(B, L, ...)` has one row per
    scene. A learner's episode terminates when its vehicle crashes or leaves the road, and is
    truncated when the scene's time is over. Its vehicle stays in the scene, which goes on for the
    other learners. When no learner is left, the next scene starts within the same step.

    Until then, `alive` is false for the learners that have left: their observations are zeros,
    their rewards are 0, and their actions have no effect. So the next episode of such a learner
    begins with a wait. The k-th scene to start has the seed `EVALUATION_SEEDS + k`.

    Args:
        scenes: B.
        learners: The L vehicles that the caller drives. Vehicle 0, the ego, must be one of them;
            vehicle k is the k-th of the others in the order of spawning. None means all vehicles.
        traffic: Assigns a driver to each of the other vehicles.
        reward: The rewards (M,) of M vehicles after a decision; by default highway-env's.
        observation: The learners' observation; see `charms_bench.world.observations`.
        render_mode: `rgb_array` or `human`; see `render`.
        scene: `density`, `lanes`, `traffic_vehicles`, `profile` and all other keys of a suite's
            `scene`, with the same defaults.

    Raises:
        InputError: The traffic is not installed, or an argument is wrong.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }

    def __init__(
        self,
        scenes: int,
        learners: Iterable[int] | None = None,
        traffic: TrafficLike = "idm_mobil",
        reward: VehicleReward = highway_rewards,
        observation: ObservationLike = "neighbours",
        render_mode: str | None = None,
        **scene: Any,
    ) -> None:
        settings = scene_settings(scene, "LearnersVectorEnv")
        self._learners = Learners(settings, scenes, learners, *drivers_of(traffic), reward)
        self._observation = observation_of(observation)
        self.num_envs = self._learners.alive.size
        self.single_observation_space, self.single_action_space = spaces_of(
            settings, self._observation
        )
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._next_seed = EVALUATION_SEEDS
        self._renderer = Renderer(self.simulation, render_mode, "LearnersVectorEnv")
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": settings.decision_hz}

    @property
    def learners(self) -> tuple[int, ...]:
        """The numbers of the L learners."""
        return self._learners.numbers

    @property
    def simulation(self) -> Simulation:
        """The simulation of the B scenes."""
        return self._learners.simulation

    @property
    def alive(self) -> Bools:
        """(B L,) whether the learner drives, so that its next action counts."""
        return self._learners.alive.ravel().copy()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts every scene.

        Args:
            seed: The first scene's seed; None continues with the next unused seed.
            options: There are none.

        Returns:
            Observations and infos, which have the `action_mask`; see `step`.

        Raises:
            InputError: There is an option.
        """
        warn_of_torch_threads()
        super().reset(seed=seed)
        if options:
            raise InputError(f"reset takes no options, got {', '.join(map(str, options))}")
        if seed is not None:
            self._next_seed = seed
        self._start(np.arange(len(self._learners.alive)))
        self._renderer.show()
        observations = self._observe(self._learners.vehicles, self._learners.alive)
        return observations, mask_infos(self._masks())

    def step(self, actions: Actions) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the learners' actions (B L,) for one decision interval.

        Returns:
            Observations (B L, rows, columns), rewards (B L,), terminations (B L,), truncations
            (B L,), and infos. These have the `action_mask` (B L, 5) of the next step; see
            `world.action_mask`. They also have the `final_obs` and the `final_info` of the learners
            whose episodes ended: `ending` (an index into `engine.simulation.ENDINGS`), `steps`,
            `episode_return` and the scene's `seed`.
        """
        learners = self._learners
        simulation, vehicles, drove = self.simulation, learners.vehicles, learners.alive.copy()
        outcome = learners.step(np.reshape(actions, drove.shape))
        self._renderer.show()
        observations = self._observe(vehicles, drove)
        infos: dict[str, Any] = {}
        ended = (outcome.terminated | outcome.truncated).ravel()
        if ended.any():
            values: dict[str, NDArray[Any]] = {
                "ending": outcome.endings.ravel(),
                "steps": np.repeat(simulation.steps, drove.shape[1]),
                "episode_return": learners.returns.ravel(),
                "seed": np.repeat(simulation.seeds, drove.shape[1]),
            }
            infos = final_infos(ended, observations, values)
            observations[ended] = 0.0
            rows = np.nonzero(~learners.alive.any(axis=1))[0]
            if rows.size:
                self._start(rows)
                started = (np.repeat(rows, drove.shape[1]), learners.places[rows].ravel())
                shape = (rows.size, drove.shape[1], *observations.shape[1:])
                new = self._observation(simulation.scene, started).reshape(shape)
                observations.reshape(*drove.shape, *shape[2:])[rows] = new
        flat = (outcome.rewards.ravel(), outcome.terminated.ravel(), outcome.truncated.ravel())
        return observations, *flat, infos | mask_infos(self._masks())

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The B scenes around their egos, each (height, width, 3); see `HighwayVectorEnv.render`.

        Raises:
            InputError: There is no display for the window.
        """
        return self._renderer.render()

    def close_extras(self, **_: Any) -> None:
        """Closes the window."""
        self._renderer.close()

    def action_masks(self) -> Bools:
        """The action masks (B L, 5), as sb3-contrib's `MaskablePPO` asks for them."""
        return self._masks().astype(np.bool_)

    def _masks(self) -> ActionMasks:
        """The action masks (B L, 5); all 1 for learners that do not drive any more."""
        alive = self._learners.alive.ravel()
        masks = np.ones((alive.size, len(ACTIONS)), dtype=np.int8)
        masks[alive] = action_masks(self.simulation.scene, self._learners.vehicles)
        return masks

    def _start(self, rows: Ints) -> None:
        seeds = np.arange(self._next_seed, self._next_seed + rows.size, dtype=np.uint64)
        self._next_seed += rows.size
        self._learners.reset(seeds, rows)

    def _observe(self, vehicles: Vehicles, alive: Bools) -> Observations:
        """The observations (B L, rows, columns), zeros where `alive` [B, L] is false."""
        seen = self._observation(self.simulation.scene, vehicles)
        if alive.all():
            return seen
        observations = np.zeros((alive.size, *seen.shape[1:]), dtype=seen.dtype)
        observations[alive.ravel()] = seen
        return observations
