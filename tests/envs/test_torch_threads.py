"""Environments warn once if torch is in use with several threads."""

import sys
import warnings
from types import SimpleNamespace

import pytest

from charms_bench.envs import torch_threads
from charms_bench.envs.ego_env import ego_vector_env


@pytest.fixture(autouse=True)
def _not_warned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch_threads, "_warned", [])


def test_several_threads_are_warned_of_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(get_num_threads=lambda: 4))
    env = ego_vector_env(1, traffic="level_0")
    with pytest.warns(UserWarning, match=r"4 threads.* call torch\.set_num_threads\(1\)"):
        env.reset()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env.reset()


@pytest.mark.parametrize("torch", [None, SimpleNamespace(get_num_threads=lambda: 1)])
def test_one_thread_or_no_torch_is_not_worth_a_warning(
    torch: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", torch)
    ego_vector_env(1, traffic="level_0").reset()
