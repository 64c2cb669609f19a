"""Windows of an image: --crop, crop windows of films, and several cameras."""

import json

import numpy as np
import OpenEXR
import pytest
from small_scene import lamp_over_floor

import isonoise
from isonoise import cli
from isonoise.errors import UserError
from isonoise.film.exr import read_exr
from isonoise.scene.scene import load

SIZE = (40, 30)
LEFT, TOP, WIDTH, HEIGHT = WINDOW = (7, 5, 13, 9)
INSIDE = np.s_[TOP : TOP + HEIGHT, LEFT : LEFT + WIDTH]


def statistics(scene, **options):
    with isonoise.Renderer(scene, strategy="uniform", seed=3, **options) as renderer:
        renderer.step()
        return renderer.statistics()


@pytest.mark.parametrize("sampler", ["sobol", pytest.param("independent", marks=pytest.mark.long)])
def test_pixels_of_a_window_are_those_of_the_whole_image(one_lane, sampler):
    """Bit by bit, whether the window comes from the view or from the film."""
    whole = statistics(lamp_over_floor(), size=SIZE, sampler=sampler)
    part = statistics(lamp_over_floor(), size=SIZE, sampler=sampler, view=isonoise.View(crop=WINDOW))
    scene = load(lamp_over_floor())
    scene["film.size"] = SIZE
    scene["film.crop"] = WINDOW
    assert (scene["film.crop_offset_x"], scene["film.crop_width"], scene["film.crop"]) == (LEFT, WIDTH, WINDOW)
    of_film = statistics(scene, sampler=sampler)
    assert whole.rgb[INSIDE].any()
    for name in ("rgb", "count", "variance"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[INSIDE])
        np.testing.assert_array_equal(getattr(of_film, name), getattr(whole, name)[INSIDE])


def test_the_command(tmp_path, capsys, one_lane):
    """The file has the data window and the display window that Mitsuba writes."""
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="perspective" id="a"/>'
        '<sensor type="orthographic" id="b"/><emitter type="constant"/></scene>'
    )
    image = tmp_path / "a.exr"
    options = ["--size", "40x30", "--crop", "7,5,13x9", "--sensor", "1", "--spp", "1", "--json"]
    assert cli.main(["render", str(scene), "-o", str(image), *options]) == 0
    header = OpenEXR.File(str(image), header_only=True).header()
    assert np.array(header["dataWindow"]).tolist() == [[7, 5], [19, 13]]
    assert np.array(header["displayWindow"]).tolist() == [[0, 0], [39, 29]]
    channels, _ = read_exr(image)
    assert channels["samples"].shape == (HEIGHT, WIDTH)
    capsys.readouterr()
    assert cli.main(["info", str(image), "--json"]) == 0
    assert "13" in json.dumps(json.loads(capsys.readouterr().out))


@pytest.mark.parametrize("crop", [(0, 0, 0, 3), (-1, 0, 2, 3), (0, 0, 2), "1,2,3x4", (0.5, 0, 2, 3)])
def test_a_window_is_four_whole_numbers(crop):
    with pytest.raises(UserError, match=r"is not a window: give \(left, top, width, height\) in whole pixels"):
        isonoise.View(crop=crop)


@pytest.mark.parametrize("crop", [(256, 0, 1, 1), (0, 200, 1, 57)])
def test_a_window_is_inside_the_image(crop):
    with pytest.raises(UserError, match="extends beyond the image of 256x256 pixels"):
        load("cornell", view=isonoise.View(crop=crop))


@pytest.mark.parametrize("text", ["1,2,3", "1,2,3x0", "a,2,3x4", "1,2,-3x4"])
def test_errors_of_the_option(text, capsys):
    with pytest.raises(SystemExit):
        cli.main(["render", "cornell", "-o", "a.exr", "--crop", text])
    assert "--crop" in capsys.readouterr().err


def test_a_window_of_a_model(write_file):
    """The whole image is framed; the window is cut out of it."""
    model = write_file("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    whole = load(model, size=SIZE)
    part = load(model, size=SIZE, view=isonoise.View(crop=WINDOW))
    np.testing.assert_array_equal(part["sensor.to_world"], whole["sensor.to_world"])
    assert part.compile().film_window == (SIZE, (LEFT, TOP), (WIDTH, HEIGHT))


def test_cameras_are_chosen_by_number_and_id(tmp_path):
    cameras = {name: {"type": "perspective", "fov": fov} for name, fov in (("left", 20.0), ("right", 30.0))}
    scene = load({"type": "scene", **cameras, "light": {"type": "constant"}})
    assert scene.cameras == ("left", "right")
    assert scene["sensor.fov"] == 20
    assert load(scene, view=isonoise.View(camera="right"))["sensor.fov"] == 30
    angles = [
        scene.compile(view=isonoise.View(camera=camera)).camera["tan_half_fov"][0, 0] for camera in (0, 1, "right")
    ]
    np.testing.assert_allclose(angles, np.tan(np.radians([10, 15, 15])), rtol=1e-6)
    with pytest.raises(UserError, match="there is no camera 'middle'; the scene has: 0 'left', 1 'right'"):
        scene.compile(view=isonoise.View(camera="middle"))
