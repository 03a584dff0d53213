"""Continuous actions: highway-env's `ContinuousAction`, in both engines."""

import math
from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from highway_env.envs.common.action import ContinuousAction
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, InputError
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.traffic import Mixture, OneAgent
from charms_bench.recording.recording import Recording
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import ActionKind, controls_of
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Floats, Observations, SceneSettings

HIGHWAY = {"profile": PROFILES["highway-env"], "ego_slots": 1}
FREE = SceneSettings(**HIGHWAY, traffic_vehicles=0)
EVENTS = ("lane", "target_lane", "crashed", "timer_s", "leaders", "followers", "impact")
MOTION = ("x", "y", "heading", "speed", "acceleration", "steering", "target_speed")


class Weaver(Policy):
    """Steers by its position across the road and accelerates by its speed."""

    actions = "continuous"

    def decide(self, observations: Observations) -> NDArray[np.float32]:
        y, speed = observations[:, 0, 2], observations[:, 0, 3]
        return np.stack([np.cos(31 * speed), 0.3 * np.sin(17 * y + 5 * speed)], axis=1)


class Answers(Policy):
    """Returns always the same."""

    actions = "continuous"

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def decide(self, observations: Observations) -> Any:
        return self.answer


def simulation(
    scene: SceneSettings,
    scenes: int = 1,
    engine: MakeEngine = BatchedEngine,
    ego: str | None = None,
    **traffic: float,
) -> Simulation:
    agents: dict[str, Agent] = {"idm_mobil": IdmMobil(), "weaver": Weaver()}
    drivers = Mixture(traffic or {"idm_mobil": 1.0})
    made = Simulation(scene, scenes, ego, drivers, agents, engine, "continuous")
    made.reset(np.arange(scenes, dtype=np.uint64))
    return made


def action(acceleration: float, steering: float) -> Floats:
    return np.array([[acceleration, steering]])


def assert_equal_scenes(ours: Simulation, theirs: Simulation, step: int) -> None:
    for names, tolerance in ((EVENTS, 0.0), (MOTION, 1e-6)):
        for name in names:
            pair = getattr(ours.scene, name), getattr(theirs.scene, name)
            np.testing.assert_allclose(*pair, rtol=0, atol=tolerance, err_msg=f"{name}, {step}")


@settings(derandomize=True, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-2, 2), st.floats(-2, 2)), min_size=1, max_size=5),
    st.sampled_from([np.float32, np.float64]),
)
def test_the_control_is_highway_envs_to_the_last_bit(pairs: list[Any], kind: Any) -> None:
    actions = np.array(pairs, dtype=kind)
    found = controls_of(actions)
    for row, each in enumerate(actions):
        expected = ContinuousAction(None).get_action(each)
        assert float(found[0][row]) == float(expected["acceleration"])
        assert float(found[1][row]) == float(expected["steering"])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_vehicle_with_constant_steering_drives_a_circle(engine: MakeEngine) -> None:
    running = simulation(FREE, engine=engine)
    slip = math.atan(math.tan(math.pi / 8) / 2)
    radius = 2.5 / math.sin(slip)
    start = running.scene.x[0, 0], running.scene.y[0, 0]
    around = 2 * math.pi * radius / 25.0  # at 25 m/s
    furthest = 0.0
    for _ in range(round(around * 15)):
        running.advance(action(0.0, 0.5))
        distance = math.dist(start, (running.scene.x[0, 0], running.scene.y[0, 0]))
        furthest = max(furthest, distance)
    assert furthest == pytest.approx(2 * radius, rel=0.05)
    assert distance < 25.0 / 15
    assert running.scene.speed[0, 0] == 25.0


@pytest.mark.parametrize("engine", ENGINES)
def test_full_braking_ends_in_reverse_at_highway_envs_lowest_speed(engine: MakeEngine) -> None:
    running = simulation(FREE, engine=engine)
    for decision in range(45):
        running.step(action(-1.0, 0.0))
        if decision == 14:  # after 5 s at -5 m/s²
            assert running.scene.speed[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert running.scene.speed[0, 0] == pytest.approx(-40.0, abs=0.5)
    assert running.scene.x[0, 0] < 300


def test_an_action_has_a_zero_order_hold_until_the_next() -> None:
    running = simulation(FREE)
    for _ in range(5):
        running.advance(action(0.5, 0.1) if running.phase == 0 else None)
        assert running.scene.acceleration[0, 0] == 2.5
        assert running.scene.steering[0, 0] == pytest.approx(0.1 * math.pi / 4)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("kind", "target"), [("meta", 1), ("continuous", 0)])
def test_the_traffic_does_not_change_lanes_ahead_of_a_moving_vehicle(
    kind: ActionKind, target: int, engine: MakeEngine
) -> None:
    """The ego on lane 1 is 90 m behind a vehicle on lane 0 that has a slow leader.

    MOBIL expects 3 (1 - (25 / 25)^d) - 3 (47.5 / 90)^2 = -0.8 m/s² of it, above the limit of -2.
    With a target speed of 0, it is 3 (1 - (25 / 0.01)^d), far below that limit.
    """
    scene = SceneSettings(**HIGHWAY, traffic_vehicles=2, lanes=2)
    agents: dict[str, Agent] = {"idm_mobil": IdmMobil()}
    running = Simulation(scene, 1, None, OneAgent("idm_mobil"), agents, engine, kind)
    running.reset(np.zeros(1, dtype=np.uint64))
    arrays: dict[str, Any] = {
        "x": [[40.0, 130.0, 160.0]],
        "y": [[4.0, 0.0, 0.0]],
        "speed": [[25.0, 25.0, 10.0]],
        "target_speed": [[25.0, 25.0, 10.0]],
        "target_lane": [[1, 0, 0]],
        "timer_s": [[0.0, 1.1, 0.0]],
    }
    arrays = {name: np.array(values) for name, values in arrays.items()}
    running.restore(running.state().with_arrays(arrays))
    running.advance(np.array([1]) if kind == "meta" else action(0.0, 0.0))
    assert running.scene.target_lane[0].tolist() == [1, target, 0]


def test_a_lane_change_is_a_change_of_the_nearest_lane() -> None:
    running = simulation(FREE)
    recording = Recording(running)
    running.scene.y[0, 0], running.scene.lane[0, 0] = 4.0, 1
    while running.scene.lane[0, 0] != 2:
        running.step(action(0.0, 0.02))
        recording.note()
    rows = recording.steps()
    assert rows["action"].null_count() == len(rows)
    assert (rows["lane"] == rows["target_lane"]).all()
    assert rows["y"][-1] > 6.0 >= rows["y"][-2]


def test_off_the_road_an_episode_goes_on_or_ends_as_the_profile_says() -> None:
    for profile in PROFILES.values():
        running = simulation(SceneSettings(profile=profile, traffic_vehicles=0, ego_slots=1))
        while running.scene.active[0] and running.scene.y[0, 0] < 60:
            running.step(action(0.0, 0.1))
        assert running.is_off_road[0]
        assert running.failed[0] == profile.offroad_terminal
        assert running.scene.lane[0, 0] == 2


@pytest.mark.parametrize("other", ENGINES)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_state_within_an_interval_continues_the_same(
    engine: MakeEngine, other: MakeEngine
) -> None:
    scene = SceneSettings(**HIGHWAY, traffic_vehicles=8)
    traffic = {"idm_mobil": 0.5, "weaver": 0.5}
    running = simulation(scene, 3, engine, **traffic)
    running.step(np.full((3, 2), 0.02))
    running.advance(np.full((3, 2), -0.04))
    continued = simulation(scene, 3, other, **traffic)
    continued.restore(running.state())
    for step in range(9):
        for each in (running, continued):
            each.advance(np.full((3, 2), 0.01) if each.phase == 0 else None)
            if each.phase == scene.steps_per_decision:
                each.finish_step()
        assert_equal_scenes(running, continued, step)


@pytest.mark.parametrize("engine", ENGINES)
def test_another_driver_takes_over_at_the_speed_of_the_vehicle(engine: MakeEngine) -> None:
    scene = SceneSettings(**HIGHWAY, traffic_vehicles=2)
    running = simulation(scene, engine=engine, idm_mobil=1.0)
    running.step(action(1.0, 0.0))
    speed = running.scene.speed[0, 0]
    running.restore(running.state().seated(np.array([0]), "idm_mobil"))
    assert running.scene.target_speed[0, 0] == speed > 25
    running.restore(running.state().seated(np.array([0]), ""))
    assert running.scene.target_speed[0, 0] == 0
    running.step(action(1.0, 0.0))
    assert running.scene.acceleration[0, 0] == 5.0


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros(8, dtype=np.int64), r"int64 of shape \(8,\); expected floats of shape \(8, 2\)"),
        (np.zeros((8, 2), dtype=np.int64), "expected floats"),
        (np.zeros((2, 8)), r"expected floats of shape \(8, 2\)"),
        (np.full((8, 2), 1.01), r"action \[1.01 1.01\]; expected an acceleration and a steering"),
        (np.full((8, 2), np.nan), r"action \[nan nan\]"),
    ],
)
def test_a_wrong_answer_is_the_agents_error(answer: Any, message: str) -> None:
    agents: dict[str, Agent] = {"wrong": Answers(answer)}
    scene = SceneSettings(traffic_vehicles=7)
    running = Simulation(scene, 1, "wrong", OneAgent("wrong"), agents)
    running.reset(np.array([3], dtype=np.uint64))
    with pytest.raises(AgentError, match=f"agent 'wrong', episode 3, step 0: .*{message}"):
        running.step()


def test_an_unknown_kind_of_actions_is_named() -> None:
    policy = Answers(None)
    policy.actions = "throttle"  # type: ignore[assignment]
    with pytest.raises(InputError, match="actions` is 'throttle'; expected meta or continuous"):
        Simulation(SceneSettings(), 1, "odd", OneAgent("odd"), {"odd": policy})
