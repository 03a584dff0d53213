"""What a scene holds: arrays on a road."""

from typing import NamedTuple

from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.generator import State
from charms_bench.world.profile import Constants
from charms_bench.world.road import Straight


class SceneArrays(NamedTuple):
    """The fields of a `Scene`."""

    present: Bools
    """[B, N] whether there is a vehicle at the place. At an empty place, other values mean nothing;
    they describe a vehicle that stands far before the road (`VACANT_X_M`)."""
    entry: Ints
    """[B, N] the vehicle's number in the order in which vehicles entered the scene, from 0.

    Vehicles of one agent act in this order; it decides which of two that are level is the leader,
    and which of two collisions comes first."""
    x: Floats
    """[B, N] centre along the road, m."""
    y: Floats
    """[B, N] centre across the road, m."""
    heading: Floats
    """[B, N] rad."""
    direction_x: Floats
    """[B, N] cosine of the heading."""
    direction_y: Floats
    """[B, N] sine of the heading."""
    speed: Floats
    """[B, N] along the heading, m/s."""
    acceleration: Floats
    """[B, N] the command of the last simulation step after clipping, m/s2."""
    steering: Floats
    """[B, N] steering angle of the last simulation step, rad."""
    length: Floats
    """[B, N] m."""
    width: Floats
    """[B, N] m."""
    target_speed: Floats
    """[B, N] desired speed, m/s; 0 for a vehicle with continuous actions."""
    lane: Ints
    """[B, N] nearest lane."""
    target_lane: Ints
    """[B, N] the lane that the vehicle steers to; differs from `lane` during a lane change. With
    continuous actions, it is `lane`."""
    repeats: Ints
    """[B, N] how often meta-actions have raised the target speed in a row, as FASTER does, or have
    lowered it by steps if it is negative; counted up to the number of the steps."""
    crashed: Bools
    """[B, N] whether the vehicle has collided."""
    timer_s: Floats
    """[B, N] time since the driver model last set it to 0; starts within a lane-change period."""
    temperament: Floats
    """[B, N] in [0, 1], drawn once per vehicle: IDM+MOBIL's exponent depends on it."""
    parameters: Floats
    """[B, N, P] the parameters of each vehicle's driver, in the order in which its model declares
    them [`DriverModel.parameters`]; P is the number of the model that declares most."""
    memory: Floats
    """[B, N, Q] what each vehicle's agent remembers, in its first columns; Q is the width of the
    agent that declares most [`Policy.memory_width`, `DriverModel.memory_width`]."""
    generator: State
    """[B, 6] the state of the scene's random generator after the draws that placed its vehicles."""
    ego: Ints
    """[B] the ego's place."""
    active: Bools
    """[B] whether the scene still runs; a scene that has ended no longer changes."""
    order: Ints
    """[B, N] the vehicles' places, sorted by x."""
    rank: Ints
    """[B, N] each vehicle's index in `order`."""
    leaders: Ints
    """[B, N, 4] nearest vehicle ahead on each of the `CANDIDATES`, as the last simulation step left
    them. For speed, -1 stands for none in this table; outside compiled code, use `leader`."""
    followers: Ints
    """[B, N, 4] nearest vehicle behind on each of the `CANDIDATES`, likewise; see `follower`."""
    impact_x: Floats
    """[B, N] displacement that a collision causes in the next step, m."""
    impact_y: Floats
    impact: Bools
    """[B, N] whether there is such a displacement."""
    road: Straight
    """In the `Engine.state` of one of highway-env's roads, a `Network` with lanes as rows."""
    constants: Constants
