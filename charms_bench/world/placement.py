"""Concrete scenarios: where each vehicle of an episode starts, and what is prescribed for it."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import ScenarioError, suggestion
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.formula import Formula, evaluate
from charms_bench.world.lane_geometry import END_MARGIN_M
from charms_bench.world.parameter_points import count_of, values_at
from charms_bench.world.road import position
from charms_bench.world.scenario import EGO, Action, EgoStart, PlacedVehicle, Scenario
from charms_bench.world.scene import SceneSettings
from charms_bench.world.vehicle_types import LENGTHS_M, WIDTHS_M

Location = tuple[str | int, ...]


def place_of(i: int) -> Location:
    """Where vehicle i is in a scenario."""
    return ("vehicles", i - 1) if i else (EGO,)


class Placement(NamedTuple):
    """The starts of R scenes of N vehicles, the ego first, and K actions of each kind.

    An action that a vehicle does not have begins at infinity.
    """

    x: Floats
    """[R, N] m; on a road that is not straight, along the lane."""
    lane: NDArray[np.int64]
    """[R, N]"""
    speed: Floats
    """[R, N] m/s."""
    length: Floats
    """[R, N] m."""
    width: Floats
    """[R, N] m."""
    brakes_at: Floats
    """[R, N, K] when a prescribed acceleration begins, s."""
    acceleration: Floats
    """[R, N, K] m/s2."""
    until: Floats
    """[R, N, K] the speed at which it ends, m/s."""
    moves_at: Floats
    """[R, N, K] when a movement across the road begins, s."""
    duration: Floats
    """[R, N, K] s."""
    moves_to: NDArray[np.int64]
    """[R, N, K] its lane; on a road that is not straight, counted from the left."""
    moves_by: Floats
    """[R, N, K] its displacement, m."""


def place(
    scenario: Scenario,
    settings: SceneSettings,
    numbers: NDArray[Any],
    kind: "type[Placing] | None" = None,
) -> Placement:
    """Returns the concrete scenarios of the points (R,) with these numbers.

    `kind` places the vehicles; by default, on the straight road. Raises a `ScenarioError` if a
    formula is wrong, or a point has an impossible placement.
    """
    _check_points(scenario, numbers)
    values = values_at(scenario, numbers)
    return (kind or Placing)(scenario, settings, values, numbers.size).placement()


def driver_parameters(
    scenario: Scenario,
    k: int,
    settings: SceneSettings,
    ranges: Mapping[str, tuple[float, float]],
    numbers: NDArray[Any],
) -> dict[str, Floats]:
    """Returns the parameters (R,) that a scenario gives to the driver of its vehicle k, by name.

    `ranges` are those of the parameters that its agent has. Raises a `ScenarioError` if it has no
    such parameter, or the value at one of the points `numbers` (R,) is out of the range.
    """
    vehicle, values = scenario.vehicles[k], values_at(scenario, numbers)
    placing, given = Placing(scenario, settings, values, numbers.size), {}
    for name, formula in vehicle.driver_parameters.items():
        at = ("vehicles", k, "driver_parameters", name)
        if name not in ranges:
            what = f"agent '{vehicle.agent}' has no parameter '{name}'. {suggestion(name, ranges)}"
            raise ScenarioError(at, what)
        given[name] = placing.within(at, formula, *ranges[name])
    return given


def _check_points(scenario: Scenario, numbers: NDArray[Any]) -> None:
    parameters, points, count = scenario.parameters, scenario.points, count_of(scenario)
    last = int(numbers.max(initial=0))
    for k, point in enumerate(points if isinstance(points, tuple) else ()):
        if set(point) != set(parameters):
            found, expected = ", ".join(point), ", ".join(parameters)
            raise ScenarioError(("points", k), f"has {found}; expected values of {expected}")
        for name, value in point.items():
            low, high = parameters[name].range
            if not low <= value <= high:
                what = f"{value:g} is out of range; expected {low:g} to {high:g}"
                raise ScenarioError(("points", k, name), what)
    if count is not None and last >= count:
        raise ScenarioError(
            ("points",), f"has {count:,} points; episode {last} needs {last + 1:,}, because its "
            "seed is the number of its point; `points: random` have no end"
        )  # fmt: skip


class Placing:
    """Evaluates the formulas of a scenario at some points, and checks what comes out.

    A scenario on a road that is not straight is another kind of it; see `roads.scripts`.
    """

    def __init__(
        self, scenario: Scenario, settings: SceneSettings, values: Mapping[str, Floats], count: int
    ) -> None:
        self._scenario, self._values, self._count = scenario, values, count
        self._starts: tuple[EgoStart | PlacedVehicle, ...] = (scenario.ego, *scenario.vehicles)
        self._road, self._c = settings.road, settings.constants

    def placement(self) -> Placement:
        scenario, c = self._scenario, self._c
        vehicles = scenario.vehicles
        actions = max((len(each.actions) for each in vehicles), default=0)
        shape = (self._count, len(vehicles) + 1)
        made = Placement(
            x=np.zeros(shape),
            lane=np.zeros(shape, dtype=np.int64),
            speed=np.zeros(shape),
            length=np.full(shape, c.length),
            width=np.full(shape, c.width),
            brakes_at=np.full((*shape, actions), np.inf),
            acceleration=np.zeros((*shape, actions)),
            until=np.zeros((*shape, actions)),
            moves_at=np.full((*shape, actions), np.inf),
            duration=np.ones((*shape, actions)),
            moves_to=np.zeros((*shape, actions), dtype=np.int64),
            moves_by=np.zeros((*shape, actions)),
        )
        names: dict[str, int] = {}
        for i, vehicle in enumerate(self._starts):
            at = place_of(i)
            name = vehicles[i - 1].name if i else EGO
            if name in names:
                raise ScenarioError((*at, "name"), f"'{name}' is already a vehicle")
            names[name] = i
            low, high = max(0.0, c.speed_min), c.speed_max
            made.speed[:, i] = self.within((*at, "speed_mps"), vehicle.speed_mps, low, high)
            for field, own, bounds in (
                ("length_m", made.length, LENGTHS_M),
                ("width_m", made.width, WIDTHS_M),
            ):
                if (formula := getattr(vehicle, field)) is not None:
                    own[:, i] = self.within((*at, field), formula, *bounds)
            self._put(i, at, names, made)
            self._check_free(i, at, made, list(names))
            for k, action in enumerate(vehicles[i - 1].actions if i else ()):
                self._set_action(i, k, (*at, "actions", k), action, made)
        return made

    def _put(self, i: int, at: Location, names: Mapping[str, int], made: Placement) -> None:
        """Fills in the lane of a vehicle, and where it is along it."""
        vehicle, ends = self._starts[i], (-END_MARGIN_M, self._road.road_length)
        for field in ("road", "destination"):
            if getattr(vehicle, field) is not None:
                what = "is a key on one of the suite's `roads`; remove it on the straight road"
                raise ScenarioError((*at, field), what)
        made.lane[:, i] = self._lane((*at, "lane"), vehicle.lane, self._road.lanes)
        if vehicle.x_m is not None:
            made.x[:, i] = self.within((*at, "x_m"), vehicle.x_m, *ends)
            return
        other, distance = self._from_other(i, at, names, made)
        made.x[:, i] = found = made.x[:, other] + distance
        outside = ~((found >= ends[0]) & (found < ends[1]))
        self._check((*at, "gap_m"), outside, f"off the road, at x {{:g}} m; expected "
                    f"{ends[0]:g} to {ends[1]:g}", found)  # fmt: skip

    def _from_other(
        self, i: int, at: Location, names: Mapping[str, int], made: Placement
    ) -> tuple[int, Floats]:
        """The vehicle to which vehicle i has a gap, and how far ahead of its centre it is, m."""
        vehicle = self._scenario.vehicles[i - 1]
        field = "ahead_of" if vehicle.ahead_of is not None else "behind"
        other = str(getattr(vehicle, field))
        known = {name: place for name, place in names.items() if place < i}
        if other not in known:
            what = f"no vehicle named '{other}' before this one. {suggestion(other, known)}"
            raise ScenarioError((*at, field), what)
        assert vehicle.gap_m is not None
        gap = self._value((*at, "gap_m"), vehicle.gap_m)
        sign = 1.0 if field == "ahead_of" else -1.0
        lengths = (made.length[:, i] + made.length[:, known[other]]) / 2
        return known[other], sign * (gap + lengths)

    def _check_free(self, i: int, at: Location, made: Placement, names: Sequence[str]) -> None:
        """Rejects a vehicle that overlaps one before it."""
        field = "gap_m" if self._starts[i].x_m is None else "x_m"
        for j in range(i):
            least = (made.length[:, i] + made.length[:, j]) / 2
            along, apart = self._between(made, i, j)
            overlaps = (along < least) & (apart < (made.width[:, i] + made.width[:, j]) / 2)
            what = f"overlaps '{names[j]}': {{:g}} m between their centres; expected at least "
            self._check((*at, field), overlaps, f"{what}{least[overlaps.argmax()]:g} m", along)

    def _between(self, made: Placement, i: int, j: int) -> tuple[Floats, Floats]:
        """The distances (R,) between the centres of two vehicles, along the road and across it."""
        apart = self._y_of(made.lane[:, i]) - self._y_of(made.lane[:, j])
        return np.abs(made.x[:, i] - made.x[:, j]), np.abs(apart)

    def _set_action(self, i: int, k: int, at: Location, action: Action, made: Placement) -> None:
        c = self._c
        begins = self.within((*at, "at_s"), action.at_s, 0.0, np.inf)
        if action.acceleration_mps2 is not None:
            limit = 20.0
            asked = (*at, "acceleration_mps2")
            acceleration = self.within(asked, action.acceleration_mps2, -limit, limit)
            ends = np.where(acceleration < 0, max(0.0, c.speed_min), c.speed_max)
            if action.until_mps is not None:
                bounds = (max(0.0, c.speed_min), c.speed_max)
                ends = self.within((*at, "until_mps"), action.until_mps, *bounds)
            made.brakes_at[:, i, k] = begins
            made.acceleration[:, i, k], made.until[:, i, k] = acceleration, ends
            return
        assert action.lane is not None
        assert action.duration_s is not None
        lane = self._lane((*at, "lane"), action.lane, self._road.lanes)
        duration = self.within((*at, "duration_s"), action.duration_s, c.dt, np.inf)
        start, ready = made.lane[:, i], np.full(self._count, -np.inf)
        for earlier in range(k):
            has_moved = made.moves_at[:, i, earlier] < np.inf
            start = np.where(has_moved, made.moves_to[:, i, earlier], start)
            ended = made.moves_at[:, i, earlier] + made.duration[:, i, earlier]
            ready = np.where(has_moved, ended, ready)
        self._check((*at, "at_s"), begins < ready - 1e-9, "{:g} s is before the movement before "
                    "it has ended; expected a later time", begins)  # fmt: skip
        made.moves_at[:, i, k], made.duration[:, i, k] = begins, duration
        made.moves_to[:, i, k] = lane
        made.moves_by[:, i, k] = self._y_of(lane) - self._y_of(start)

    def _y_of(self, lane: NDArray[np.int64]) -> Floats:
        return np.asarray(position(self._road, lane, 0.0, 0.0)[1])

    def _lane(
        self, at: Location, formula: Formula, lanes: Any, road: str = "the road"
    ) -> NDArray[np.int64]:
        """The lanes (R,) of a road with so many lanes, which can be (R,) too."""
        last = np.broadcast_to(lanes, (self._count,)) - 1
        lane = self._value(at, formula)
        is_wrong = ~((lane == np.floor(lane)) & (lane >= 0) & (lane <= last))
        most = last[is_wrong.argmax()]
        expected = f"a whole number from 0 to {most}" if most else "0, its only lane"
        named = road.replace("{", "{{").replace("}", "}}")
        self._check(at, is_wrong, f"lane {{:g}} is not on {named}; expected {expected}", lane)
        return np.asarray(lane.astype(np.int64))

    def within(self, at: Location, formula: Formula, low: float, high: float) -> Floats:
        """Returns the value of a formula at each point, which must lie between two bounds."""
        value = self._value(at, formula)
        bounds = f"at least {low:g}" if high == np.inf else f"{low:g} to {high:g}"
        what = f"{{:g}} is out of range; expected {bounds}"
        self._check(at, ~((value >= low) & (value <= high)), what, value)
        return value

    def _value(self, at: Location, formula: Formula) -> Floats:
        try:
            value = evaluate(formula, self._values)
        except ValueError as error:
            raise ScenarioError(at, str(error)) from error
        found = np.broadcast_to(np.asarray(value, dtype=np.float64), (self._count,))
        self._check(at, ~np.isfinite(found), "{:g}; expected a finite number", found)
        return found

    def _check(self, at: Location, is_wrong: NDArray[np.bool_], what: str, found: Floats) -> None:
        """Rejects the first point that is wrong, and gives the values of its parameters."""
        if is_wrong.any():
            k = int(is_wrong.argmax())
            of = ", ".join(f"{name} {each[k]:g}" for name, each in self._values.items())
            where = f" at the point {of}" if of else ""
            raise ScenarioError(at, what.format(found[k]) + where)
