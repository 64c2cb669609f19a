"""Light records: order, power, selection by power and radiance scale."""

import numpy as np
import pytest
from records import slot

from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.light.light_kinds import light_bits
from isonoise.scene.light.lights import light_power_cdf
from isonoise.scene.light.parallelograms import find_parallelograms
from isonoise.scene.mesh.triangle_records import triangle_records
from isonoise.scene.spectra import MITSUBA_LUMINANCE


def scene_with(**objects) -> dict:
    return load_description({"type": "scene", "sensor": {"type": "perspective"}, **objects})


def weight_distributions() -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    weights = []
    for count in (1, 2, 3, 17, 1000, 200_000):
        weights += [np.ones(count), rng.random(count) + 1e-3, rng.pareto(0.5, count) + 1e-12]
        weights.append(np.where(rng.random(count) < 0.9, 0.0, rng.random(count)) + np.eye(1, count, count // 2)[0])
        weights.append(np.eye(1, count, count - 1)[0])
        weights.append(np.arange(count) % 4 // 2 + np.eye(1, count)[0])  # deficits that end where surpluses end
    return weights


@pytest.mark.parametrize("weights", weight_distributions())
def test_power_cdf_selects_in_proportion_to_weights(weights):
    probabilities = weights / weights.sum()
    cdf, stated = light_power_cdf(probabilities)
    selected = np.diff(np.append(cdf @ [1.0, 2.0**-24], 1.0))
    assert np.array_equal(selected, stated)
    assert np.array_equal(selected > 0, probabilities > 0)
    # sums round by half a unit of 2^-48, and no probability is below two of them
    np.testing.assert_allclose(selected, np.maximum(probabilities, 0), rtol=1e-9, atol=len(weights) * 2.0**-46)


def test_lights_know_their_primitives_and_primitives_their_lights():
    scene = compile_scene(
        scene_with(
            dark={"type": "cube"},
            ball={"type": "sphere"},
            first={"type": "rectangle", "emitter": {"type": "area", "radiance": 2.0}},
            second={"type": "cube", "emitter": {"type": "area", "radiance": 1.0}},
            lamp={"type": "sphere", "radius": 0.5, "emitter": {"type": "area", "radiance": 1.0}},
        )
    )
    assert scene.shapes["first_primitive"].tolist() == [0, 0, 12, 14, 1]
    is_sphere = scene.lights["kind"] == light_bits("sphere")
    sides = scene.lights[~is_sphere]
    assert sorted(sides["primitive"]) == [12, *range(14, 26, 2)]
    assert (sides["kind"] == light_bits("parallelogram")).all()
    assert (sides["area"] == 4).all()
    assert scene.lights["primitive"][is_sphere].tolist() == [1]
    (sphere,) = np.flatnonzero(is_sphere)
    assert scene.shapes["light"].tolist() == [structs.NONE] * 4 + [sphere]
    light = triangle_records(scene)["light"]
    assert (light[:12] == structs.NONE).all()
    assert scene.lights["primitive"][light[12:]].tolist() == np.repeat([12, *range(14, 26, 2)], 2).tolist()


def test_neighbours_among_lights_are_neighbours_in_space():
    """Along a Morton curve: of lamps on a grid of 8 x 8, every eighth of the list is a block of 2 x 4; sky is last."""
    places = np.random.default_rng(1).permutation([(x, y, 0.0) for x in range(8) for y in range(8)])
    sky = {"sky": {"type": "constant", "radiance": 0.1}}
    lamps = {f"lamp{i}": {"type": "point", "position": place, "intensity": 1.0} for i, place in enumerate(places)}
    scene = compile_scene(scene_with(**sky, **lamps))
    assert scene.environment_light == 64
    block = scene.lights["position"][:64].reshape(8, 8, 3)
    assert sorted((np.ptp(block, axis=1)[0] + 1).tolist()) == [1.0, 2.0, 4.0]
    assert (np.ptp(block, axis=1) == np.ptp(block, axis=1)[0]).all()


def test_selection_is_proportional_to_power():
    """Powers in closed form: pi A L, 4 pi I, pi r^2 E, 4 pi^2 r^2 L; r is the radius of the scene's bounding sphere."""
    scene = compile_scene(
        scene_with(
            quad={"type": "rectangle", "emitter": {"type": "area", "radiance": 3.0}},
            ball={"type": "sphere", "radius": 0.5, "emitter": {"type": "area", "radiance": 5.0}},
            disk={"type": "disk", "emitter": {"type": "area", "radiance": 7.0}},
            tube={"type": "cylinder", "radius": 0.5, "emitter": {"type": "area", "radiance": 11.0}},
            point={"type": "point", "intensity": 13.0},
            sun={"type": "directional", "irradiance": 17.0},
            sky={"type": "constant", "radiance": 19.0},
        )
    )
    radius_squared = 0.25 * (2**2 + 2**2 + 1.5**2)  # x, y in -1..1, z in -0.5..1
    powers = {
        "parallelogram": np.pi * 4 * 3.0,
        "sphere": np.pi * np.pi * 5.0,
        "disk": np.pi * np.pi * 7.0,
        "cylinder": np.pi * np.pi * 11.0,
        "point": 4 * np.pi * 13.0,
        "directional": np.pi * radius_squared * 17.0,
        "constant": 4 * np.pi**2 * radius_squared * 19.0,
    }
    expected = {light_bits(name): power / sum(powers.values()) for name, power in powers.items()}
    assert sorted(scene.lights["kind"]) == sorted(expected)
    np.testing.assert_allclose(
        scene.lights["power_pmf"], [expected[int(kind)] for kind in scene.lights["kind"]], rtol=2e-6
    )
    assert scene.lights["kind"][scene.environment_light] == light_bits("constant")


def test_dark_and_degenerate_primitives_are_never_selected():
    scene = compile_scene(
        scene_with(
            black={"type": "rectangle", "emitter": {"type": "area", "radiance": 0.0}},
            sliver={
                "type": "mesh",
                "vertices": np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0.0]]),
                "faces": np.array([[0, 1, 2], [0, 1, 3]]),
                "emitter": {"type": "area", "radiance": 1.0},
            },
        )
    )
    assert sorted(scene.lights["power_pmf"]) == [0, 0, 1]
    assert (scene.lights["area"][scene.lights["power_pmf"] == 1] == 0.5).all()


def test_lights_without_power_and_scenes_without_light():
    dark = compile_scene(scene_with(sky={"type": "constant", "radiance": 0.0}))
    assert dark.radiance_scale == 1.0
    assert dark.lights["power_pmf"].tolist() == [1.0]
    none = compile_scene(scene_with())
    assert none.radiance_scale == 1.0
    assert len(none.lights) == len(none.light_cdf) == 0
    assert none.environment_light == -1


@pytest.mark.parametrize("exponent", [-60, -20, 20, 60])
def test_scaling_all_lights_by_a_power_of_two_changes_nothing_but_the_scale(exponent):
    def scene(factor):
        return compile_scene(
            scene_with(
                quad={"type": "rectangle", "emitter": {"type": "area", "radiance": 3.3 * factor}},
                point={"type": "point", "intensity": {"type": "rgb", "value": [0.1 * factor, 0.7 * factor, 0]}},
                sky={"type": "constant", "radiance": {"type": "spectrum", "value": 0.01 * factor}},
            )
        )

    plain, scaled = scene(1.0), scene(2.0**exponent)
    assert scaled.radiance_scale == plain.radiance_scale * 2.0**-exponent
    assert plain.lights.tobytes() == scaled.lights.tobytes()
    assert plain.light_cdf.tobytes() == scaled.light_cdf.tobytes()
    assert plain.hash != scaled.hash


def test_the_scale_brings_the_brightest_emitter_near_one():
    for value in (1e-30, 0.3, 1.0, 1.9999, 2.0, 17.0, 1e30):
        scene = compile_scene(scene_with(sky={"type": "constant", "radiance": value}))
        assert np.log2(scene.radiance_scale) % 1 == 0
        assert 1.0 <= scene.lights["radiance"][0].astype(float) @ MITSUBA_LUMINANCE * (1 + 1e-6) < 2.0 * (1 + 1e-5)


@pytest.mark.long
def test_a_million_emissive_triangles():
    side = 724
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    corner = (y[:-1, :-1] * side + x[:-1, :-1]).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + side], 1), np.stack([corner + 1, corner + side + 1, corner + side], 1)]
    )
    rng = np.random.default_rng(3)
    vertices = np.stack([x.ravel(), y.ravel(), rng.random(side * side)], 1).astype(float)
    shape = {"type": "mesh", "vertices": vertices, "faces": faces, "emitter": {"type": "area", "radiance": 1.0}}
    scene = compile_scene(scene_with(field=shape))
    assert len(scene.lights) == 2 * (side - 1) ** 2 > 10**6
    areas = scene.lights["area"].astype(float)
    np.testing.assert_allclose(scene.lights["power_pmf"], areas / areas.sum(), rtol=2e-6)


def test_emitters_without_bsdf_are_black():
    """As in Mitsuba 3, the default reflectance is 0.5, and 0 for emissive shapes."""
    lamp = {"type": "sphere", "emitter": {"type": "area", "radiance": 1.0}}
    scene = compile_scene(scene_with(lamp=lamp, ball={"type": "sphere"}))
    is_emissive = scene.shapes["light"] != structs.NONE
    reflectance = slot(scene.bsdfs, "reflectance")[scene.shapes["bsdf"]]
    assert (reflectance[is_emissive] == 0).all()
    assert (reflectance[~is_emissive] == 0.5).all()


# Parallelograms.

CORNERS = np.array([[0, 0, 0], [2, 0.5, 0], [2.5, 1.5, 1], [0.5, 1, 1.0]])  # in order around it


def kinds_of(vertices, faces, **more) -> list[str]:
    """Returns the kinds of the lights of a mesh, in the order of its triangles."""
    emitter = {"type": "area", "radiance": 1.0}
    mesh = {"type": "mesh", "vertices": np.asarray(vertices, float), "faces": np.array(faces), "emitter": emitter}
    lights = compile_scene(scene_with(lamp=mesh | {"face_normals": True} | more)).lights
    names = {light_bits(name): name for name in ("triangle", "parallelogram")}
    return [names[int(kind)] for kind in lights["kind"][np.argsort(lights["primitive"])]]


@pytest.mark.parametrize("first", range(3))
@pytest.mark.parametrize("second", range(3))
@pytest.mark.parametrize("flip", [False, True])
def test_two_triangles_are_one_light_whatever_their_first_corners(first, second, flip):
    faces = [np.roll([0, 1, 2], first), np.roll([0, 2, 3], second)]
    assert kinds_of(CORNERS, faces, flip_normals=flip) == ["parallelogram"]
    assert kinds_of(CORNERS[[0, 1, 2, 0, 2, 3]], [faces[0], [3, 4, 5]]) == ["parallelogram"]  # corners apart
    assert kinds_of(CORNERS, faces, face_normals=False) == ["parallelogram"]


def test_what_is_no_parallelogram_stays_triangles():
    quad = [[0, 1, 2], [0, 2, 3]]
    for change in ([0, 0, 0.01], [0.01, 0, 0], [-0.5, -1, -1]):
        assert kinds_of(CORNERS + np.outer([0, 0, 0, 1], change), quad) == ["triangle"] * 2
    assert kinds_of(CORNERS, [[0, 1, 2], [3, 2, 0]]) == ["triangle"] * 2  # opposite sides
    assert kinds_of(CORNERS, [[0, 1, 2], [1, 2, 0]]) == ["triangle"] * 2  # twice the same
    assert kinds_of(CORNERS * [1, 0, 0], quad) == ["triangle"] * 2  # without area
    far = CORNERS * 1.3e-3 + [1e4, 0, 0]  # rounding moves the corners by a fraction of the side
    assert not len(find_parallelograms(far.astype(np.float32), np.array(quad))[0])


def test_triangles_belong_to_one_parallelogram_at_most():
    """A strip, in which each triangle forms one with both neighbours, and a triangle between two quads."""
    strip = np.array([(x, y, 0) for x in range(4) for y in range(2)], float)
    faces = [[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5], [4, 6, 5]]
    assert kinds_of(strip, faces) == ["parallelogram", "parallelogram", "triangle"]
    vertices = np.concatenate([CORNERS, CORNERS[:3] + 5, CORNERS + 9])
    assert kinds_of(vertices, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [7, 8, 9], [7, 9, 10]]) == [
        "parallelogram",
        "triangle",
        "parallelogram",
    ]


def test_the_box_of_cornell_has_one_light():
    assert compile_scene(load_description("cornell")).lights["kind"].tolist() == [light_bits("parallelogram")]


@pytest.mark.parametrize("radiance", [None, 0.0, 1.0])
def test_a_scene_without_light_gives_a_warning(radiance, recwarn):
    lamp = {} if radiance is None else {"emitter": {"type": "area", "radiance": radiance}}
    compile_scene(scene_with(it={"type": "sphere", "center": (0, 0, 5), **lamp}))
    assert [str(each.message).split(",")[0] for each in recwarn] == ["the scene has no light"] * (radiance != 1.0)
