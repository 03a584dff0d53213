"""Compiled functions of a scene: they see the arrays of the scene that they are given."""

import errno
import gc
import os
import pickle
import runpy
import subprocess
import sys
import weakref
from collections.abc import Callable
from copy import deepcopy
from itertools import product
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.caching import IndexDataCacheFile, InTreeCacheLocator, UserWideCacheLocator

from charms_bench.errors import InputError
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.world.scene import Floats, Scene, SceneSettings


@compiled_of_scenes
def _sum(scene: Scene, values: Floats, factor: float) -> float:
    total = 0.0
    for value in values:
        total += value
    return total * factor + scene.x[0, 0] + scene.road.lanes


def _scene(x: float = 0.0) -> Scene:
    scene = Scene.empty(SceneSettings(), 1)
    scene.x[0, 0] = x
    return scene


def test_every_type_and_layout_of_an_argument_gets_its_own_machine_code() -> None:
    scene, numbers = _scene(), np.arange(6)
    assert _sum(scene, numbers.astype(np.float64), 2.0) == 33
    assert _sum(scene, numbers, 2.0) == 33
    assert _sum(scene, numbers.astype(np.int32), 2) == 33
    assert _sum(scene, np.arange(12)[::2], 2.0) == 63
    assert _sum(scene, numbers.astype(np.float32), np.float64(2)) == 33
    assert _sum(scene, numbers.astype(np.float64), 2.0) == 33


def test_another_scene_is_another_argument() -> None:
    numbers = np.zeros(1)
    assert [_sum(_scene(x), numbers, 1.0) for x in (1.0, 2.0, 3.0)] == [4, 5, 6]
    shown = _scene(7.0).read_only()
    assert _sum(shown, numbers, 1.0) == 10


def test_a_scene_can_have_an_array_of_another_type() -> None:
    scene, numbers = _scene(1.5), np.zeros(1)
    assert _sum(scene, numbers, 1.0) == 4.5
    assert _sum(scene._replace(x=scene.x.astype(np.float32)), numbers, 1.0) == 4.5
    assert _sum(scene._replace(x=np.asfortranarray(scene.x)[:, ::2]), numbers, 1.0) == 4.5


def test_a_copy_of_a_scene_is_another_argument() -> None:
    scene, numbers = _scene(1.0), np.zeros(1)
    assert _sum(scene, numbers, 1.0) == 4
    for copy in (deepcopy(scene), pickle.loads(pickle.dumps(scene)), scene._replace()):
        copy.x[0, 0] = 2.0
        assert _sum(copy, numbers, 1.0) == 5


def test_no_scene_is_kept_alive() -> None:
    scene = _scene()
    _sum(scene, np.zeros(1), 1.0)
    position = weakref.ref(scene.x)
    del scene
    gc.collect()
    assert position() is None


def test_the_arrays_of_a_scene_live_as_long_as_what_compiled_code_holds_of_it() -> None:
    scene = _scene(1.0)
    position, held = weakref.ref(scene.x), scene.unpacked
    del scene
    gc.collect()
    assert position() is not None
    assert _sum.compiled(held, np.zeros(1), 1.0) == 4  # type: ignore[attr-defined]
    del held
    gc.collect()
    assert position() is None


def test_nothing_can_be_set_on_a_scene() -> None:
    scene, other = _scene(1.0), _scene(2.0)
    for name in ("unpacked", "x", "note"):
        with pytest.raises(AttributeError):
            setattr(scene, name, other.unpacked)
    assert _sum(scene, np.zeros(1), 1.0) == 4


SUM = """\
from charms_bench.foundation.compiled import compiled

@compiled
def total(count):
    found = 0
    for each in range(count):
        found += each
    return found

print(total(5))
"""


Run = Callable[[str], str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a program that compiles functions, kept in the folder `cache`; returns its output."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))

    def run(program: str) -> str:
        (tmp_path / "program.py").write_text(program)
        runpy.run_path(str(tmp_path / "program.py"), run_name="program")
        return "".join(capsys.readouterr())

    return run


def test_a_damaged_file_of_the_cache_is_compiled_again(run: Run, tmp_path: Path) -> None:
    assert run(SUM) == "10\n"
    for ending, length in product(("nbi", "nbc"), (0, 40)):
        (file,) = (tmp_path / "cache").rglob(f"*.{ending}")
        whole = file.read_bytes()
        file.write_bytes(whole[:length])
        assert run(SUM) == "10\n"
        assert len(file.read_bytes()) == len(whole)


def test_a_cache_that_cannot_be_written_does_not_end_the_program(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(IndexDataCacheFile, "_save_index", full)
    assert run(SUM) == "10\n"


def test_an_engine_that_may_not_be_compiled_names_the_variable() -> None:
    ran = subprocess.run(
        [sys.executable, "-c", "import charms_bench.foundation.compiled"],
        capture_output=True,
        text=True,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
    )
    assert "NUMBA_DISABLE_JIT is set, but the engine has to be compiled; unset it" in ran.stderr


def test_code_that_cannot_be_kept_names_the_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(InTreeCacheLocator, "ensure_cache_path", read_only)
    monkeypatch.setattr(UserWideCacheLocator, "ensure_cache_path", read_only)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    with pytest.raises(InputError, match="set NUMBA_CACHE_DIR to a folder that can"):
        compiled(lambda: 0)


BOTH = """\
import numpy as np
from charms_bench.foundation.compiled import compiled

@compiled
def twice(values):
    return 2 * values[0]

@compiled
def more(values):
    return twice(values) + 1

print(more(np.ones(1)), twice(np.ones(1)), more(np.ones(1)))
"""


def test_python_and_compiled_code_call_the_same_function_also_from_the_cache(
    run: Run, tmp_path: Path
) -> None:
    for _ in range(2):
        assert run(BOTH) == "3.0 2.0 3.0\n"
    assert len(list((tmp_path / "cache").rglob("program.twice-*.nbc"))) == 2


def two(package: Path, cache: Path, **modules: str) -> str:
    """What `outer.two` of a package prints, after some of its modules are written, and its hits."""
    package.mkdir(parents=True, exist_ok=True)
    for name, code in ({"__init__": ""} | modules).items():
        (package / f"{name}.py").write_text(code)
    ran = subprocess.run(
        [
            sys.executable,
            "-c",
            "from package.outer import two; print(two(), sum(two.stats.cache_hits.values()))",
        ],
        capture_output=True,
        text=True,
        # Python takes old bytecode for a file of the same size and the same second.
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=package.parent,
    )
    assert ran.stderr == ""
    return ran.stdout.strip()


COMPILED = "from charms_bench.foundation.compiled import compiled\n\n@compiled\n"
OUTER = f"from .inner import one\n{COMPILED}def two():\n    return one() + one()\n"


def inner(one: str) -> str:
    return f"from package.constants import ONE\n{COMPILED}def one():\n    return {one}\n"


def test_a_function_is_compiled_again_when_something_that_it_uses_has_changed(
    tmp_path: Path,
) -> None:
    package, cache = tmp_path / "package", tmp_path / "cache"
    assert two(package, cache, constants="ONE = 1", inner=inner("ONE"), outer=OUTER) == "2 0"
    assert two(package, cache, unrelated=f"{COMPILED}def one():\n    return 3\n") == "2 1"
    assert two(package, cache, inner=inner("5")) == "10 0"
    assert two(package, cache, inner=inner("ONE")) == "2 1"
    assert two(package, cache, constants="ONE = 4") == "8 0"


def test_two_installations_of_the_same_code_share_what_is_compiled(tmp_path: Path) -> None:
    modules = {"constants": "ONE = 1", "inner": inner("ONE"), "outer": OUTER}
    cache = tmp_path / "cache"
    assert two(tmp_path / "here" / "package", cache, **modules) == "2 0"
    assert two(tmp_path / "there" / "package", cache, **modules) == "2 1"
