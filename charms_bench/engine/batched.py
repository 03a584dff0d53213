"""The engine of the straight road: thousands of scenes at once, compiled."""

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import Cast, Engine
from charms_bench.engine.draws import draws_of
from charms_bench.engine.meta_actions import choose_target_speeds, command, command_rule, obey
from charms_bench.engine.motion import follow_no_lane
from charms_bench.engine.neighbours import locate
from charms_bench.engine.seats import mark_seats, seat, vehicles_of
from charms_bench.engine.spawning import spawn, spawn_rule
from charms_bench.engine.stepping import BeforeMove, advance
from charms_bench.engine.type_draws import set_types
from charms_bench.foundation.generator import seeded
from charms_bench.world.actions import Actions, controls_of
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles


class BatchedEngine(Engine):
    """highway-env's behaviour over arrays `[B, N]`; see `charms_bench.engine`."""

    def __init__(self, settings: SceneSettings, scenes: int, cast: Cast) -> None:
        super().__init__(settings, scenes, cast)
        self.state = self.scene = Scene.empty(settings, scenes, cast.parameters, cast.memory)
        self._spawn_rule = spawn_rule(settings)
        self._command_rule = command_rule(settings.profile)
        self._own_rules = {
            k: command_rule(settings.profile, own) for k, own in cast.own_actions.items()
        }
        models = list(cast.models)
        self._are_models = np.isin(np.arange(max(models, default=0) + 1), models)
        marks = (np.zeros(self.drivers.shape, dtype=np.bool_) for _ in range(5))
        self._is_modelled, self._is_ego, self._nobody = next(marks), next(marks), next(marks)
        self._is_continuous, self._is_prescribed = marks
        self._vehicles: dict[tuple[int, bool], Vehicles] = {}
        """The active vehicles that each driver model drives, and those of them that are not egos;
        listed for the active scenes `_listed`."""
        self._listed = b""

    def reset(
        self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints, draws: Floats | None = None
    ) -> None:
        scene, settings, generators = self.scene, self._settings, seeded(seeds)
        draws = draws_of(generators, settings) if draws is None else draws
        scene.ego[rows] = draws[:, 0] * settings.ego_slots
        desired = set_types(scene, settings, rows, seeds)
        spawn(scene, rows, draws, self._spawn_rule)
        scene.target_speed[rows] = np.where(np.isnan(desired), scene.speed[rows], desired)
        scene.generator[rows] = generators
        seats = (self._are_models, self.drivers, self._is_modelled, self._is_ego)
        seat(rows, scene.ego, agents, *seats)
        self._vehicles.clear()
        if self._command_rule.speeds.size:
            free = self._is_modelled
            if self._own_rules:
                unbound = [k for k, rule in self._own_rules.items() if not rule.speeds.size]
                free = free | np.isin(self.drivers, unbound)
            choose_target_speeds(scene, rows, free, self._command_rule.speeds)
        self._mark(rows)

    def _mark(self, rows: Ints) -> None:
        """Marks the prescribed vehicles, and those with continuous actions, without targets."""
        if self._prescribed:
            self._is_prescribed[rows] = np.isin(self.drivers[rows], self._prescribed)
        if self._continuous:
            marked = self._is_continuous[rows] = np.isin(self.drivers[rows], self._continuous)
            self.scene.target_speed[rows] *= ~marked
            follow_no_lane(self.scene, self._is_continuous)

    def restore(
        self, rows: Ints, seeds: NDArray[np.uint64], saved: NDArray[np.uint8] | None = None
    ) -> None:
        drivers, ego = self.drivers, self.scene.ego
        mark_seats(rows, ego, self._are_models, drivers, self._is_modelled, self._is_ego)
        self._vehicles.clear()
        locate(self.scene, rows)
        self._mark(rows)

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        if actions.ndim == 2:
            control = controls_of(actions)
            self.scene.acceleration[vehicles], self.scene.steering[vehicles] = control
            return
        if not self._own_rules:
            command(self.scene, vehicles[0], vehicles[1], actions, self._command_rule)
            return
        drivers = self.drivers[vehicles]
        for agent in np.unique(drivers).tolist():
            its = np.nonzero(drivers == agent)[0]
            rule = self._own_rules.get(agent, self._command_rule)
            command(self.scene, vehicles[0][its], vehicles[1][its], actions[its], rule)

    def advance(self, hold_egos: bool = False, before_move: BeforeMove | None = None) -> None:
        scene = self.scene
        active = scene.active.tobytes()
        if not self._vehicles or self._listed != active:
            self._listed = active
            for agent in self._models:
                found = vehicles_of(agent, self.drivers, scene.active, scene.present, scene.entry)
                others = np.nonzero(~self._is_ego[found])[0]
                self._vehicles[agent, False] = found
                self._vehicles[agent, True] = found[0][others], found[1][others]
        for agent, model in self._models.items():
            vehicles = self._vehicles[agent, hold_egos]
            if vehicles[0].size:
                answers = model.drive(self._shown, vehicles)
                obey(scene, vehicles[0], vehicles[1], *answers)
        zero_order_hold = self._is_ego if hold_egos else self._nobody
        if self._prescribed:
            zero_order_hold = zero_order_hold | self._is_prescribed
        if self._continuous:
            zero_order_hold = zero_order_hold | self._is_continuous
        put = None if before_move is None else before_move()
        if put is None:  # which the argument would say too, but more slowly
            advance(scene, self._is_modelled, zero_order_hold)
        else:
            advance(scene, self._is_modelled, zero_order_hold, put)
        if self._continuous:
            follow_no_lane(scene, self._is_continuous)
