"""pbrt's lights and spectra: units, directions, environment maps."""

import math

import numpy as np
import OpenEXR
import pytest
from pbrt_files import objects, only, read_world

import isonoise
from isonoise.scene.formats.pbrt.environment import equal_area_directions, equal_area_square, resample_equal_area
from isonoise.scene.image.image import Image
from isonoise.scene.light.envmap import build_environment_map
from isonoise.scene.light.projections import project_image
from isonoise.scene.spectra import MITSUBA_LUMINANCE


def value(colour: dict) -> np.ndarray:
    return np.array(colour["value"])


def light(tmp_path, text: str, type_: str, options: str = "") -> dict:
    scene, report = read_world(tmp_path, text, options)
    assert not report.warnings()
    isonoise.load(scene)
    return only(scene, type_)


def test_point_lights(tmp_path):
    made = light(tmp_path, 'Translate 1 0 0 LightSource "point" "rgb I" [1 2 3] "point3 from" [0 2 0]', "point")
    assert made["position"] == [1, 2, 0]
    assert value(made["intensity"]).tolist() == [1, 2, 3]
    made = light(tmp_path, 'LightSource "point" "float power" 100 "float scale" 2', "point")
    assert value(made["intensity"]) == pytest.approx([200 / (4 * math.pi)] * 3)


def test_narrow_spots_have_their_power(tmp_path):
    """The cosines of such angles round to 1; the solid angle is pi a^2."""
    text = 'LightSource "spot" "float coneangle" 1e-5 "float conedeltaangle" 0 "float power" 2'
    intensity = value(light(tmp_path, text, "spot")["intensity"])
    assert intensity == pytest.approx([2 / (math.pi * math.radians(1e-5) ** 2)] * 3)


def test_scale_of_the_film_of_pbrt_v3_scales_lights(tmp_path):
    """Its exposure time does not."""
    options = 'Film "image" "float scale" 3 "float maxsampleluminance" 9\nCamera "perspective" "float shutterclose" 0.5'
    scene, report = read_world(tmp_path, 'LightSource "point" "rgb I" [1 2 3]', options)
    assert only(scene, "point")["intensity"]["value"] == pytest.approx([3, 6, 9])
    assert "'maxsampleluminance' is ignored" in report.warnings()[0]


def test_exposure_scales_lights(tmp_path):
    """pbrt-v4's imaging ratio: exposure time times ISO / 100."""
    options = 'Film "rgb" "float iso" 400 Camera "perspective" "float shutteropen" 0.5 "float shutterclose" 0.75'
    made = light(tmp_path, 'LightSource "point" "rgb I" [1 2 3]', "point", options)
    assert value(made["intensity"]).tolist() == [1, 2, 3]
    made = light(tmp_path, 'LightSource "point" "rgb I" [1 2 3]', "point", options.replace("400", "200"))
    assert value(made["intensity"]).tolist() == [0.5, 1, 1.5]


def test_distant_lights_shine_from_from_to_to(tmp_path):
    text = 'Rotate 90 0 0 1 LightSource "distant" "point3 from" [2 0 0] "point3 to" [0 0 0] "float illuminance" 3'
    made = light(tmp_path, text, "directional")
    assert made["direction"] == pytest.approx([0, -1, 0])
    assert value(made["irradiance"]).tolist() == [3, 3, 3]


def test_spot_lights(tmp_path):
    text = 'LightSource "spot" "point3 from" [0 3 0] "point3 to" [0 0 0] "float coneangle" 40 "float conedeltaangle" 10'
    made = light(tmp_path, text, "spot")
    assert made["cutoff_angle"] == made["beam_width"] == 40
    assert made["to_world"][:3, 2] == pytest.approx([0, -1, 0])
    assert made["to_world"][:3, 3] == pytest.approx([0, 3, 0])
    profile = made["texture"]["bitmap"].pixels[128, :, 0]  # along u; u - 0.5 is the tangent over twice that of the cone
    for degrees in (10, 29, 33, 37, 39):
        u = 0.5 + 0.5 * math.tan(math.radians(degrees)) / math.tan(math.radians(40))
        t = (math.cos(math.radians(degrees)) - math.cos(math.radians(40))) / (
            math.cos(math.radians(30)) - math.cos(math.radians(40))
        )
        t = min(max(t, 0.0), 1.0)
        assert profile[round(u * 256 - 0.5)] == pytest.approx(t * t * (3 - 2 * t), abs=0.03)  # pbrt's SmoothStep
    sharp = light(tmp_path, text.replace("Angle 10", "") + ' "float conedeltaangle" 0 "float power" 10', "spot")
    assert "texture" not in sharp
    assert value(sharp["intensity"]) == pytest.approx([10 / (2 * math.pi * (1 - math.cos(math.radians(40))))] * 3)
    _, report = read_world(tmp_path, text.replace("40", "80"))
    assert "soft edge of a wide cone" in report.warnings()[0]


TURNS = {"plain": "", "turned": "Rotate 35 1 2 3 Translate 1 2 3", "mirrored": "Scale -2 2 2 Rotate 35 1 2 3"}


def radiant_intensity(projector: dict, direction: np.ndarray) -> np.ndarray:
    """Of one of our projectors: irradiance at distance 1, perpendicular to the direction; 0 outside its image."""
    pixels = projector["irradiance"]["bitmap"].pixels
    height, width, _ = pixels.shape
    u, v, w = project_image(projector, width / height).to_uv @ direction
    if not (w > 0 and 0 <= u / w < 1 and 0 <= v / w < 1):
        return np.zeros(3)
    axis = projector["to_world"][:3, 2]
    return pixels[int(v / w * height), int(u / w * width)] / (w * w * (axis @ direction)) * projector.get("scale", 1)


@pytest.mark.parametrize("name", TURNS)
def test_projections_show_their_image_as_pbrt_does(tmp_path, name):
    image = np.random.default_rng(2).random((6, 8, 3))
    write_image(tmp_path / "image.exr", image)
    world = f'{TURNS[name]} Shape "disk" LightSource "projection" "string filename" "image.exr" "float fov" 50'
    scene, report = read_world(tmp_path, world + ' "float scale" 2')
    to_light = np.linalg.inv(only(scene, "disk")["to_world"][:3, :3])
    hits = 0
    for direction in np.random.default_rng(3).normal(size=(200, 3)):
        direction /= np.linalg.norm(direction)
        x, y, z = to_light @ direction
        tangent = math.tan(math.radians(25))
        s, t = 0.5 + 0.5 * x / z / tangent / (8 / 6), 0.5 - 0.5 * y / z / tangent  # ProjectionLight::I, y flipped
        is_inside = z > 0 and 0 <= s < 1 and 0 <= t < 1
        expected = 2 * image[int(t * 6), int(s * 8)] if is_inside else np.zeros(3)
        got = radiant_intensity(only(scene, "projector"), direction)
        # pixels have the cosine of their centers
        assert got == pytest.approx(expected, rel=0.35, abs=1e-6)
        hits += is_inside
    assert hits > 5
    assert not report.warnings()


def test_power_of_a_projection(tmp_path):
    write_image(tmp_path / "image.exr", np.full((64, 96, 3), 3.0))
    world = 'LightSource "projection" "string filename" "image.exr" "float fov" 60 "float power" 7'
    made = light(tmp_path, world, "projector")
    x, y = np.meshgrid(np.linspace(-0.86, 0.86, 300), np.linspace(-0.57, 0.57, 300))
    cosine = 1 / np.sqrt(1 + x**2 + y**2)
    intensity = made["irradiance"]["bitmap"].pixels[32, 48, 0] * math.pi * made["scale"]
    area = 4 * math.tan(math.radians(30)) ** 2 * 1.5
    assert intensity * (cosine**3).mean() * area == pytest.approx(7, rel=0.02)


@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize("is_square", [True, False])
def test_goniometric_lights_are_cubes_of_projectors(tmp_path, name, is_square):
    if is_square:
        x, z, y = np.moveaxis(equal_area_directions(64), 2, 0)  # y is up in the light's space
    else:
        theta, phi = np.meshgrid(np.pi * (np.arange(64) + 0.5) / 64, 2 * np.pi * (np.arange(128) + 0.5) / 128)
        x, y, z = (np.sin(theta) * np.cos(phi)).T, np.cos(theta).T, (np.sin(theta) * np.sin(phi)).T
    diagram = 2 + 1.0 * x + 0.6 * y - 0.3 * z
    write_image(tmp_path / "image.exr", np.repeat(diagram[..., None], 3, axis=2))
    world = f'{TURNS[name]} Shape "disk" LightSource "goniometric" "string filename" "image.exr" "rgb I" [1 2 3]'
    scene, report = read_world(tmp_path, world)
    made = objects(scene, "projector")
    assert len(made) == 6
    to_light = np.linalg.inv(only(scene, "disk")["to_world"][:3, :3])
    to_light /= abs(np.linalg.det(to_light)) ** (1 / 3)
    for direction in np.random.default_rng(3).normal(size=(60, 3)):
        direction /= np.linalg.norm(direction)
        x, y, z = to_light @ direction
        total = sum(radiant_intensity(projector, direction) for projector in made)
        assert total == pytest.approx((2 + x + 0.6 * y - 0.3 * z) * np.array([1, 2, 3]), rel=0.12)
    assert not report.warnings()
    isonoise.load(scene)


def test_area_lights(tmp_path):
    area = 'AreaLightSource "diffuse" "rgb L" [1 2 3] "float scale" 2 '
    sphere = 'Shape "sphere" "float radius" 2'
    scene, _ = read_world(tmp_path, area + sphere)
    assert value(only(scene, "sphere")["emitter"]["radiance"]).tolist() == [2, 4, 6]
    scene, _ = read_world(tmp_path, area + '"float power" 10 ' + sphere)
    assert value(only(scene, "sphere")["emitter"]["radiance"]) == pytest.approx(
        np.array([2, 4, 6]) * 10 / (math.pi * 16 * math.pi)
    )
    quad = 'Shape "trianglemesh" "point3 P" [0 0 0 2 0 0 2 1 0 0 1 0] "integer indices" [0 1 2 0 2 3]'
    scene, report = read_world(tmp_path, 'AreaLightSource "diffuse" "float power" 10 ' + quad)
    # pbrt gives the power to each of the two triangles
    assert value(only(scene, "mesh")["emitter"]["radiance"]) == pytest.approx([10 / math.pi] * 3)
    assert not report.warnings()


@pytest.mark.parametrize("shape", ['"sphere"', '"disk"', '"cylinder"', '"trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0]'])
def test_two_sided_lights_are_two_shapes_back_to_back(tmp_path, shape):
    scene, report = read_world(tmp_path, f'AreaLightSource "diffuse" "bool twosided" true Shape {shape}')
    shapes = [value for value in scene.values() if isinstance(value, dict) and "emitter" in value]
    front, back = shapes
    if "vertices" in front:
        assert (front["faces"][:, ::-1] == back["faces"]).all()
        assert back["vertices"][:, 2] == pytest.approx(-1e-4)  # behind the front, whose normal is +z
    else:
        assert (front["flip_normals"], back["flip_normals"]) == (False, True)
    assert not report.warnings()
    isonoise.load(scene)


def test_spectra_of_lights_have_luminance_1(tmp_path):
    for text in ('"blackbody I" 3000', '"spectrum I" [400 5 500 7 700 9]', '"spectrum I" "stdillum-A"'):
        made = light(tmp_path, f'LightSource "point" {text} "float scale" 2', "point")
        assert MITSUBA_LUMINANCE @ value(made["intensity"]) == pytest.approx(2, rel=1e-3)
    white = light(tmp_path, 'LightSource "point" "spectrum I" "stdillum-D65"', "point")
    assert value(white["intensity"]) == pytest.approx([1, 1, 1], abs=2e-3)
    # the chromaticity of a black body at 6504 K is near that of D65; at 2856 K it is that of the illuminant A
    tungsten, illuminant = (
        value(light(tmp_path, f'LightSource "point" {text}', "point")["intensity"])
        for text in ('"blackbody I" 2856', '"spectrum I" "stdillum-A"')
    )
    assert tungsten == pytest.approx(illuminant, abs=6e-3)


def test_spectrum_files_and_colour_spaces(tmp_path):
    (tmp_path / "grey.spd").write_text("# a comment\n300 0.25\n900 0.25 # more\n")
    world = 'ColorSpace "rec2020" Material "diffuse" "spectrum reflectance" "grey.spd" Shape "sphere"\n'
    scene, report = read_world(tmp_path, world + 'LightSource "point" "rgb I" [1 1 1]')
    assert value(only(scene, "sphere")["bsdf"]["bsdf"]["reflectance"]) == pytest.approx([0.25] * 3, abs=1e-3)
    assert value(only(scene, "point")["intensity"]) == pytest.approx([1, 1, 1], abs=2e-4)  # the same white
    assert not report.warnings()


def test_equal_area_mapping_has_an_inverse():
    size = 16
    directions = equal_area_directions(size)
    centers = (np.arange(size) + 0.5) / size
    assert np.linalg.norm(directions, axis=2) == pytest.approx(1)
    assert equal_area_square(directions)[..., 0] == pytest.approx(np.broadcast_to(centers, (size, size)))
    assert equal_area_square(directions)[..., 1] == pytest.approx(np.broadcast_to(centers[:, None], (size, size)))
    # equal areas: the mean of z^2 over the sphere is 1/3, and the centre of the square is +z
    assert (equal_area_directions(64) ** 2).mean(axis=(0, 1)) == pytest.approx([1 / 3] * 3, abs=1e-3)
    assert equal_area_square(np.array([0.0, 0, 1])) == pytest.approx([0.5, 0.5])


def test_resampled_maps_keep_radiance_and_mean():
    size = 24
    directions = equal_area_directions(size)
    square = (1 + directions).astype(np.float32)  # a smooth map: radiance 1 + direction
    made = build_environment_map(resample_equal_area(Image(square)), np.eye(4), 1.0, "map")
    assert made.mean == pytest.approx([1, 1, 1], abs=5e-3)
    pixels = resample_equal_area(Image(square)).pixels
    rows, columns, _ = pixels.shape
    for row, column in ((5, 7), (20, 90), (40, 33)):
        theta, azimuth = math.pi * row / (rows - 1), 2 * math.pi * (column + 0.5) / columns
        direction = [math.sin(theta) * math.sin(azimuth), math.cos(theta), -math.sin(theta) * math.cos(azimuth)]
        assert pixels[row, column] == pytest.approx(1 + np.array(direction), abs=0.08)


def write_image(path, pixels: np.ndarray) -> None:
    channels = {"RGB": np.ascontiguousarray(pixels, dtype=np.float32)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels).write(str(path))


def bright_direction(emitter: dict) -> np.ndarray:
    """World direction of the brightest texel of an envmap, by Mitsuba's formulas."""
    pixels = emitter["bitmap"].linear().sum(axis=2)
    row, column = np.unravel_index(pixels.argmax(), pixels.shape)
    theta = math.pi * row / (len(pixels) - 1)
    azimuth = 2 * math.pi * (column + 0.5) / pixels.shape[1]
    local = [math.sin(theta) * math.sin(azimuth), math.cos(theta), -math.sin(theta) * math.cos(azimuth)]
    return emitter["to_world"][:3, :3] @ local


def test_environment_maps_turn_with_the_light(tmp_path):
    square = np.full((32, 32, 3), 0.25)
    square[5, 20] = 100
    write_image(tmp_path / "map.exr", square)
    expected = equal_area_directions(32)[5, 20]
    text = 'LightSource "infinite" "string filename" "map.exr" "float scale" 2'
    made = light(tmp_path, text, "envmap")
    assert bright_direction(made) @ expected > 0.99
    mean = build_environment_map(made["bitmap"], np.eye(4), 1.0, "map").mean
    assert mean == pytest.approx(2 * square.mean(axis=(0, 1)), rel=0.01)
    turned = light(tmp_path, "Rotate 90 0 0 1 Scale -2 2 2 " + text, "envmap")
    x, y, z = expected
    assert bright_direction(turned) @ [-y, -x, z] > 0.99


def test_maps_of_pbrt_v3_are_in_latitude_and_longitude(tmp_path):
    image = np.full((16, 32, 3), 0.25)
    image[4, 9] = 100
    write_image(tmp_path / "map.exr", image)
    theta, phi = math.pi * 4.5 / 16, 2 * math.pi * 9.5 / 32
    expected = [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]  # pbrt-v3: z up
    made = light(tmp_path, 'LightSource "infinite" "string mapname" "map.exr" "rgb L" [1 1 1]', "envmap")
    assert bright_direction(made) @ expected > 0.99


def test_constant_environments_and_illuminance(tmp_path):
    made = light(tmp_path, 'LightSource "infinite" "rgb L" [1 2 3] "float illuminance" 2', "constant")
    assert value(made["radiance"]) == pytest.approx(np.array([1, 2, 3]) * 2 / math.pi)
    write_image(tmp_path / "map.exr", np.ones((24, 24, 3)))
    text = 'LightSource "infinite" "string filename" "map.exr" "float illuminance" 2'
    made = light(tmp_path, text, "envmap")
    # pbrt-v4 sums the upper half and multiplies by 2 pi over all texels: pi / 2 for radiance 1
    assert made["bitmap"].pixels.mean() == pytest.approx(2 / (math.pi / 2), rel=0.01)


def test_several_environments_are_added(tmp_path):
    write_image(tmp_path / "map.exr", np.full((8, 8, 3), 0.5))
    constants = 'LightSource "infinite" "rgb L" [1 2 3] LightSource "infinite" "rgb L" [1 1 1]'
    assert value(light(tmp_path, constants, "constant")["radiance"]).tolist() == [2, 3, 4]
    image = ' LightSource "infinite" "string filename" "map.exr"'
    made = light(tmp_path, constants + image, "envmap")
    assert made["bitmap"].pixels[0, 0] == pytest.approx([2.5, 3.5, 4.5])
    _, report = read_world(tmp_path, image + image)
    assert "only the last one is used" in report.warnings()[0]


def test_what_has_no_equal_is_reported(tmp_path):
    world = """
    LightSource "infinite" LightSource "infinite" "point3 portal" [0 0 0 1 0 0 1 1 0 0 1 0]
    LightSource "goniometric"
    """
    scene, report = read_world(tmp_path, world)
    assert len(objects(scene, "point")) == 1
    assert len(objects(scene, "constant")) == 1
    assert "the portal" in " ".join(report.warnings())
