"""Images with the light tree: against other methods of light selection and Mitsuba 3.

z-values are compared with Z = 5. False alarms of the comparison with Mitsuba: tests/references.py.
"""

import time

import numpy as np
import pytest
import scalar_mitsuba
import trimesh
from many_lights import compiled, grid_of_triangles, mixed_lights
from small_scene import lamp_over_floor

import isonoise
from isonoise.scene import structs
from isonoise.scene.light import light_tree
from isonoise.scene.light.light_tree import BVH_WIDTH, LIGHT_NODE_ROWS, build_light_tree

Z = 5.0
BATCHES = 12


def scene_with_lights(count: int) -> dict:
    """Lights of every kind around a floor, a ball of rough glass and a diffuse one."""
    scene = lamp_over_floor(max_depth=4, width=12, height=9)
    scene.pop("lamp")
    large = np.diag([6.0, 6.0, 1.0, 1.0])
    large[2, 3] = -1.0
    scene["floor"]["to_world"] = large
    scene["glass"] = {"type": "sphere", "radius": 0.6, "bsdf": {"type": "roughdielectric", "alpha": 0.3}}
    scene["ball"] = {"type": "sphere", "center": [1.3, 0.4, -0.4], "radius": 0.5}
    return scene | mixed_lights(count, seed=9)


@pytest.mark.long
@pytest.mark.usefixtures("one_lane")
def test_images_with_and_without_the_tree_agree(monkeypatch):
    """z-values of the means of blocks of pixels, and of the image mean, over independent renders."""
    images, scene = {}, scene_with_lights(48)
    for min_lights in (10**9, 1):
        monkeypatch.setattr(light_tree, "MIN_TREE_LIGHTS", min_lights)
        images[min_lights] = np.stack(
            [
                isonoise.render(scene, spp=64, strategy="uniform:wave_spp=64", seed=seed).statistics.mean
                for seed in range(BATCHES)
            ]
        )
    without, with_tree = (
        i.reshape(BATCHES, 3, 3, 4, 3).mean(axis=(2, 4)).reshape(BATCHES, -1) for i in images.values()
    )
    for a, b in ((without, with_tree), (without.mean(axis=1), with_tree.mean(axis=1))):
        se = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / BATCHES)
        # 2.1: Student's t, 11 degrees of freedom at least
        assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 2.1 * Z * se).all()


@pytest.mark.long
@pytest.mark.usefixtures("one_lane")
def test_less_noise_with_distant_lights(monkeypatch):
    """300 lamps over a large floor: without the tree most samples go to distant lamps."""
    scene = lamp_over_floor(max_depth=2)
    scene.pop("lamp")
    scene["floor"]["to_world"] = np.diag([20.0, 20.0, 1.0, 1.0])
    for index, (x, y) in enumerate(np.random.default_rng(2).uniform(-20, 20, (300, 2))):
        scene[f"lamp{index}"] = {"type": "point", "position": [x, y, 1.0], "intensity": 1.0}
    variance = {}
    for min_lights in (10**9, 1):
        monkeypatch.setattr(light_tree, "MIN_TREE_LIGHTS", min_lights)
        variance[min_lights] = isonoise.render(scene, spp=256, strategy="uniform").statistics.variance.mean()
    assert variance[1] < 0.1 * variance[10**9]


def test_against_mitsuba(monkeypatch, tmp_path):
    monkeypatch.setattr(light_tree, "MIN_TREE_LIGHTS", 1)
    scene = scene_with_lights(24)
    for name, shape in scene.items():
        if isinstance(shape, dict) and shape["type"] == "mesh":
            scene[name] = {"type": "ply", "filename": str(tmp_path / f"{name}.ply"), "emitter": shape["emitter"]}
            trimesh.Trimesh(shape["vertices"], shape["faces"], process=False).export(scene[name]["filename"])
    scalar_mitsuba.assert_same_picture(scene, tmp_path, spp=64)


def test_few_lights_are_selected_by_power():
    from isonoise.integrator.features import features

    few = compiled(floor={"type": "rectangle"}, lamp={"type": "sphere", "emitter": {"type": "area", "radiance": 1.0}})
    many = compiled(floor={"type": "rectangle"}, lamp=grid_of_triangles(32))
    assert not features(few)["LIGHT_TREE"]
    assert features(many)["LIGHT_TREE"]
    dark = compiled(lamp=grid_of_triangles(32) | {"bsdf": {"type": "dielectric"}})
    assert not features(dark)["LIGHT_TREE"]  # no material needs next-event estimation


@pytest.mark.long
@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_ten_thousand_triangles_are_as_good_as_a_rectangle(sampler):
    """RMS relative error at equal CPU time (2 s, median of 3 alternating runs)."""
    large = np.diag([4.0, 4.0, 1.0, 1.0])
    scene = lamp_over_floor(width=48, height=48) | {"floor": {"type": "rectangle", "to_world": large}}
    facing_down = np.diag([0.5, -0.5, -0.5, 1.0])
    facing_down[2, 3] = 1.0
    emitter = {"type": "area", "radiance": 5.0}
    whole = {"type": "rectangle", "to_world": facing_down, "emitter": emitter}
    tiled = grid_of_triangles(71) | {"to_world": facing_down, "emitter": emitter}
    errors = {"whole": [], "tiled": []}
    for seed in range(3):
        for name, lamp in (("whole", whole), ("tiled", tiled)):
            renderer = isonoise.Renderer(
                scene | {"lamp": lamp}, strategy="uniform:wave_spp=4", seed=seed, sampler=sampler
            )
            begun = time.process_time()
            while time.process_time() < begun + 2.0:
                renderer.step()
            statistics = renderer.statistics()
            lit = statistics.mean > 0
            relative = statistics.variance_of_mean()[lit] / statistics.mean[lit] ** 2
            errors[name].append(np.sqrt(relative.mean()))
    assert np.median(errors["tiled"]) <= 1.3 * np.median(errors["whole"])


@pytest.mark.long
def test_a_million_lights():
    """Built within a minute, with at most 11 levels."""
    scene = compiled(lamp=grid_of_triangles(708))
    begun = time.perf_counter()
    tree = build_light_tree(scene)
    assert time.perf_counter() - begun < 60
    assert tree.nodes.shape[1:] == (LIGHT_NODE_ROWS, BVH_WIDTH)
    lights, depth = len(scene.lights), 0
    parents = tree.parents[:lights]
    while (parents != structs.NONE).any():
        parents = tree.parents[lights + parents[parents != structs.NONE] // BVH_WIDTH]
        depth += 1
    assert depth < 12
