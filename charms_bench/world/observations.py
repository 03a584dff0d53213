"""The observations of policies.

`neighbours` and `paper_neighbours` are (7, 5) float32, one row per vehicle: presence, x, y, vx, vy.
Row 0 is the vehicle itself: 1, its x, y / 12 m, and its velocity / 66 m/s. Rows 1 to 6 are its
nearest neighbours on its own lane and on those beside it, relative to it: x / 165 m, y / 12 m,
velocity / 66 m/s, clipped to [-1, 1]. A row without a neighbour is all zeros. They differ in three
respects:

- In `neighbours`, neighbours follow highway-env's rule (`Scene.leader`): a vehicle between two
  lanes is a neighbour on both. In `paper_neighbours`, a vehicle is on the lane nearest to it, and
  so in at most one row. At the same x, it is in a row behind.
- The range is 99 m along the road, inclusive, or the Euclidean distance below 99 m.
- The vehicle's own x is 1, or its position along the road / 165 m, at most 1.

A lane that does not exist looks like one without vehicles. Two options add a row each, as in
`{type: neighbours, commands: true}`:

- `commands`: row 7, `COMMANDS`, has what the vehicle is about to do: its target speed less its
  speed / 10 m/s, how often FASTER (or, negative, SLOWER) was its last meta-action in a row / 4, its
  target lane less its lane, its last acceleration / 10 m/s2, and 0. With target speeds that change
  by growing steps, the same scene calls for other actions at another place in the sequence.
- `action_mask`: the last row, `ACTION_MASK`, is the vehicle's action mask, one column for each of
  `DEFAULT_ACTIONS`; see `charms_bench.world.action_mask`.

`paper_neighbours` is the observation of the networks that the paper's authors released.

`Kinematics` is highway-env's own observation, with its options; see
`charms_bench.world.kinematics_observation`. `highway_env` has the observation and the actions of a
configuration of highway-env; see `charms_bench.world.highway_env_observation`. `interaction` has
the vehicles along and across the way of a vehicle on any road; see
`charms_bench.world.interaction_observation`.
"""

import json
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np
from pydantic import ValidationError

from charms_bench.errors import InputError, first_problem, suggestion
from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.foundation.fields import FrozenModel
from charms_bench.foundation.files import json_of
from charms_bench.world.action_mask import action_masks
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.highway_env_observation import HighwayEnv
from charms_bench.world.interaction_observation import Interaction
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.road import side_lanes
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles


class Observation(Protocol):
    """What a policy observes. `OBSERVATIONS` lists the observations that have a name."""

    @property
    def shape(self) -> tuple[int, ...]:
        """That of one vehicle's observation, mostly rows and columns."""

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, *shape)."""


ObservationLike = str | Mapping[str, Any] | Observation
"""An observation, its name, or its name and options: `{type: name, option: value}`."""

EGO, LEFT_FRONT, LEFT_REAR, FRONT, REAR, RIGHT_FRONT, RIGHT_REAR = range(7)
"""The rows of `neighbours` and `paper_neighbours`."""
COMMANDS, ACTION_MASK = 7, -1
"""Their rows with the options of these names."""
TRAINED_IN = "charms_bench"
"""The attribute in which the observation space of an environment says which environment it is, by
what a checkpoint of a training there can be told from others."""
X_SCALE_M = 165.0
Y_SCALE_M = 12.0
SPEED_SCALE_MPS = 66.0
RANGE_M = 99.0
CHANGE_SCALE, REPEATS_SCALE = 10.0, 4.0
"""The row `COMMANDS` has changes of speed over `CHANGE_SCALE` m/s and accelerations over
`CHANGE_SCALE` m/s2."""


class Neighbours(FrozenModel):
    """The observation `neighbours`."""

    name: ClassVar[str] = "neighbours"

    commands: bool = False
    """Whether there is a row with what the vehicle is about to do."""
    action_mask: bool = False
    """Whether the last row is the vehicle's action mask."""

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of one vehicle's observation."""
        return 7 + self.commands + self.action_mask, 5

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, 7, 5), and a row more for each option."""
        observations = np.zeros((vehicles[0].size, *self.shape), dtype=np.float32)
        self._fill(scene, vehicles[0], vehicles[1], observations)
        if self.commands:
            observations[:, COMMANDS, :4] = commands_of(scene, vehicles)
        if self.action_mask:
            observations[:, ACTION_MASK] = action_masks(scene, vehicles)
        return observations

    def _fill(self, scene: Scene, *others: Any) -> None:
        _fill(scene, *others)


class PaperNeighbours(Neighbours):
    """The observation `paper_neighbours`."""

    name: ClassVar[str] = "paper_neighbours"

    def _fill(self, scene: Scene, *others: Any) -> None:
        _fill_as_in_the_paper(scene, *others)


neighbours = Neighbours()
paper_neighbours = PaperNeighbours()

NamedObservation = Neighbours | Kinematics | Interaction | HighwayEnv
OBSERVATIONS: dict[str, type[NamedObservation]] = {
    kind.name: kind for kind in (Neighbours, PaperNeighbours, Kinematics, Interaction, HighwayEnv)
}
"""The observations that have a name."""


def observation_of(like: ObservationLike) -> Observation:
    """The observation itself, made from its name and options if need be.

    Raises:
        InputError: The name is unknown, or the options are wrong.
    """
    return like if callable(like) else named_observation(like)


def named_observation(like: str | Mapping[str, Any]) -> NamedObservation:
    """The observation of a name, or of `{type: name, option: value}`; see `observation_of`."""
    options = dict(like) if isinstance(like, Mapping) else {"type": like}
    name = str(options.pop("type", None))[:80]
    if name not in OBSERVATIONS:
        raise InputError(f"no observation named '{name}'. {suggestion(name, OBSERVATIONS)}")
    try:
        return OBSERVATIONS[name].model_validate(options)
    except ValidationError as error:
        location, what = first_problem(error)
        raise InputError(f"observation {name}: {'.'.join(map(str, location))}: {what}") from error


def described(observation: NamedObservation) -> str:
    """An observation as text, for the metadata of an ONNX file."""
    options = observation.model_dump(mode="json")
    if not isinstance(observation, Neighbours):
        return json.dumps({"type": observation.name, **options})
    if options := {name: value for name, value in options.items() if value}:
        return json.dumps({"type": observation.name, **options})
    text = (
        f"{observation.name}: (7, 5) float32, rows self, left front, left rear, front, rear, "
        "right front, right rear; columns presence, x / 165 m, y / 12 m, vx / 66 m/s, vy / 66 m/s"
    )
    if observation == paper_neighbours:
        text += (
            "; each vehicle on the lane nearest to it, within 99 m between centres; x of self along"
            " the road, at most 1"
        )
    return text


def observation_described(text: str) -> NamedObservation:
    """The observation that a text from `described` describes; else an `InputError`."""
    if not text.startswith("{"):
        return named_observation(text.partition(":")[0])
    try:
        return named_observation(json_of(text.encode()))
    except ValueError as error:
        raise InputError(f"observation: is not JSON: {error}") from error


def commands_of(scene: Scene, vehicles: Vehicles) -> Floats:
    """The row `COMMANDS` of M vehicles without its last column, (M, 4)."""
    return np.stack(
        [
            (scene.target_speed[vehicles] - scene.speed[vehicles]) / CHANGE_SCALE,
            scene.repeats[vehicles] / REPEATS_SCALE,
            scene.target_lane[vehicles] - scene.lane[vehicles],
            scene.acceleration[vehicles] / CHANGE_SCALE,
        ],
        axis=1,
    )


@compiled_of_scenes
def _fill(scene: Scene, rows: Ints, places: Ints, observations: Observations) -> None:
    """Writes the observations `neighbours` of M vehicles."""
    x = scene.x
    for m in range(rows.size):
        b, i = rows[m], places[m]
        _write_own_row(b, i, scene, observations[m])
        observations[m, EGO, 1] = 1.0
        for side, candidate in enumerate((LEFT, OWN, RIGHT)):
            found = scene.leaders[b, i, candidate], scene.followers[b, i, candidate]
            for behind, j in enumerate(found):
                if j >= 0 and abs(x[b, j] - x[b, i]) <= RANGE_M:
                    _write_neighbour(b, i, j, scene, observations[m, 1 + 2 * side + behind])


@compiled_of_scenes
def _fill_as_in_the_paper(
    scene: Scene, rows: Ints, places: Ints, observations: Observations
) -> None:
    """Writes the observations `paper_neighbours` of M vehicles."""
    x, y, lane, order, rank = scene.x, scene.y, scene.lane, scene.order, scene.rank
    for m in range(rows.size):
        b, i = rows[m], places[m]
        _write_own_row(b, i, scene, observations[m])
        left, right = side_lanes(scene.road, lane[b, i])
        observations[m, EGO, 1] = min(x[b, i] / X_SCALE_M, 1.0)
        for step in (1, -1):
            k = rank[b, i] + step
            while 0 <= k < order.shape[1]:
                j = order[b, k]
                k += step
                ahead, across = x[b, j] - x[b, i], y[b, j] - y[b, i]
                if not abs(ahead) < RANGE_M:
                    break
                on = lane[b, j]
                side = 0 if on == left else 1 if on == lane[b, i] else 2
                row = 1 + 2 * side + (not ahead > 0)
                if (
                    (side < 2 or on == right)
                    and observations[m, row, 0] == 0
                    and np.sqrt(ahead * ahead + across * across) < RANGE_M
                ):
                    _write_neighbour(b, i, j, scene, observations[m, row])


@compiled
def _write_own_row(b: int, i: int, scene: Scene, observation: Observations) -> None:
    """Writes row 0 of vehicle i, except for x."""
    observation[EGO, 0] = 1.0
    observation[EGO, 2] = scene.y[b, i] / Y_SCALE_M
    observation[EGO, 3] = scene.speed[b, i] * scene.direction_x[b, i] / SPEED_SCALE_MPS
    observation[EGO, 4] = scene.speed[b, i] * scene.direction_y[b, i] / SPEED_SCALE_MPS


@compiled
def _write_neighbour(b: int, i: int, j: int, scene: Scene, row: Observations) -> None:
    """Writes the row of vehicle j, relative to vehicle i."""
    x, y, speed = scene.x, scene.y, scene.speed
    vx, vy = speed[b, i] * scene.direction_x[b, i], speed[b, i] * scene.direction_y[b, i]
    other_vx = speed[b, j] * scene.direction_x[b, j]
    other_vy = speed[b, j] * scene.direction_y[b, j]
    row[0] = 1.0
    row[1] = clip((x[b, j] - x[b, i]) / X_SCALE_M, -1.0, 1.0)
    row[2] = clip((y[b, j] - y[b, i]) / Y_SCALE_M, -1.0, 1.0)
    row[3] = clip((other_vx - vx) / SPEED_SCALE_MPS, -1.0, 1.0)
    row[4] = clip((other_vy - vy) / SPEED_SCALE_MPS, -1.0, 1.0)
