"""The motion of vehicles, as replays keep it and pictures show it."""

from dataclasses import dataclass

from charms_bench.world.scene import Bools, Floats, Ints


@dataclass(frozen=True, eq=False, kw_only=True)
class Bodies:
    """Where N vehicles are and how they move, [..., N]; units are as in `scene.Scene`."""

    present: Bools
    """Other values of a vehicle that is not there mean nothing."""
    x: Floats
    y: Floats
    heading: Floats
    length: Floats
    width: Floats
    speed: Floats
    acceleration: Floats
    lane: Ints
    target_lane: Ints
    crashed: Bools


@dataclass(frozen=True, kw_only=True)
class Motion(Bodies):
    """What N vehicles do."""

    action: Ints
    """The last meta-action, only meaningful where `has_action` is true."""
    has_action: Bools
    """Whether there is one: not before the first, and never under a driver model."""
