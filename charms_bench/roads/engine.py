"""Agents of the straight road drive vehicles of one of highway-env's environments.

Each of these vehicles sees the scene straightened along its own way (`straightened`); what its
agent answers is carried out on the network. All vehicles have highway-env's controllers and limits,
and those without an agent drive as in the environment. The profile decides between which target
speeds agents choose, the constants of driver models, and whether vehicles of agents can reverse:
they can if its lowest speed is negative and it `can_reverse`.

In a simulation step, the driver models act in their order, and each sees the target lanes of the
models before it. All vehicles of one model see the scene as it was before any of them acted. Then
the vehicles of the environment decide, and all move.
"""

from collections.abc import Collection, Iterator
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import Cast, Engine
from charms_bench.engine.meta_actions import command, command_rule, nearest_target_speed, obey
from charms_bench.engine.seats import vehicles_of
from charms_bench.engine.state import ARRAYS, SceneState
from charms_bench.engine.stepping import BeforeMove
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.generator import seeded, with_draws
from charms_bench.foundation.philox import uniforms
from charms_bench.plugins.agent import DriverModel
from charms_bench.roads.agent_stepping import (
    BY_CONFIGURATION,
    BY_CONTROLS,
    BY_ENVIRONMENT,
    BY_MODEL,
    BY_TARGETS,
    advance,
    carry_out,
    show,
    show_each,
)
from charms_bench.roads.configured_egos import configured
from charms_bench.roads.entries import Entries
from charms_bench.roads.episodes import episodes_of_agents, plan_of
from charms_bench.roads.fault import Fault
from charms_bench.roads.inflow import RoadInflow
from charms_bench.roads.interaction import RoadJunctions
from charms_bench.roads.packed_arrays import check_values, pack, unpack, width_of
from charms_bench.roads.scenes import (
    BEHIND,
    COMMANDED,
    CONTINUOUS,
    KINDS,
    NOTHING,
    OBSTACLE,
    ROUTE_STEPS,
    VEHICLE,
    WAY,
    list_all_by_place,
    tidy_all,
)
from charms_bench.roads.scripts import RoadScript
from charms_bench.roads.settings import ONLY_EGOS, profiles_of, room_on
from charms_bench.roads.sizes import set_types
from charms_bench.roads.views import RoadViews
from charms_bench.world.actions import DEFAULT_ACTIONS, Actions, controls_of
from charms_bench.world.plan_view import Lines, Plan, lines_of
from charms_bench.world.scene import Scene, SceneSettings, Vehicles

_COLUMNS = {name: name for name in Scene._fields if name in (VEHICLE.names or ())}
_COLUMNS["impact"] = "has_impact"
"""The columns of the table of vehicles that are arrays of a `Scene`."""
_NETWORK_ONLY = [name for name in VEHICLE.names or () if name not in (*ARRAYS, "has_impact")]
"""The other columns that are no arrays of a `SceneState`."""
_DRIVER = "kind", "target_speed", "timer_s", "exponent", "gains", "changes_lanes"
"""What a vehicle of the environment is driven by."""
_LARGEST_POWER = 1e20
"""That of a speed over a target speed of almost 0, to the power of IDM's exponent."""
EGO, OTHER_EGO, TRAFFIC = range(3)
"""The role of a vehicle: the ego whose rows are made, another ego, or none."""


class RoadEngine(Engine):
    """B scenes of a road of highway-env as an `engine.Engine`; the ego is the first vehicle."""

    def __init__(self, settings: SceneSettings, scenes: int, cast: Cast) -> None:
        super().__init__(settings, scenes, cast)
        assert settings.network is not None
        hz = settings.simulation_hz
        inflow = settings.inflow
        self.episodes = episodes_of_agents(settings.network, scenes, hz, room_on(settings))
        """The scenes on the network, of whose tables `state` is a view."""
        self._seen = Scene.empty(settings, scenes, cast.parameters, cast.memory)
        self.configured = configured(cast.policies, self.episodes)
        """The egos that observe and act by a configuration of highway-env, by their agents."""
        self._moved = np.zeros(scenes, dtype=np.bool_)
        """[B] whether vehicles have moved since `_seen` was straightened."""
        shape = self._seen.x.shape
        self._seeds = np.zeros(scenes, dtype=np.uint64)
        self._present = np.zeros(shape, dtype=np.bool_)
        """[B, N] whether there is a vehicle at the place, also one that the ego cannot see."""
        self.egos = self.episodes.task.egos
        on_network, task = self.episodes.scenes, self.episodes.task
        on_network.constants["mixed_sizes"] = bool(settings.vehicle_types)
        self.has_goal = task.has_goal
        self._inflow = RoadInflow(settings, on_network, task.starts) if inflow else None
        self._script: RoadScript | None = None
        if (scenario := settings.scenario) is not None:
            self._script = RoadScript(settings, on_network, task)
            on_network.constants["mixed_sizes"] = scenario.has_sizes
        if inflow or scenario:
            task.open_ends()
        self.renewal_steps = 1 if inflow else 0
        if task.comes_and_goes:
            self.renewal_steps = round(hz / self.episodes.config["policy_frequency"])
        self.moments = task.moments
        self._followers = [k for k, model in cast.models.items() if model.follows_recording]
        self.arrivals = self._inflow.most if self._inflow else 0
        self._entries = Entries(scenes, on_network, task.main_lanes(on_network))
        self._fault = Fault(scenes, on_network, task.ranks(on_network))
        self.measures = {"at_fault_on_road": self._fault.at_fault, **self._entries.measures}
        self._kinds = np.zeros(shape, dtype=np.int64)
        """[B, N] what drives each vehicle."""
        if self._script is not None:  # prescribed vehicles are put where they are to be
            self._followers, self._prescribed = self._prescribed, []
        profiles, default = profiles_of(settings), {-1: DEFAULT_ACTIONS}
        self._rules = {
            (k, is_ego): command_rule(profile, own)
            for is_ego, profile in zip((True, False), profiles, strict=True)
            for k, own in (default | {**cast.own_actions}).items()
        }
        """How meta-actions are carried out, by the index of an agent and whether it is an ego's.
        Under -1 for agents with highway-env's meta-actions."""
        self._views = self._seen
        """[B N, N] each scene as each of its vehicles sees it, if agents drive the traffic."""
        self._roads: dict[tuple[bool, int, float], Scene] = {}

    @property
    def scene(self) -> Scene:  # type: ignore[override]  # nobody sets it
        """The scenes as their egos see them, straightened when they are asked for."""
        self._show(np.nonzero(self._moved)[0])
        return self._seen

    def _show(self, rows: Ints) -> None:
        """Straightens the scenes `rows` (R,) as their egos see them."""
        if rows.size:
            show(self.episodes.scenes, self._seen.unpacked, rows)
            self._moved[rows] = False

    @cached_property
    def state(self) -> Scene:  # type: ignore[override]  # nobody sets it
        """The vehicles on the network: the columns of its table, and what agents add to them."""
        scenes = self.episodes.scenes
        arrays: dict[str, Any] = {name: scenes.vehicles[each] for name, each in _COLUMNS.items()}
        arrays |= {"present": self._present, "generator": scenes.generator, "road": scenes.road}
        return self._seen._replace(**arrays)

    @cached_property
    def _shown(self) -> Scene:
        return self.scene.read_only().at(self._junctions(1))

    @cached_property
    def _shown_views(self) -> Scene:
        if self._views is self._seen:
            return self._shown
        return self._views.read_only().at(self._junctions(self._seen.x.shape[1]))

    def _junctions(self, views: int) -> RoadJunctions:
        return RoadJunctions(self.episodes, views, self.drivers, self.configured)

    def __getstate__(self) -> dict[str, Any]:
        own = super().__getstate__()
        for views in ("state", "_shown_views"):
            own.pop(views, None)
        return {**own, "_roads": {}}

    def reset(
        self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints, draws: Floats | None = None
    ) -> None:
        episodes, scene = self.episodes, self._seen
        if draws is None:
            episodes.seed(rows, seeds)
        else:
            self._give(draws, rows, seeds)
        if self.moments is not None:
            numbers = np.zeros(self.goals.size, dtype=np.int64)
            numbers[rows] = self.moments.numbers_of(seeds)
            episodes.task.numbers = numbers
        vehicles, kinds = episodes.scenes.vehicles, self._kinds
        episodes.start(rows)
        if self._script is not None:
            self._script.place_on(episodes.scenes, rows, seeds)
            tidy_all(episodes.scenes, rows)
        self._seat_ego(rows, np.full(rows.size, self.ego_index))
        self._seed(rows, seeds)
        if self._inflow:
            self._inflow.entered[rows] = 0
        others = rows[~_are(agents[:, 0], self.configured)]
        if self.moments is None:
            vehicles["target_speed"][others, : self.egos] = vehicles["speed"][others, : self.egos]
        if self._settings.vehicle_types:
            everyone = np.ones((rows.size, vehicles.shape[1]), dtype=np.bool_)
            entry = scene.entry[rows]
            set_types(episodes.scenes, self._settings, self.egos, rows, seeds, entry, everyone)
        episodes.task.navigate(episodes.scenes, others)
        if (slots := self._settings.ego_slots) > 1:
            places = self._drawn(rows, seeds, slots)
            self._seat_ego(rows, places)
            for name in _DRIVER:  # who drives at the place drives the vehicle that comes there
                vehicles[name][rows, places] = vehicles[name][rows, 0]
        scene.ego[rows], scene.active[rows], self.drivers[rows] = 0, True, agents
        scene.temperament[rows] = 0.5
        self.goals[rows] = False
        episodes.scenes.ways["lanes"][rows] = -1
        self._seat(rows)
        if self.moments is not None:
            at_speed = kinds[rows] == BY_TARGETS
            speed, target_speed = vehicles["speed"][rows], vehicles["target_speed"][rows]
            vehicles["target_speed"][rows] = np.where(at_speed, speed, target_speed)
        for b, i in zip(*np.nonzero(kinds[rows] != BY_ENVIRONMENT), strict=True):
            self._aim((rows[b], i))
        for k, egos in self.configured.items():
            egos.start(rows[agents[:, 0] == k])
        self._entries.start(rows, episodes.task.entering(episodes.scenes)[rows])
        self._fault.start(rows)
        self._show(rows)

    def _seat_ego(self, rows: Ints, places: Ints) -> None:
        """Has the vehicle at a place (R,) and the ego change places; all moves stay the same."""
        moved = places > 0
        if not moved.any():
            return
        rows, places = rows[moved], places[moved]
        scenes, entry = self.episodes.scenes, self._seen.entry
        order = scenes.order["place"][rows]
        for table in (scenes.vehicles, entry):  # what vehicles draw follows them
            ego = table[rows, 0].copy()
            table[rows, 0], table[rows, places] = table[rows, places], ego
        other = places[:, None]
        swapped = np.where(order == 0, other, np.where(order == other, 0, order))
        scenes.order["place"][rows] = swapped

    def _drawn(self, rows: Ints, seeds: NDArray[np.uint64], slots: int) -> Ints:
        """A place (R,) among the first `slots` that has a vehicle, by the seeds."""
        is_there = self.episodes.scenes.vehicles["kind"][rows, :slots] > OBSTACLE
        never = np.full(rows.size, -1).astype(np.uint64)  # no decision of a policy has this number
        drawn = uniforms(seeds.astype(np.uint64), never, never, 1)[:, 0]
        number = (drawn * is_there.sum(axis=1)).astype(np.int64)
        return np.asarray((is_there.cumsum(axis=1) == number[:, None] + 1).argmax(axis=1))

    def _seed(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Notes the seeds of the scenes `rows` (R,), by which vehicles will flow in."""
        self._seeds[rows] = seeds
        if self._inflow:
            self._inflow.draw(rows, seeds)

    def _give(self, draws: Floats, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Has the random generators of the scenes `rows` draw what is given."""
        scenes = self.episodes.scenes
        given = with_draws(seeded(seeds), draws)
        if scenes.generator.shape[1] != given.shape[1]:
            generator = np.zeros((len(scenes.generator), given.shape[1]), dtype=np.uint64)
            self.episodes.scenes = scenes._replace(generator=generator)
            vars(self).pop("state", None)
        self.episodes.scenes.generator[rows] = given

    def renew(self, rows: Ints, agents: Ints, times_s: Floats) -> Vehicles:
        scenes = self.episodes.scenes
        table = scenes.vehicles
        for k, egos in self.configured.items():
            egos.keep(rows[self.drivers[rows, 0] == k])
        x, y, was_there = table["x"][rows], table["y"][rows], self._present[rows]
        task, inflow = self.episodes.task, self._inflow
        if task.comes_and_goes:
            task.follow(scenes, rows)
        numbers = inflow.flow(scenes, rows, times_s) if inflow else None
        is_there = table["kind"][rows] > OBSTACLE
        has_stayed = was_there & (table["x"][rows] == x) & (table["y"][rows] == y)
        has_entered = is_there & ~has_stayed
        entry = self._seen.entry[rows]
        later = entry.max(axis=1, keepdims=True) + has_entered.cumsum(axis=1)
        entry = np.where(has_entered, later if numbers is None else numbers, entry)
        if inflow is None and self._settings.vehicle_types and has_entered.any():
            known = self._settings, self.egos, rows, self._seeds[rows]
            set_types(scenes, *known, entry, has_entered)
            is_there = table["kind"][rows] > OBSTACLE
            has_entered &= is_there
        some, places = np.nonzero(has_entered)
        entered = rows[some], places
        self._seen.entry[entered] = number = entry[some, places]
        self.drivers[entered] = agents[some, (number - entry.shape[1]) % agents.shape[1]]
        for b, i in np.transpose(entered).tolist() if inflow else ():
            task.send(scenes, b, i)
        changed = rows[(is_there != was_there).any(axis=1) | has_entered.any(axis=1)]
        self._seat(changed)
        self._moved[changed] = True
        gone, left = np.nonzero(was_there & ~is_there)
        for b, i in zip(np.append(rows[gone], entered[0]), np.append(left, places), strict=True):
            scenes.ways["lanes"][b, i] = -1
        for each in zip(*entered, strict=True):
            self._aim(each)
        self._fault.forget(scenes, entered)
        return entered

    def _aim(self, vehicle: tuple[Any, Any]) -> None:
        """Gives a vehicle of an agent, which has just appeared, its first target speed."""
        target_speed = self.episodes.scenes.vehicles["target_speed"]
        kind = self._kinds[vehicle]
        if self.drivers[vehicle] in self._followers:
            return
        if kind == BY_CONTROLS:
            target_speed[vehicle] = 0.0
        elif kind == BY_TARGETS and (speeds := self._rule_of(vehicle).speeds).size:
            target_speed[vehicle] = nearest_target_speed(target_speed[vehicle], 0, speeds)

    def _seat(self, rows: Ints) -> None:
        """Gives the vehicles of the scenes `rows` to their drivers."""
        vehicles, drivers = self.episodes.scenes.vehicles, self.drivers[rows]
        kinds = np.full(drivers.shape, BY_TARGETS)
        kinds[_are(drivers, self._models)] = BY_MODEL
        follows = _are(drivers, self._followers)
        kinds[_are(drivers, self._continuous) | follows] = BY_CONTROLS
        kinds[_are(drivers, self.configured)] = BY_CONFIGURATION
        if (kinds[:, 1:] == BY_CONFIGURATION).any():
            raise InputError(f"{ONLY_EGOS}; let another agent drive the traffic")
        self._present[rows] = vehicles["kind"][rows] > OBSTACLE
        kinds[_are(drivers, self._prescribed) | ~self._present[rows]] = BY_ENVIRONMENT
        self._kinds[rows] = kinds
        if self.moments is not None:
            vehicles["checks_collisions"][rows] = ~follows
        vehicles["kind"][rows] = np.where(
            kinds == BY_ENVIRONMENT,
            vehicles["kind"][rows],
            np.where(kinds == BY_CONTROLS, CONTINUOUS, COMMANDED),
        )
        for k, egos in self.configured.items():
            vehicles["kind"][rows[drivers[:, 0] == k], 0] = egos.kind
        if self._views is self._seen and (kinds * ~follows)[:, 1:].any():
            scenes, widths = self._seen, (self._seen.parameters, self._seen.memory)
            count = scenes.x.size
            self._views = Scene.empty(self._settings, count, *(each.shape[2] for each in widths))
            self._views.active[:] = True
            vars(self).pop("_shown_views", None)

    def settle(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        scenes, was_driven = self.episodes.scenes, self._kinds[rows]
        vehicles, present = scenes.vehicles, self._present[rows]
        has_left = (vehicles["kind"][rows] > OBSTACLE) & ~present
        has_entered = (vehicles["kind"][rows] == NOTHING) & present
        some, places = np.nonzero(has_left)
        vehicles["kind"][rows[some], places] = NOTHING
        if has_entered.any():
            assert self.moments is not None
            some, places = np.nonzero(has_entered)
            numbers = self.moments.numbers_of(seeds)[some]
            self.episodes.task.enter(scenes, (rows[some], places), numbers)
        list_all_by_place(scenes, rows)
        self._seat(rows)
        self._moved[rows] = True
        some, places = np.nonzero(has_left | has_entered)
        scenes.ways["lanes"][rows[some], places] = -1
        some, places = np.nonzero(present & (self._kinds[rows] != was_driven))
        for each in zip(rows[some], places, strict=True):
            self._aim(each)

    def saved(self, rows: Ints) -> NDArray[np.uint8]:
        self._show(rows[self._moved[rows]])  # which finds the ways, a part of the state
        own = chain.from_iterable(egos.state for egos in self.configured.values())
        return pack((*self._kept.values(), *own), rows)

    def check(self, state: SceneState) -> None:
        expected = width_of(self._kept.values())
        if state.network.shape[1] not in (expected, expected + self._bytes_of_configured):
            found = state.network.shape[1]
            raise InputError(f"network: found {found} bytes per scene, expected {expected}")
        places, scenes = self._seen.x.shape[1], self.episodes.scenes
        lane = 0, scenes.road.lanes.size - 1
        step, place, any_lane = (0, ROUTE_STEPS), (-1, places - 1), (-1, lane[1])
        bounds = {
            "kind": (0, len(KINDS) - 1),
            "speed_index": (0, max(scenes.target_speeds.size, 1) - 1),
            "lane": lane,
            **dict.fromkeys(("route_step", "route_end", "step of ways"), step),
            **dict.fromkeys(("route_roads", "route_numbers", "lanes of ways"), any_lane),
            "entries.vehicle": place,
            "entries.follower": place,
            "entries.lane": any_lane,
            "order.place": (0, places - 1),
            "open_lanes of ways": (0, lane[1] + 1),
            "entered": (0, self.arrivals),
            "free_acceleration": (-_LARGEST_POWER, _LARGEST_POWER),
        }
        parts = unpack(state.network, self._kept)
        check_values(parts, bounds, may_be_nan="entries.")
        if not ((lane[0] <= state.target_lane) & (state.target_lane <= lane[1])).all():
            raise InputError(f"target_lane: expected lanes from 0 to {lane[1]}")
        if (np.sort(parts["order"]["place"], axis=1) != np.arange(places)).any():
            raise InputError("network: order.place: expected each place once")

    def restore(
        self, rows: Ints, seeds: NDArray[np.uint64], saved: NDArray[np.uint8] | None = None
    ) -> None:
        assert saved is not None
        kept = self._kept
        for name, part in unpack(saved, kept).items():
            kept[name][rows] = part
        self._fault.start(rows)
        start = width_of(kept.values())
        is_own = saved.shape[1] == start + self._bytes_of_configured
        for egos in self.configured.values():
            egos.resume(rows)
            for array in egos.state if is_own else ():
                array[rows] = unpack(saved[:, start:], {"": array})[""]
                start += width_of((array,))
        self._seed(rows, seeds)
        vehicles = self.episodes.scenes.vehicles
        had_targets = vehicles["kind"][rows] > CONTINUOUS
        self._seat(rows)
        gets_targets = (vehicles["kind"][rows] == COMMANDED) & ~had_targets
        speed, target_speed = vehicles["speed"][rows], vehicles["target_speed"][rows]
        target_speed = np.where(gets_targets, speed, target_speed)
        is_controlled = vehicles["kind"][rows] <= CONTINUOUS
        target_speed *= (self._kinds[rows] == BY_ENVIRONMENT) | ~is_controlled
        vehicles["target_speed"][rows] = target_speed
        if self._script is not None:
            follows = _are(self.drivers, self._followers)
            self._script.resume(self.episodes.scenes, rows, seeds, follows)
        self._show(rows)

    @property
    def _bytes_of_configured(self) -> int:
        return sum(width_of(egos.state) for egos in self.configured.values())

    @property
    def _kept(self) -> dict[str, NDArray[Any]]:
        """The arrays [B, ...] from which scenes continue, beside those of `state`."""
        scenes = self.episodes.scenes
        entered = self._inflow.entered if self._inflow else np.zeros((len(scenes.order), 0), int)
        return {
            **{name: scenes.vehicles[name] for name in _NETWORK_ONLY},
            "order": scenes.order,
            "time": scenes.time,
            "steps": scenes.steps,
            "entries": self._entries.table,
            "goals": self.goals,
            "entered": entered,
            **{f"{name} of ways": scenes.ways[name] for name in WAY.names or ()},
        }

    def plan(self, row: int) -> Plan:
        """Where the vehicles of a scene are on its network, for pictures."""
        return plan_of(self._lines, self.episodes.scenes, row)

    @cached_property
    def _lines(self) -> Lines:
        return lines_of(self.episodes.scenes.road)

    def views(self) -> RoadViews:
        return RoadViews(self._settings, self.episodes.scenes, self.state, self._fault)

    def seen_by(self, vehicles: Vehicles) -> tuple[Scene, Vehicles]:
        rows, places = vehicles
        if not places.any():
            self._show(np.nonzero(self._moved)[0])
            return self._shown, vehicles
        scenes, views = self.episodes.scenes, self._views
        known = self._seen.unpacked, views.unpacked
        show_each(scenes, *known, rows, places)
        return self._shown_views, (self._views_of(vehicles), places)

    def _views_of(self, vehicles: Vehicles) -> Ints:
        """What M vehicles see, as indices of `_views`."""
        return np.asarray(vehicles[0] * self._seen.x.shape[1] + vehicles[1])

    def _rule_of(self, vehicle: tuple[Any, Any]) -> Any:
        """How a vehicle carries out meta-actions."""
        agent, is_ego = int(self.drivers[vehicle]), bool(vehicle[1] < self.egos)
        return self._rules.get((agent, is_ego), self._rules[-1, is_ego])

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        rows, places = vehicles
        if not rows.size:
            return
        if egos := self.configured.get(int(self.drivers[rows[0], places[0]])):
            egos.act(rows, actions)
            return
        if actions.ndim == 2:
            control = controls_of(actions)
            scene = self.scene
            scene.acceleration[vehicles], scene.steering[vehicles] = control
            table = self.episodes.scenes.vehicles
            table["acceleration"][vehicles], table["steering"][vehicles] = control
            return
        for role, each, some in self._by_role(vehicles):
            rule = self._rule_of((each[0][0], each[1][0]))
            if role == EGO:
                command(self.scene, *each, actions[some], rule)
            else:
                view = self._views_of(each), each[1]
                command(self._views, *view, actions[some], rule)
                self._seen.repeats[each] = self._views.repeats[view]
                self._carry_out(each)

    def _by_role(self, vehicles: Vehicles) -> Iterator[tuple[int, tuple[Ints, Ints], Ints]]:
        """Those of M vehicles that have a role, if there are any, and their indices."""
        rows, places = vehicles
        roles = np.where(places >= self.egos, TRAFFIC, np.where(places > 0, OTHER_EGO, EGO))
        for role in (EGO, OTHER_EGO, TRAFFIC):
            some = np.nonzero(roles == role)[0]
            if some.size:
                yield role, (rows[some], places[some]), some

    def _carry_out(self, vehicles: Vehicles) -> None:
        """Has M vehicles of the traffic do what their views say."""
        scenes, views = self.episodes.scenes, self._views
        known = self._seen.unpacked, views.unpacked
        carry_out(scenes, *known, *vehicles)

    def advance(self, hold_egos: bool = False, before_move: BeforeMove | None = None) -> None:
        scene = self._seen
        rows, others = np.nonzero(scene.active)[0], []
        for agent, model in self._models.items():
            if model.follows_recording and self.moments is not None:
                continue
            found = vehicles_of(agent, self.drivers, scene.active, self._present, scene.entry)
            for role, each, _ in self._by_role(found):
                if role != EGO or not hold_egos:
                    self._drive(model, each)
                if role == TRAFFIC:
                    self._carry_out(each)
                elif role == OTHER_EGO:
                    others.append(each)
        for each in others:  # with the ego, so that egos are alike
            self._carry_out(each)
        put = None if self.moments is None or before_move is None else before_move()
        if self._script is not None:
            follows = _are(self.drivers, self._followers) & self._present
            put = self._script.put(self.episodes.scenes, rows, follows)
        known = scene.unpacked, self._views.unpacked
        advance(self.episodes.scenes, *known, rows, ~self._moved[rows], self._kinds, put)
        self._moved[rows] = True
        self.episodes.scenes.time[rows] += 1 / self._settings.simulation_hz
        if self._script is not None:
            self._script.show_targets(self.episodes.scenes)
        for egos in self.configured.values():
            egos.keeps[rows] = False
        self._entries.note(self.episodes.scenes, rows)
        self._fault.note(self.episodes.scenes, rows)
        if self.has_goal:
            task, before = self.episodes.task, self.episodes.scenes.ways["lanes"][:, 0, BEHIND - 1]
            self.goals[rows] = task.has_reached_goal(self.episodes.scenes, before)[rows]

    def _drive(self, model: DriverModel, vehicles: Vehicles) -> None:
        """Has a driver model answer for M vehicles of one role."""
        shown, seats = self.seen_by(vehicles)
        ways = self.episodes.scenes.ways
        is_traffic = shown is self._shown_views and bool(seats[1][0])
        scene = self._views if is_traffic else self.scene
        kinds = np.empty(vehicles[0].size, dtype=np.complex128)  # pairs that are sorted fast
        kinds.real, kinds.imag = ways["open_lanes"][vehicles], ways["speed_limit"][vehicles]
        for kind in np.unique(kinds):
            some, lanes, limit = np.nonzero(kinds == kind)[0], int(kind.real), float(kind.imag)
            each = seats[0][some], seats[1][some]
            answers = model.drive(self._on_road(is_traffic, lanes, limit), each)
            obey(scene, *each, *answers)
        if is_traffic:
            self._seen.memory[vehicles] = self._views.memory[seats]

    def _on_road(self, is_traffic: bool, lanes: int, speed_limit: float) -> Scene:
        """What driver models see whose road has so many lanes and that limit."""
        key = is_traffic, lanes, speed_limit
        if key not in self._roads:
            shown = self._shown_views if is_traffic else self._shown
            road = shown.road._replace(lanes=lanes, speed_limit=speed_limit)
            views = self._seen.x.shape[1] if is_traffic else 1
            self._roads[key] = shown._replace(road=road).at(self._junctions(views))
        return self._roads[key]


def _are(drivers: Ints, agents: Collection[int]) -> Bools:
    """Whether each driver is one of some agents, of which there are mostly none."""
    return np.isin(drivers, list(agents)) if agents else np.zeros(drivers.shape, dtype=np.bool_)
