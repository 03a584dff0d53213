"""The engine and `paper_neighbours` against recordings of the code of the paper's authors.

Recordings `ego-*` have 60 episodes of one of their networks as the ego in IDM+MOBIL traffic;
recordings `traffic-*` have 12 and 4 episodes of an IDM+MOBIL ego in traffic of their networks.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture
from charms_bench.world.observations import paper_neighbours
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import SceneSettings

RELEASED = Path(__file__).parents[3] / "shared" / "released"
NETWORKS = {
    "charms": "level2_efeg_with_bc",
    "imitation": "mlp_bc_only",
    "prior-level-k": "level2_efeg_500000_steps",
}
SETTINGS = SceneSettings(profile=CHARMS.model_copy(update={"sums_time": True}), ego_slots=1)
TIE = 1e-4
"""Values of actions that differ by less are equal to float32's precision."""


States = dict[str, NDArray[Any]]
"""Columns of a recording's states, (E, T + 1, N); NaN or None after an episode's end."""


def states_of(name: str) -> States:
    """The states of all vehicles before each decision; vehicle 0 is the ego."""
    rows = _read(f"{name}.parquet")
    shape = (rows["episode"].n_unique(), int(rows["decision"].max()) + 1, SETTINGS.vehicles)
    at = tuple(rows[key].to_numpy() for key in ("episode", "decision", "vehicle"))
    states: States = {}
    for column in rows.columns:
        values = rows[column].to_numpy()
        is_number = values.dtype.kind in "iufb"
        states[column] = np.full(shape, np.nan) if is_number else np.full(shape, None)
        states[column][at] = values
    return states


def observations_of(name: str, states: States) -> NDArray[np.float32]:
    """What the ego observed at each decision, (E, T + 1, 35); NaN after an episode's end."""
    rows = _read(f"{name}.parquet")
    observations = np.full((*states["x"].shape[:2], 35), np.nan, dtype=np.float32)
    observations[rows["episode"], rows["decision"]] = rows["observation"].to_numpy()
    return observations


def _read(name: str) -> pl.DataFrame:
    folder = RELEASED / "recordings"
    if not folder.is_dir():
        pytest.skip("needs ../shared/released/recordings")
    rows = pl.read_parquet(folder / name)
    return rows.with_columns(pl.col("episode").rank("dense").cast(pl.Int64) - 1)


def ego_actions_in(states: States) -> NDArray[np.int64]:
    """The ego's meta-actions, (E, T + 1); -1 after the last decision."""
    return np.nan_to_num(states["action"][:, :, 0], nan=-1).astype(np.int64)


def started_from(
    states: States, ego: str | None, drivers: NDArray[np.str_], agents: Mapping[str, Agent]
) -> Simulation:
    """A simulation of all episodes from the recorded states before decision 0.

    Args:
        states: The recorded states.
        ego: The ego's agent; by default, the ego is driven from outside.
        drivers: (E, N) the names of the vehicles' agents.
        agents: The agents by name.
    """
    traffic = Mixture({name: 1 / len(agents) for name in agents})
    simulation = Simulation(SETTINGS, len(drivers), ego, traffic, agents)
    simulation.reset(np.arange(len(drivers), dtype=np.uint64))
    state = simulation.state()
    first = {name: values[:, 0].copy() for name, values in states.items()}
    kept = ("x", "y", "heading", "speed", "target_speed", "acceleration", "steering")
    changes = {name: first[name] for name in kept} | {
        "target_lane": first["target_lane"].astype(np.int64),
        "timer_s": first["timer"],
        "temperament": first["delta"] - 3.5,
        "ego": np.zeros_like(state.ego),
        "drivers": np.vectorize(state.agents.index)(drivers).astype(state.drivers.dtype),
    }
    simulation.restore(state.with_arrays(changes))
    return simulation


def started_among_idm_drivers(states: States) -> Simulation:
    drivers = np.full(states["x"][:, 0].shape, "idm_mobil")
    drivers[:, 0] = ""
    return started_from(states, None, drivers, {"idm_mobil": make_agent("idm_mobil")})


def network_of(checkpoint: str, folder: Path, decision_hz: float = 3.0) -> OnnxPolicy:
    pytest.importorskip("torch", reason="needs the extra 'train'")
    from charms_agents.training.sb3_export import export_zip

    path = folder / f"{checkpoint}.onnx"
    (zipped,) = RELEASED.rglob(f"{checkpoint}.zip")
    export_zip(zipped, path, {}, paper_neighbours)
    return OnnxPolicy(path, decision_hz)


@pytest.mark.parametrize("name", NETWORKS)
def test_with_the_recorded_actions_every_vehicle_is_where_it_was_recorded(name: str) -> None:
    states = states_of(f"ego-{name}-states")
    simulation = started_among_idm_drivers(states)
    for decision, actions in enumerate(ego_actions_in(states).T):
        for quantity in ("x", "y", "speed"):
            expected = states[quantity][:, decision]
            found = np.where(np.isnan(expected), np.nan, getattr(simulation.scene, quantity))
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
        simulation.step(np.maximum(actions, 0))


@pytest.mark.parametrize("name", NETWORKS)
def test_the_ego_observes_what_it_observed_in_the_recording(name: str) -> None:
    states = states_of(f"ego-{name}-states")
    observations = observations_of(f"ego-{name}-observations", states)
    simulation = started_among_idm_drivers(states)
    compared = 0
    for decision, actions in enumerate(ego_actions_in(states).T):
        rows = np.flatnonzero(actions >= 0)
        found = paper_neighbours(simulation.scene, (rows, simulation.scene.ego[rows]))
        expected = observations[rows, decision]
        np.testing.assert_allclose(found.reshape(-1, 35), expected, rtol=0, atol=1e-5)
        compared += rows.size
        simulation.step(np.maximum(actions, 0))
    assert compared == (~np.isnan(observations[:, :, 0])).sum() > 2_000


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_takes_the_recorded_action_unless_two_are_almost_equal(
    name: str, tmp_path: Path
) -> None:
    states = states_of(f"ego-{name}-states")
    actions = ego_actions_in(states)
    decided = actions >= 0
    observed = observations_of(f"ego-{name}-observations", states)[decided].reshape(-1, 7, 5)
    values = network_of(NETWORKS[name], tmp_path).values_and_memory(observed)[0]
    lost = values.max(axis=1) - values[np.arange(len(values)), actions[decided]]
    others = np.flatnonzero(values.argmax(axis=1) != actions[decided])
    assert (lost[others] < TIE).all(), [
        f"episode {episode}, decision {decision}: {loss:.2g}"
        for (episode, decision), loss in zip(
            np.argwhere(decided)[others], lost[others], strict=True
        )
    ]
    assert others.size <= 0.005 * len(values)


@pytest.mark.parametrize(("name", "ties"), [("pch", 0), ("prior-level-k", 1)])
def test_traffic_of_networks_that_decide_at_15_hz_drives_as_recorded(
    name: str, ties: int, tmp_path: Path
) -> None:
    """Before fine-tuning, as the authors' code loads them.

    In one episode of Prior Level-k, two actions are equal to float32's precision.
    """
    states = states_of(f"traffic-{name}")
    of_class = {"IDMVehicle": "idm_mobil"}
    agents: dict[str, Agent] = {"idm_mobil": make_agent("idm_mobil")}
    for style in sorted(set(states["class"][:, 0].ravel()) - set(of_class)):
        checkpoint = f"level2_{style.removeprefix('Level2').lower()}_500000_steps"
        of_class[style] = checkpoint
        agents[checkpoint] = network_of(checkpoint, tmp_path, decision_hz=15.0)
    drivers = np.vectorize(of_class.get)(states["class"][:, 0])
    simulation = started_from(states, "idm_mobil", drivers, agents)
    differs = np.zeros(len(drivers), dtype=np.bool_)
    for decision in range(SETTINGS.decisions + 1):
        for quantity in ("x", "y", "speed"):
            far = np.abs(getattr(simulation.scene, quantity) - states[quantity][:, decision]) > 1e-6
            differs |= far.any(axis=1)
        simulation.step()
    assert SETTINGS.decisions == 61
    assert differs.sum() <= ties
