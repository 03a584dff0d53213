"""What if another agent had driven a vehicle from some decision on?"""

from dataclasses import dataclass, replace

import numpy as np

from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import Replay, Seat, replay, simulate
from charms_bench.episodes.what_happened import what_happened
from charms_bench.errors import InputError
from charms_bench.foundation.names import shown_agent
from charms_bench.world.scene import Floats
from charms_bench.world.thresholds import HARSH_MPS2


@dataclass(frozen=True)
class Future:
    """What a vehicle did from a decision until its episode ended."""

    vehicle: int
    """Index in the order of spawning."""
    agent: str
    ending: str
    """How the episode ended for the vehicle."""
    lasted_s: float
    """Time from the decision until then, s."""
    ttc_min_s: float | None
    """Smallest time to collision with the leader, bumper to bumper; None if it never closed in."""
    gap_min_m: float | None
    """Smallest gap to the leader; None if there was none."""
    speed_mps: float
    """Mean speed."""
    lane_changes: int
    hard_braking_s: float
    """How long it braked harder than 2.5 m/s2."""
    braking_max_mps2: float
    """Its strongest braking."""


@dataclass(frozen=True)
class WhatIf:
    """Two futures of one episode, which share all decisions before `step`."""

    recorded: Replay
    other: Replay
    """The episode in which `agent` drives `vehicle` from the decision on."""
    step: int
    """The first decision that may differ; an episode's decisions are counted from 1."""
    vehicle: int
    agent: str

    def __repr__(self) -> str:
        who = "the ego" if self.vehicle == self.recorded.ego else f"vehicle {self.vehicle}"
        what = f"{shown_agent(self.agent)} drives {who} from decision {self.step} on"
        return f"<WhatIf of episode {self.recorded.episode}: {what}>"

    def __str__(self) -> str:
        recorded, instead = self.sentences()
        return f"{self!r}\nRecorded: {recorded}\nWhat if:  {instead}"

    @property
    def start(self) -> int:
        """The frame at which the futures part."""
        return self.recorded.frame_of(self.step - 1)

    def sentences(self) -> tuple[str, str]:
        """The most critical event from the decision on, in the recorded future and the other."""
        recorded = what_happened(self.recorded, since=self.step)
        return recorded, what_happened(self.other, since=self.step)

    def futures(self) -> list[tuple[Future, Future]]:
        """The recorded future and the other one, of the ego and of the vehicle."""
        return [
            (future_of(self.recorded, place, self.start), future_of(self.other, place, self.start))
            for place in dict.fromkeys([self.recorded.ego, self.vehicle])
        ]


def what_if(cell: RecordedCell, episode: int, step: int, agent: str, vehicle: int | None) -> WhatIf:
    """Simulates an episode again, with another agent driving a vehicle from a decision on.

    `step` is the agent's first decision, from 1, and `vehicle` the index in the order of spawning;
    None is the ego. Raises an `InputError` if there is no such decision, agent or vehicle, or the
    vehicle has crashed before or is not there then, and what `replay` raises.
    """
    (recorded,) = replay(cell, [episode])
    decisions, vehicles = recorded.steps.height, len(recorded.agents)
    if not 1 <= step <= decisions:
        raise InputError(f"episode {episode} has the decisions 1 to {decisions}, not {step}")
    place = recorded.ego if vehicle is None else vehicle
    if not 0 <= place < vehicles:
        raise InputError(f"episode {episode} has the vehicles 0 to {vehicles - 1}, not {vehicle}")
    seat, start = Seat(step, place, agent), recorded.frame_of(step - 1)
    if recorded.crashed[start, place]:
        raise InputError(
            f"vehicle {place} has crashed before decision {step} of episode {episode}; choose an "
            "earlier decision or another vehicle"
        )
    if not recorded.present[start, place]:
        raise InputError(
            f"vehicle {place} is not there before decision {step} of episode {episode}; choose "
            "another decision or another vehicle"
        )
    if recorded.plan is not None and recorded.plan.is_obstacle[start, place]:
        raise InputError(f"vehicle {place} of episode {episode} is an obstacle; choose a vehicle")
    (other,) = simulate(cell, [episode], seat)
    both = min(vehicles, len(other.agents))  # of those that enter later, there can be more in one
    if not np.array_equal(recorded.x[: start + 1, :both], other.x[: start + 1, :both]):
        # See `replay`.
        (other,) = simulate(cell, [episode], seat, among=cell.shard_of(episode))
    return WhatIf(recorded, other, step, place, agent)


def future_of(replayed: Replay, vehicle: int, start: int) -> Future:
    """What a vehicle did from a frame on, before which it has not crashed or left, until then."""
    crashed = replayed.crashed[:, vehicle]
    left = np.arange(len(crashed)) > start
    left &= ~replayed.present[:, vehicle]
    end = len(crashed) - 1
    if crashed.any():
        end = int(crashed.argmax())
    elif left.any():
        end = int(left.argmax()) - 1
    after = slice(start + 1, end + 1)  # a frame has the command of the step that ends in it
    if vehicle == replayed.ego:
        ending = "time over" if replayed.ending == "time" else replayed.ending.replace("_", " ")
    else:
        ending = "crashed" if crashed.any() else "leaves" if left.any() else "drives on"
    view = ego_view(replace(replayed, ego=vehicle))
    acceleration, lane = replayed.acceleration[after, vehicle], replayed.lane[start : end + 1]
    return Future(
        vehicle=vehicle,
        agent=replayed.agents[vehicle],
        ending=f"{ending} at {replayed.t_s[end]:z.1f} s",
        lasted_s=float(replayed.t_s[end] - replayed.t_s[start]),
        ttc_min_s=_smallest(view.ttc[after]),
        gap_min_m=_smallest(view.gap_ahead[after]),
        speed_mps=float(replayed.speed[after, vehicle].mean()),
        lane_changes=int((np.diff(lane[:, vehicle]) != 0).sum()),
        hard_braking_s=float((acceleration < -HARSH_MPS2).sum() / replayed.settings.simulation_hz),
        braking_max_mps2=float(max(0.0, -acceleration.min())),
    )


def _smallest(values: Floats) -> float | None:
    defined = values[~np.isnan(values)]
    return float(defined.min()) if defined.size else None
