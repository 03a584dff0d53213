"""Single scenes, written down by a test or drawn by hypothesis."""

from typing import Any

import numpy as np
from hypothesis import strategies as st

from charms_bench.engine.neighbours import locate
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Scene, SceneSettings


def scene_of(
    profile: str = "highway-env",
    lanes: int = 3,
    sizes: dict[str, float] | None = None,
    **fields: Any,
) -> Scene:
    """A scene whose arrays hold `fields`, a number a vehicle; the first vehicle is the ego.

    Vehicles keep to their nearest lane and their speed where the fields say nothing of it. `sizes`
    replace constants of the profile.
    """
    vehicles = len(fields["x"])
    settings = SceneSettings(
        profile=PROFILES[profile], lanes=lanes, traffic_vehicles=vehicles - 1, ego_slots=1
    )
    parameters = np.shape(fields.get("parameters", [[]]))[-1]
    scene = Scene.empty(settings, 1, parameters)
    mixed = "length" in fields or "width" in fields
    of_road = {k: value for k, value in (sizes or {}).items() if k in scene.road._fields}
    own = {k: value for k, value in (sizes or {}).items() if k not in of_road}
    scene = scene._replace(
        road=scene.road._replace(**of_road),
        constants=scene.constants._replace(mixed_sizes=mixed, **own),
    )
    scene.length[:], scene.width[:] = scene.constants.length, scene.constants.width
    for name, values in fields.items():
        getattr(scene, name)[0] = values
    scene.order[0] = np.random.default_rng(0).permutation(vehicles)
    scene.rank[0, scene.order[0]] = np.arange(vehicles)
    locate(scene, np.array([0]))
    if "target_lane" not in fields:
        scene.target_lane[:] = scene.lane
        locate(scene, np.array([0]))  # the neighbours on the target lanes
    if "target_speed" not in fields:
        scene.target_speed[:] = scene.speed
    scene.active[:] = True
    return scene


def all_vehicles(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """All vehicles of a single scene, as driver models are given them."""
    places = np.arange(scene.x.shape[1])
    return np.zeros_like(places), places


@st.composite
def scenes(
    draw: st.DrawFn, most_vehicles: int = 8, profiles: tuple[str, ...] = tuple(PROFILES)
) -> Scene:
    """Crowded scenes: vehicles level with each other, on two lanes, beside the road and beyond it.

    Vehicles, lanes and the road have different sizes, and so have the vehicles of half the scenes.
    """
    lanes = draw(st.integers(2, 5))
    vehicles = draw(st.integers(2, most_vehicles))

    def each(values: st.SearchStrategy[Any]) -> list[Any]:
        return draw(st.lists(values, min_size=vehicles, max_size=vehicles))

    level = st.sampled_from([-6.0, -5.0, 0.0, 10.0, 25.0, 35.0, 40.0])
    lengths, widths = st.sampled_from([5.0, 3.0, 18.0]), st.sampled_from([2.0, 1.6, 2.6])
    sizes = {
        "length": draw(lengths),
        "width": draw(widths),
        "lane_width": draw(st.sampled_from([4.0, 3.0, 4.5, 0.9])),
        "road_length": draw(st.sampled_from([10_000.0, 30.0])),
    }
    own = {"length": each(lengths), "width": each(widths)} if draw(st.booleans()) else {}
    centres = st.integers(0, lanes - 1).map(lambda lane: sizes["lane_width"] * lane)
    return scene_of(
        profile=draw(st.sampled_from(profiles)),
        lanes=lanes,
        sizes=sizes,
        **own,
        x=each(st.one_of(level, st.floats(-8.0, 120.0))),
        y=each(st.one_of(centres, st.floats(-4.0, 4.0 * lanes))),
        heading=each(st.one_of(st.just(0.0), st.floats(-0.5, 0.5))),
        speed=each(st.floats(0.0, 40.0)),
        target_speed=each(st.floats(15.0, 35.0)),
        target_lane=each(st.integers(0, lanes - 1)),
        timer_s=each(st.sampled_from([0.5, 1.5])),
        temperament=each(st.floats(0.0, 1.0)),
        crashed=each(st.sampled_from([False, False, False, True])),
    )
