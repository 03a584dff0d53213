"""Plugins of careless and of hostile authors, and what becomes of them."""

import json
from pathlib import Path
from typing import NamedTuple

POLICY = """\
import numpy as np
from charms_bench import FASTER, IDLE, SLOWER, LANE_LEFT, Policy
"""
MODEL = """\
import numpy as np
from charms_bench import DriverModel
"""
TRAFFIC = """\
import numpy as np
from charms_bench import Traffic
"""
SAID: dict[str, str] = json.loads((Path(__file__).parent / "messages.json").read_bytes())["plugins"]
"""The message with which a run rejects each plugin, by its title."""
AGENTS, TRAFFICS = "charms_bench.agents", "charms_bench.traffic"


class Careless(NamedTuple):
    """A plugin `careless`, the class `Careless` of a module."""

    title: str
    code: str
    group: str = AGENTS
    options: tuple[object, ...] = ()
    """More words for `charms-bench run`."""
    needs_worker: bool = False
    """Whether it would end or harm the process of the test."""


def _policy(title: str, body: str, head: str = "", **more: object) -> Careless:
    code = f"{POLICY}{head}\n\nclass Careless(Policy):\n{_indented(body)}"
    return Careless(title, code, **more)  # type: ignore[arg-type]


def _model(title: str, body: str, head: str = "", **more: object) -> Careless:
    lines = f"def drive(self, scene, vehicles):\n{_indented(body)}"
    code = f"{MODEL}{head}\n\nclass Careless(DriverModel):\n{_indented(lines)}"
    return Careless(title, code, **more)  # type: ignore[arg-type]


def _traffic(title: str, body: str) -> Careless:
    return Careless(title, f"{TRAFFIC}\n\nclass Careless(Traffic):\n{_indented(body)}", TRAFFICS)


def _indented(lines: str) -> str:
    return "".join(f"    {line}\n" if line else "\n" for line in lines.strip("\n").splitlines())


KEEPS = "return np.zeros(vehicles[0].size), scene.lane[vehicles]"
REJECTED = (
    _policy(
        "A policy that counts its calls and brakes in every fifth one",
        """
calls = 0
def decide(self, observations):
    self.calls += 1
    return np.full(len(observations), IDLE if self.calls % 5 else SLOWER)
""",
    ),
    _policy(
        "A policy that brakes after 20 calls to all of its instances together, and not before",
        """
calls = [0]
def decide(self, observations):
    self.calls[0] += 1
    return np.full(len(observations), IDLE if self.calls[0] < 20 else SLOWER)
""",
    ),
    _policy(
        "A policy that draws random weights when it is created",
        """
def __init__(self):
    self.weights = rng.normal(size=(35, 5))
def decide(self, observations):
    return (observations.reshape(-1, 35) @ self.weights).argmax(axis=1)
""",
        "rng = np.random.default_rng(5)",
    ),
    _policy(
        "A policy that standardises its observations over the batch",
        """
def decide(self, observations):
    place = observations[:, 0, 2]
    return np.where(place > place.mean(), FASTER, SLOWER)
""",
    ),
    _policy(
        "A policy whose answer is a different array each time it is read",
        """
def decide(self, observations):
    return Lazy(len(observations))
""",
        """
rng = np.random.default_rng(2)


class Lazy:
    def __init__(self, size):
        self.size = size

    def __array__(self, dtype=None, copy=None):
        return rng.integers(0, 5, self.size)
""",
    ),
    _policy(
        "A policy that returns 10^12 actions",
        """
def decide(self, observations):
    return np.broadcast_to(np.int64(FASTER), 10**12)
""",
    ),
    _policy(
        "A policy with an endless recursion",
        """
def decide(self, observations):
    return self.decide(observations)
""",
    ),
    _policy(
        "A policy that calls `sys.exit()`",
        """
def decide(self, observations):
    sys.exit()
""",
        "import sys",
    ),
    _policy(
        "A module that calls `sys.exit(0)` when it is imported",
        "decide = None",
        "import sys\nsys.exit(0)",
    ),
    _policy(
        "A policy with its own kind of observation, which is random",
        """
observation = Glance()
def decide(self, observations):
    return np.where(observations[:, 0, 0] > 0.5, FASTER, SLOWER)
""",
        """
rng = np.random.default_rng(3)


class Glance:
    shape = (1, 1)

    def __call__(self, scene, vehicles):
        return rng.random((vehicles[0].size, 1, 1), dtype=np.float32)
""",
    ),
    _policy(
        "A policy that replaces a method of the harness, so that nothing collides",
        """
def decide(self, observations):
    Simulation._note_collisions = lambda self: None
    return np.full(len(observations), FASTER)
""",
        "from charms_bench.engine.simulation import Simulation",
    ),
    _policy(
        "A policy that makes the processor round up",
        """
def decide(self, observations):
    ctypes.CDLL("libm.so.6").fesetround(0x800)
    return np.full(len(observations), FASTER)
""",
        "import ctypes",
    ),
    _policy(
        "A policy whose hash of weights is different each time",
        """
@property
def weights_sha256(self):
    return str(next(numbers))
def decide(self, observations):
    return np.full(len(observations), FASTER)
""",
        "from itertools import count\n\nnumbers = count()",
    ),
    _model(
        "A driver model that writes to the scene behind the read-only view",
        f"scene.x.base[vehicles] += 1.0\n{KEEPS}",
    ),
    _model(
        "A driver model that sets the timers of other vehicles",
        f"scene.timer_s[:] = 0.0\n{KEEPS}",
    ),
    _model(
        "A driver model whose answers for a scene depend on another scene",
        "return np.full(vehicles[0].size, scene.temperament[0, 1]), scene.lane[vehicles]",
    ),
    _model(
        "A driver model that changes the indices of its vehicles",
        f"vehicles[1][:] = 0\n{KEEPS}",
    ),
    _model(
        "A driver model that divides 0 by 0",
        "with np.errstate(all='ignore'):\n"
        "    return scene.speed[vehicles] * 0 / 0, scene.lane[vehicles]",
    ),
    _traffic(
        "A traffic that draws from its own random numbers",
        """
agents = ("idm_mobil", "stackelberg")
rng = np.random.default_rng(4)
def assign(self, rng, scenes, vehicles):
    return self.rng.choice(self.agents, size=(scenes, vehicles))
""",
    ),
    _policy(
        "A policy that overwrites its observations after it has decided",
        """
def decide(self, observations):
    actions = np.full(len(observations), IDLE)
    observations.flags.writeable = True
    observations[:] = 0.0
    return actions
""",
    ),
    _traffic(
        "A traffic of one agent that assigns too few",
        """
agents = ("idm_mobil",)
def assign(self, rng, scenes, vehicles):
    return np.full((scenes, vehicles - 1), "idm_mobil")
""",
    ),
    _policy(
        "A policy that ends its process",
        """
def decide(self, observations):
    os._exit(0)
""",
        "import os",
        needs_worker=True,
    ),
    _policy(
        "A policy whose rate raises an error",
        """
@property
def decision_hz(self):
    raise ValueError("ask me later")
def decide(self, observations):
    return np.full(len(observations), IDLE)
""",
    ),
    _policy(
        "A policy that raises `KeyboardInterrupt`",
        """
def decide(self, observations):
    raise KeyboardInterrupt
""",
        needs_worker=True,
    ),
    _policy(
        "A policy that never returns, with `--shard-limit 20`",
        """
def decide(self, observations):
    while True:
        pass
""",
        needs_worker=True,
        options=("--shard-limit", 20),
    ),
)
HARMLESS = (
    _policy(
        "A policy that prints a lot",
        """
def decide(self, observations):
    print("deciding")
    return np.full(len(observations), FASTER)
""",
        'print("imported")',
        needs_worker=True,
    ),
    _policy(
        "A policy that changes NumPy's error handling and its global random numbers",
        """
def decide(self, observations):
    np.seterr(all="raise")
    np.random.seed(0)
    return np.full(len(observations), FASTER)
""",
        'np.seterr(all="raise")',
    ),
    _policy(
        "A policy that returns the same array in every call, and changes it later",
        """
kept = np.zeros(100, dtype=np.int64)
def decide(self, observations):
    self.kept[:] = SLOWER
    view = self.kept[: len(observations)]
    view[:] = FASTER
    return view
""",
    ),
)
