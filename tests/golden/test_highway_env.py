"""Episodes are those of highway-env 1.12, as the scripts in `highway_env` recorded them."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from comparison import differences
from counted_events import EVENTS
from recorded_traces import Traces
from road_frames import Roads
from straight_frames import StraightRoads

from charms_bench.roads import TASKS

FOLDER = Path(__file__).with_name("highway_env")
STRAIGHT = (
    *("charms-3", "charms-2", "charms-4", "charms-every-step", "charms-5"),
    *("highway-env-3", "highway-env-dense", "highway-env-5", "highway-env-2"),
)


@pytest.mark.parametrize("name", TASKS)
def test_episodes_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    traces = Traces.read(FOLDER / f"{name}.npz")
    assert len(traces.episodes) >= 40
    assert [*differences(traces, lambda *of: Roads(traces, *of))] == []


@pytest.mark.parametrize("name", STRAIGHT)
def test_straight_roads_are_those_of_highway_env_to_the_last_bit(name: str) -> None:
    traces = Traces.read(FOLDER / f"straight-{name}.npz")
    assert len(traces.episodes) == 60
    assert [*differences(traces, StraightRoads)] == []


@pytest.mark.parametrize("name", TASKS)
def test_episodes_start_and_go_on_as_in_highway_env_with_its_own_mathematics(name: str) -> None:
    """Numbers were rounded to millionths."""
    traces = Traces.read(FOLDER / f"numpy-{name}.npz")
    roads = Roads(traces, len(traces.episodes), {})
    frames = roads.start(np.array([each.seed for each in traces.episodes], dtype=np.uint64))
    for number in range(max(each.decisions for each in traces.episodes) + 1):
        if number:
            last = [each.actions[min(number, each.decisions) - 1] for each in traces.episodes]
            frames = roads.step(np.stack(last))
        for each, frame in zip(traces.episodes, frames, strict=True):
            for quantity, values in each.values.items() if number <= each.decisions else ():
                expected = values[number][~np.isnan(values[number])]
                np.testing.assert_allclose(
                    1e6 * frame[quantity], expected, rtol=0, atol=1.5, err_msg=f"{number}"
                )


def test_every_event_occurs_in_the_traces() -> None:
    total: Counter[str] = Counter()
    for path in FOLDER.glob("*.npz"):
        total.update(Traces.read(path).events)
    assert {event for event in EVENTS if not total[event]} == set()
