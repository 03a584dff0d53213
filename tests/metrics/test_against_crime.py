"""Criticality, step by step, as commonroad-crime has it; run by `tox -e crime`.

Vehicles keep their speeds here: so they do in the definitions of TTC and DRAC, while
commonroad-crime goes on to brake with whatever acceleration a trajectory shows. It rounds to
hundredths, and measures time headway by when the ego's front reaches the leader's rear.
"""

import math

import numpy as np
import polars as pl
import pytest
from handmade_conduct import conduct
from handmade_rows import frames, of_standard

from charms_bench.metrics import sums_by_episode
from charms_bench.metrics.rows import join_rows
from charms_bench.metrics.time_to_collision import TTC_THRESHOLD_S
from charms_bench.world.scene import SceneSettings

pytest.importorskip("commonroad_crime", reason="run by tox -e crime")

import shapely.geometry
from commonroad.geometry.shape import Rectangle
from commonroad.prediction.prediction import TrajectoryPrediction
from commonroad.scenario.lanelet import Lanelet, LaneletNetwork
from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
from commonroad.scenario.scenario import Scenario
from commonroad.scenario.state import CustomState, InitialState
from commonroad.scenario.trajectory import Trajectory
from commonroad_crime.data_structure.configuration import CriMeConfiguration
from commonroad_crime.measure import PET, TET, THW, TIT, TTC, ALongReq

SCENE = SceneSettings()
INTERVAL_S = 1 / SCENE.decision_hz
LENGTH_M = SCENE.profile.vehicle_length_m
STEPS = 20
ROUNDING = 0.00501
EGO, LEADER = 1, 2
LANE_SLOPE = 1e-4
"""Next to nothing; commonroad-crime takes an orientation of exactly 0 for a missing one."""
GAP_ERROR_M = ROUNDING + LENGTH_M * LANE_SLOPE
"""It rounds gaps too, and adds half a length to both coordinates to get to a bumper."""
SHORT_M = 0.5
"""Length of the area at a place."""
NEVER_S = 1e6
"""Its accelerations are gradients of speeds, and leave 1e-15 of a constant one."""

rng = np.random.default_rng(0)
APPROACHES = [
    tuple(map(float, (rng.uniform(8, 60), rng.uniform(22, 33), rng.uniform(22, 33))))
    for _ in range(20)
]
"""Distance between centres, speed of the ego and of its leader."""


def theirs(distance: float, speed: float, leader_speed: float) -> CriMeConfiguration:
    """An approach in a lane of commonroad."""
    along = np.linspace(-50.0, 600.0, 131)

    def line(y: float) -> np.ndarray:
        return np.stack([along, y + LANE_SLOPE * along], axis=1)

    scenario = Scenario(INTERVAL_S)
    lane = Lanelet(line(2.0), line(0.0), line(-2.0), 100)
    scenario.add_objects(LaneletNetwork.create_from_lanelet_list([lane]))
    shape = Rectangle(LENGTH_M, SCENE.profile.vehicle_width_m)
    for number, start, pace in ((EGO, 0.0, speed), (LEADER, distance, leader_speed)):
        states = []
        for step in range(STEPS + 1):
            x = start + pace * INTERVAL_S * step
            states.append(
                (CustomState if step else InitialState)(
                    time_step=step,
                    position=np.array([x, LANE_SLOPE * x]),
                    orientation=0.0,
                    velocity=pace,
                    acceleration=0.0,
                    yaw_rate=0.0,
                    slip_angle=0.0,
                )
            )
        prediction = TrajectoryPrediction(Trajectory(1, states[1:]), shape)
        scenario.add_objects(
            DynamicObstacle(number, ObstacleType.CAR, shape, states[0], prediction)
        )
    scenario.assign_obstacles_to_lanelets()
    configuration = CriMeConfiguration()
    configuration.update(ego_id=EGO, sce=scenario)
    configuration.time.tau = TTC_THRESHOLD_S
    return configuration


def ours(distance: float, speed: float, leader_speed: float) -> tuple[pl.DataFrame, pl.DataFrame]:
    """The same approach as an episode's rows."""
    gaps = distance + (leader_speed - speed) * INTERVAL_S * np.arange(STEPS)
    rows = [{"speed": speed, "leader_distance": gap, "leader_speed": leader_speed} for gap in gaps]
    return frames(({}, rows))


@pytest.mark.parametrize("approach", APPROACHES)
def test_ttc_drac_and_headway_are_those_of_commonroad_crime(
    approach: tuple[float, float, float],
) -> None:
    configuration = theirs(*approach)
    ttc, required, headway = (kind(configuration) for kind in (TTC, ALongReq, THW))
    for step, row in enumerate(join_rows(*ours(*approach), SCENE).iter_rows(named=True)):
        if row["gap_m"] is None:
            continue
        found = ttc.compute(LEADER, step, verbose=False)
        if row["ttc_s"] is None:
            assert found > NEVER_S
        else:
            closing = row["gap_m"] / row["ttc_s"]
            assert row["ttc_s"] == pytest.approx(found, abs=ROUNDING + GAP_ERROR_M / closing)
            braking = -required.compute(LEADER, step, verbose=False)
            blur = ROUNDING + row["drac_mps2"] * GAP_ERROR_M / row["gap_m"]
            assert row["drac_mps2"] == pytest.approx(braking, abs=blur)
        rear_reached = row["time_headway_s"] - LENGTH_M / row["speed"]
        found = headway.compute(LEADER, step, verbose=False)
        # Theirs is the first step after; infinite where the trajectory ends before.
        if not math.isinf(found):
            assert -ROUNDING < found - rear_reached < INTERVAL_S + ROUNDING


def test_pet_lies_within_the_steps_of_commonroad_crime() -> None:
    """The vehicle in front cuts in at the first decision; its rear is then at the end of the area.

    commonroad-crime knows PET at intersections only, but tells when a vehicle is in an area: from
    the last step before to the first step after. Its PET is therefore up to two steps shorter.
    """
    compared = 0
    for distance, speed, leader_speed in APPROACHES:
        steps = np.arange(STEPS) * INTERVAL_S
        x = [
            list(pair) for pair in zip(distance + leader_speed * steps, speed * steps, strict=True)
        ]
        beside, inside = [1.0, 4.0], [3.0, 4.0]
        _, second = conduct(x=x, y=[beside] + [inside] * (STEPS - 1), speed=speed)
        place = x[1][0] - LENGTH_M / 2
        measure = PET(theirs(distance, speed, leader_speed))
        measure.set_other_vehicles(LEADER)
        area = shapely.geometry.box(place - SHORT_M, -4, place, 4)
        _, _, left = measure.get_ca_time_info(measure.other_vehicle, 0, area)
        _, entered, _ = measure.get_ca_time_info(measure.ego_vehicle, 0, area)
        if not (math.isfinite(left) and math.isfinite(entered) and second["pet_to"]):
            continue  # steps may be longer than the vehicle and the area together
        found = (entered - left) * INTERVAL_S
        assert 0 <= second["pet_to_sum_s"] - found <= 2 * INTERVAL_S + SHORT_M / speed
        compared += 1
    assert compared >= 5


@pytest.mark.parametrize("approach", APPROACHES)
def test_the_followers_ttc_is_that_of_commonroad_crime(
    approach: tuple[float, float, float],
) -> None:
    # The same approach, seen from the vehicle in front.
    ttc = TTC(theirs(*approach))
    episodes, steps = ours(*approach)
    seen = steps.with_columns(
        speed="leader_speed",
        follower_speed="speed",
        follower_distance="leader_distance",
        leader_distance=None,
        leader_speed=None,
    ).cast(steps.schema)
    for step, row in enumerate(join_rows(episodes, seen, SCENE).iter_rows(named=True)):
        gap = row["follower_distance"] - LENGTH_M
        if gap <= 0:
            assert row["rear_ttc_s"] is None
            continue
        found = ttc.compute(LEADER, step, verbose=False)
        if row["rear_ttc_s"] is None:
            assert found > NEVER_S
        else:
            closing = gap / row["rear_ttc_s"]
            assert row["rear_ttc_s"] == pytest.approx(found, abs=ROUNDING + GAP_ERROR_M / closing)


@pytest.mark.parametrize("approach", APPROACHES)
def test_exposed_and_integrated_ttc_are_those_of_commonroad_crime(
    approach: tuple[float, float, float],
) -> None:
    episodes, steps = ours(*approach)
    metrics = [of_standard(name, ttc_s=TTC_THRESHOLD_S) for name in ("tet", "tit")]
    values = [
        float(metric.value(sums[0]))
        for metric, sums in zip(
            metrics, sums_by_episode(metrics, episodes, steps, SCENE), strict=True
        )
    ]
    configuration = theirs(*approach)
    tet, tit = (kind(configuration).compute(LEADER, 0, verbose=False) for kind in (TET, TIT))
    ttc = join_rows(episodes, steps, SCENE)["ttc_s"].drop_nulls().to_numpy()
    in_doubt = int((np.abs(ttc - TTC_THRESHOLD_S) < ROUNDING).sum())
    assert values[0] == pytest.approx(tet, abs=in_doubt * INTERVAL_S + 1e-4)
    exposed = (ttc < TTC_THRESHOLD_S + ROUNDING).sum()
    assert values[1] == pytest.approx(tit, abs=exposed * ROUNDING * INTERVAL_S + 1e-4)


def test_the_approaches_are_of_all_kinds() -> None:
    rows = [join_rows(*ours(*approach), SCENE) for approach in APPROACHES]
    closing = sum(row["ttc_s"].drop_nulls().len() > 0 for row in rows)
    exposed = sum((row["ttc_s"] < TTC_THRESHOLD_S).any() for row in rows)
    assert closing >= 5
    assert len(APPROACHES) - closing >= 5
    assert exposed >= 3
