"""How vehicles move by the bicycle model, operation for operation as in highway-env.

The model with tyre friction and slip is that of Rajamani, Vehicle Dynamics and Control (2011),
chapter 2.
"""

import math

from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled, inlined
from charms_bench.roads.scenes import (
    BATCH,
    COSINE,
    DYNAMICAL,
    HEADING,
    IDM,
    LENGTH,
    SINE,
    SPEED,
    STEERING,
    Row,
    X,
    Y,
    number_of,
    put,
)
from charms_bench.world.bicycle import displacement, limited, slip_of, turn_of

TO_AXLE_M = 2.5
"""From the centre of a vehicle to each axle [`LENGTH_A`, `LENGTH_B`]."""
INERTIA = 1 / 12 * (5.0**2 + 2.0**2)
"""Of a vehicle of mass 1, m^2 [`INERTIA_Z`]."""
FRICTION = 15.0
"""Of the tyres of an axle, per mass [`FRICTION_FRONT`, `FRICTION_REAR`]."""
MOST_YAW_RATE = 2 * math.pi
"""rad/s [`MAX_ANGULAR_SPEED`]."""
Rates = tuple[float, float, float, float]


@compiled
def move(vehicle: Row, dt: float) -> None:
    """Moves a vehicle by one step [`Vehicle.clip_actions`, `Vehicle.step`]."""
    prepare(vehicle, dt)
    if vehicle.kind == DYNAMICAL:
        move_with_slip(vehicle, dt)
        return
    if vehicle.steering == 0.0:
        go_straight(vehicle, dt)
    else:
        slip = slip_of(maths.tan(vehicle.steering))
        x, y = displacement(vehicle.heading, slip, vehicle.speed, dt)
        vehicle.x += x
        vehicle.y += y
        vehicle.heading += turn_of(slip, vehicle.speed, vehicle.length / 2, dt)
        vehicle.direction_y, vehicle.direction_x = maths.sin_cos(vehicle.heading)
    finish(vehicle, dt)


@inlined
def prepare(vehicle: Row, dt: float) -> None:
    """The part of a step before a vehicle moves.

    A crashed vehicle stops, and one that is too fast or too slow brakes or accelerates.
    """
    speed = vehicle.speed
    if vehicle.crashed:
        vehicle.steering, vehicle.acceleration = 0.0, -1.0 * speed
    low, high = vehicle.speed_min, vehicle.speed_max
    vehicle.acceleration = limited(vehicle.acceleration, speed, low, high)
    if vehicle.kind == IDM:
        vehicle.timer_s += dt


@inlined
def go_straight(vehicle: Row, dt: float) -> None:
    """The same as `displacement`, whose functions would give 0 and the direction itself."""
    vehicle.x += vehicle.speed * vehicle.direction_x * dt
    vehicle.y += vehicle.speed * vehicle.direction_y * dt


@inlined
def finish(vehicle: Row, dt: float) -> None:
    """The part of a step after a vehicle has moved."""
    if vehicle.has_impact:
        vehicle.x += vehicle.impact_x
        vehicle.y += vehicle.impact_y
        vehicle.crashed, vehicle.has_impact = True, False
    vehicle.speed += vehicle.acceleration * dt


@compiled
def turn_batch(batch: Row, dt: float) -> None:
    """Finds how far vehicles in a batch move, and their next headings and directions."""
    for k in range(BATCH):
        heading = number_of(batch, HEADING, k)
        slip = slip_of(maths.tan(number_of(batch, STEERING, k)))
        speed, half_length = number_of(batch, SPEED, k), number_of(batch, LENGTH, k) / 2
        x, y = displacement(heading, slip, speed, dt)
        heading += turn_of(slip, speed, half_length, dt)
        sine, cosine = maths.sin_cos(heading)
        put(batch, X, k, x)
        put(batch, Y, k, y)
        put(batch, HEADING, k, heading)
        put(batch, COSINE, k, cosine)
        put(batch, SINE, k, sine)


@compiled
def move_with_slip(vehicle: Row, dt: float) -> None:
    """Moves a dynamical vehicle by one step of Runge and Kutta [`BicycleVehicle.step`, `rk4`].

    As in highway-env, an impact does not push it.
    """
    steering = vehicle.steering = clip(vehicle.steering, -math.pi / 2, math.pi / 2)
    vehicle.yaw_rate = clip(vehicle.yaw_rate, -MOST_YAW_RATE, MOST_YAW_RATE)
    heading, speed, gain = vehicle.heading, vehicle.speed, vehicle.acceleration
    aside, yaw = vehicle.lateral_speed, vehicle.yaw_rate
    half = dt / 2
    x1, y1, a1, r1 = rates(heading, speed, aside, yaw, steering)
    yaw_2 = yaw + r1 * half
    x2, y2, a2, r2 = rates(
        heading + yaw * half, speed + gain * half, aside + a1 * half, yaw_2, steering
    )
    yaw_3 = yaw + r2 * half
    x3, y3, a3, r3 = rates(
        heading + yaw_2 * half, speed + gain * half, aside + a2 * half, yaw_3, steering
    )
    yaw_4 = yaw + r3 * dt
    x4, y4, a4, r4 = rates(
        heading + yaw_3 * dt, speed + gain * dt, aside + a3 * dt, yaw_4, steering
    )
    weight = dt / 6
    vehicle.x += weight * (x1 + 2 * x2 + 2 * x3 + x4)
    vehicle.y += weight * (y1 + 2 * y2 + 2 * y3 + y4)
    vehicle.heading += weight * (yaw + 2 * yaw_2 + 2 * yaw_3 + yaw_4)
    vehicle.speed += weight * (gain + 2 * gain + 2 * gain + gain)
    vehicle.lateral_speed += weight * (a1 + 2 * a2 + 2 * a3 + a4)
    vehicle.yaw_rate += weight * (r1 + 2 * r2 + 2 * r3 + r4)
    vehicle.direction_y, vehicle.direction_x = maths.sin_cos(vehicle.heading)


@compiled
def rates(heading: float, speed: float, aside: float, yaw: float, steering: float) -> Rates:
    """How fast x, y, the lateral speed `aside` and the yaw rate change; SI units.

    [`BicycleVehicle.derivative_func`]
    """
    if abs(speed) < 1:  # the tyres damp
        front = -aside - INERTIA / TO_AXLE_M * yaw
        rear = -aside + INERTIA / TO_AXLE_M * yaw
    else:
        front = 2 * FRICTION * (steering - maths.atan2(aside + TO_AXLE_M * yaw, speed))
        rear = 2 * FRICTION * (0.0 - maths.atan2(aside - TO_AXLE_M * yaw, speed))
    sine, cosine = maths.sin_cos(heading)
    return (
        cosine * speed - sine * aside,
        sine * speed + cosine * aside,
        (front + rear) - yaw * speed,
        1 / INERTIA * (TO_AXLE_M * front - TO_AXLE_M * rear),
    )
