"""Compiled functions of a scene: they see the arrays of the scene that they are given."""

import gc
import pickle
import weakref
from copy import deepcopy

import numpy as np
import pytest

from charms_bench.world.compiled import compiled_of_scenes
from charms_bench.world.scene import Floats, Scene, SceneSettings


@compiled_of_scenes
def _sum(scene: Scene, values: Floats, factor: float) -> float:
    total = 0.0
    for value in values:
        total += value
    return total * factor + scene.x[0, 0] + scene.constants.lanes


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


def test_nothing_can_be_set_on_a_scene() -> None:
    scene, other = _scene(1.0), _scene(2.0)
    for name in ("unpacked", "x", "note"):
        with pytest.raises(AttributeError):
            setattr(scene, name, other.unpacked)
    assert _sum(scene, np.zeros(1), 1.0) == 4
