"""The state of scenes at a simulation step: everything that decides what follows.

Both engines save and continue the same arrays, so a state that one engine has saved continues in
the other. What follows from positions and headings, such as neighbours, is computed again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.seats import vacate
from charms_bench.engine.source import Source
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.generator import WORDS
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.road import position
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings

OF_SCENES = ("seeds", "steps", "ending", "generator", "ego", "active", "network")
"""The arrays of scenes; all other arrays are of vehicles."""


@dataclass(frozen=True)
class SceneState:
    """S scenes of N vehicles; fields without a comment are those of `Scene` and `Simulation`."""

    settings: SceneSettings
    agents: tuple[str, ...]
    """Names of agents, in the order in which they act; empty for an ego driven from outside."""
    phase: int
    """Simulation steps of the current decision interval so far; 0 between two decisions."""
    seeds: NDArray[np.uint64]
    """[S]"""
    steps: Ints
    """[S]"""
    ending: Ints
    """[S]"""
    generator: NDArray[np.uint64]
    """[S, 6]"""
    ego: Ints
    """[S]"""
    active: Bools
    """[S]"""
    drivers: Ints
    """[S, N], as all arrays below; the index of each vehicle's agent in `agents`."""
    action: Ints
    has_action: Bools
    collision: Ints
    present: Bools
    entry: Ints
    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats
    steering: Floats
    length: Floats
    width: Floats
    target_speed: Floats
    target_lane: Ints
    repeats: Ints
    crashed: Bools
    timer_s: Floats
    temperament: Floats
    memory: Floats
    """[S, N, Q]"""
    impact_x: Floats
    """0 where `impact` is false, as `impact_y`; and `action` is 0 where `has_action` is false."""
    impact_y: Floats
    impact: Bools
    network: NDArray[np.uint8]
    """[S, W] what the engine of one of highway-env's roads keeps beside; W is 0 on the straight
    road."""
    is_from_file: bool = False
    """Whether a file held it, so that the engine of a road checks it before it continues."""

    def __repr__(self) -> str:
        scenes, vehicles = self.x.shape
        decisions = ", ".join(map(str, self.steps[:8])) + ", ..." * (scenes > 8)
        return f"<SceneState: {scenes} scenes x {vehicles} vehicles, after decisions {decisions}>"

    def __len__(self) -> int:
        return self.seeds.size

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def with_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> "SceneState":
        """The state with some of its arrays replaced."""
        changes: dict[str, Any] = {**arrays}
        return replace(self, **changes)

    @staticmethod
    def joined(states: Sequence["SceneState"]) -> "SceneState":
        """The scenes of several states.

        Raises:
            InputError: The states have different settings, agents or phases.
        """
        first = states[0]
        kind = (first.settings, first.agents, first.phase)
        if any((state.settings, state.agents, state.phase) != kind for state in states):
            raise InputError("states of different settings, agents or phases cannot be joined")
        return first.with_arrays(
            {name: np.concatenate([getattr(state, name) for state in states]) for name in ARRAYS}
        )

    def take(self, rows: Ints | Sequence[int]) -> "SceneState":
        """The scenes with these indices, of which some may be repeated."""
        rows = np.asarray(rows)
        return self.with_arrays({name: array[rows] for name, array in self.arrays().items()})

    def seated(self, places: Ints, agent: str) -> "SceneState":
        """The same scenes, in each of which an agent drives the vehicle at one of the places (S,).

        The name is empty for an ego that is driven from outside; see `driven_by`.
        """
        chosen = np.zeros(self.drivers.shape, dtype=np.bool_)
        chosen[np.arange(len(self)), places] = True
        return self.driven_by(agent, chosen)

    def driven_by(self, agent: str, chosen: Bools) -> "SceneState":
        """The same scenes, in which an agent drives the chosen vehicles [S, N].

        A new driver remembers nothing. After continuous actions, the vehicle's speed becomes its
        target speed.
        """
        agents = self.agents if agent in self.agents else (*self.agents, agent)
        names = ("drivers", "action", "has_action", "target_speed", "memory", "repeats")
        arrays = {name: getattr(self, name).copy() for name in names}
        drivers, action, has_action, target_speed, memory, repeats = arrays.values()
        changed = chosen & (drivers != agents.index(agent))
        drivers[changed], action[changed], has_action[changed] = agents.index(agent), 0, False
        memory[changed], repeats[changed] = 0.0, 0
        # As `ControlledVehicle.__init__`: a vehicle without a target speed keeps its speed.
        speed = self.speed[changed]
        target_speed[changed] = np.where(target_speed[changed], target_speed[changed], speed)
        return replace(self, agents=agents, **arrays)

    def without(self, places: Ints) -> "SceneState":
        """The same scenes, in each of which the vehicle at one of the places (S,) has left.

        Raises:
            InputError: There is no vehicle, or it is the ego.
        """
        each = (np.arange(len(self)), places)
        if (wrong := ~self.present[each] | (places == self.ego)).any():
            scene = int(wrong.argmax())
            what = "is the ego" if places[scene] == self.ego[scene] else "has left already"
            raise InputError(f"scene {scene}: vehicle {places[scene]} {what}")
        present = self.present.copy()
        present[each] = False
        return replace(self, present=present)

    def joined_by(self, agent: str, lane: Ints, x: Floats, speed: Floats) -> "SceneState":
        """The same scenes, in each of which a vehicle of the profile's size enters an empty place.

        It heads along its lane (S,) at x (S,), m, and wants the speed (S,) that it has, m/s.

        Raises:
            InputError: A scene is full.
        """
        if (full := self.present.all(axis=1)).any():
            vehicles = self.settings.vehicles
            raise InputError(f"scene {full.argmax()} is full: it has {vehicles} vehicles already")
        each = (np.arange(len(self)), (~self.present).argmax(axis=1))
        profile, arrays = self.settings.profile, self.arrays()
        values = {name: 0 for name in ARRAYS if name not in OF_SCENES} | {
            "present": True,
            "entry": self.entry.max(axis=1) + 1,
            "x": x,
            "y": position(self.settings.road, lane, x, 0.0)[1],
            "speed": speed,
            "length": profile.vehicle_length_m,
            "width": profile.vehicle_width_m,
            "target_speed": speed,
            "target_lane": lane,
            "temperament": 0.5,
        }
        for name, value in values.items():
            arrays[name] = arrays[name].copy()
            arrays[name][each] = value
        return self.with_arrays(arrays).seated(each[1], agent)

    def __eq__(self, other: object) -> bool:
        """Whether all values are the same to the last bit."""
        if not isinstance(other, SceneState):
            return NotImplemented
        own = (self.settings, self.agents, self.phase)
        return own == (other.settings, other.agents, other.phase) and all(
            np.array_equal(array, getattr(other, name)) for name, array in self.arrays().items()
        )

    __hash__ = None  # type: ignore[assignment]  # arrays have none


ARRAYS = tuple(each.name for each in fields(SceneState))[3:-1]
"""The fields that are arrays."""
OF_SCENE = tuple(name for name in ARRAYS if name != "network")
"""Those that `Scene` and `Simulation` have."""


def _holder(simulation: RunningEpisodes, name: str) -> Any:
    """What has an array in a simulation."""
    if name == "drivers":
        return simulation.engine
    return simulation.engine.state if name in Scene._fields else simulation


def state_of(simulation: RunningEpisodes, rows: Ints) -> SceneState:
    """Saves the scenes `rows` (S,) of a simulation."""
    arrays = {name: getattr(_holder(simulation, name), name)[rows] for name in OF_SCENE}
    arrays["generator"] = arrays["generator"][:, :WORDS]  # given draws are no part of a state
    arrays["action"][~arrays["has_action"]] = 0
    arrays["impact_x"][~arrays["impact"]] = 0.0
    arrays["impact_y"][~arrays["impact"]] = 0.0
    if simulation.settings.network is None:
        arrays["x"][~arrays["present"]] = 0.0
    arrays["network"] = simulation.engine.saved(rows)
    return SceneState(simulation.settings, simulation.agents, simulation.phase, **arrays)


def restore(
    simulation: RunningEpisodes, sources: Sequence[Source], state: SceneState, rows: Ints
) -> None:
    """Continues the scenes of a state in the scenes `rows` (S,) of a simulation.

    Raises:
        InputError: The state does not fit the simulation; the simulation is then unchanged.
    """
    check_settings(state.settings, simulation.settings)
    if rows.size != len(state):
        raise InputError(f"a state of {len(state)} scenes cannot continue in {rows.size} scenes")
    others = simulation.scene.active.copy()
    others[rows] = False
    if others.any() and simulation.phase != state.phase:
        raise InputError(
            f"the state was saved {state.phase} simulation steps after a decision; the other "
            f"scenes are {simulation.phase} steps after theirs, and all scenes decide together"
        )
    if state.is_from_file:
        simulation.engine.check(state)
    index = _agents_in(simulation, state)
    simulation.phase = state.phase
    for name, array in {**state.arrays(), "drivers": index[state.drivers]}.items():
        if name not in ("memory", "network"):
            getattr(_holder(simulation, name), name)[rows] = array
    # With other agents, it can be wider or narrower; no agent that is here declares what is cut.
    memory = simulation.scene.memory
    width = min(memory.shape[2], state.memory.shape[2])
    memory[rows] = 0.0
    memory[rows, :, :width] = state.memory[:, :, :width]
    if simulation.settings.network is None:
        vacate(simulation.scene, rows)
    for source in sources:
        source.resume(rows)
    simulation.engine.restore(rows, state.seeds, state.network)
    set_parameters(simulation, rows)


def check_settings(found: SceneSettings, expected: SceneSettings) -> None:
    """Rejects a state of other scenes; the `InputError` names the first field that differs."""
    if found is expected or found == expected:
        return
    if found.scenario != expected.scenario:
        raise InputError("the state is of another scenario; use the one with which it was saved")
    roads = [str(each.network or "a straight road") for each in (found, expected)]
    if roads[0] != roads[1]:
        raise InputError(f"the state is of {roads[0]}, and this scene is on {roads[1]}")
    field, one, other = _first_difference(found.model_dump(), expected.model_dump())
    raise InputError(
        f"the state is of another scene: {field} is {one}, and here it is {other}; use the scene "
        "settings with which the state was saved"
    )


def _first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, Any, Any]:
    name = next(name for name in {**one, **other} if one.get(name) != other.get(name))
    if not isinstance(one.get(name), Mapping):
        return name, one.get(name), other.get(name)
    field, *values = _first_difference(one[name], other[name])
    return f"{name}.{field}", *values


def _agents_in(simulation: RunningEpisodes, state: SceneState) -> Ints:
    """The index that each of the state's agents has in the simulation; -1 if it drives nobody."""
    own = {name: k for k, name in enumerate(simulation.agents)}
    seats = np.bincount(state.drivers.ravel(), minlength=len(state.agents))
    index = np.full(len(state.agents), -1)
    models = []
    for k in np.nonzero(seats)[0]:
        name = state.agents[k]
        if name not in own:
            what = f"agent '{name}' drives" if name else "nobody inside drives"
            raise InputError(
                f"in the state, {what} a vehicle, which is not so in this simulation. "
                f"{suggestion(name, own)}"
            )
        index[k] = own[name]
        if isinstance(simulation.made.get(own[name]), DriverModel):
            models.append(own[name])
    if models != sorted(models):
        names = ", ".join(simulation.agents[k] for k in models)
        raise InputError(
            f"in the state, driver models act in the order {names}; here, in the order "
            f"{', '.join(simulation.agents[k] for k in sorted(models))}"
        )
    return index
