"""Pictures of heterogeneous media against Mitsuba 3."""

import numpy as np
import pytest
from grid_reference import grid, ramp
from media_scenes import NULL, look_at, rgb, transform
from scalar_mitsuba import assert_same_picture
from test_media_pictures import BLUE_SKY, CAMERA, GLASS, GROUND, LAMPS, MIST, SUN, ball

from isonoise.scene.volume.grid_file import VolumeGrid, write_vol

TURN = look_at((0, 0, 0), (0.6, 0.3, 1.0))
IN_BALL = TURN @ transform(-0.6, -0.6, -0.6, scale=1.2)


def clouds(size: int = 12, channels: int = 1, power: float = 3.0, seed: int = 1) -> np.ndarray:
    """Returns a grid of blobs: noise with empty cells between."""
    values = np.random.default_rng(seed).random((size, size - 2, size + 3, channels))
    return np.maximum(values - 0.2, 0).astype(np.float32) ** power


def smoke(sigma_t, albedo=0.8, g: float | None = 0.4, **more) -> dict:
    phase = {} if g is None else {"phase": {"type": "hg", "g": g}}
    return {"type": "heterogeneous", "sigma_t": sigma_t, "albedo": albedo, **phase, **more}


SMOKE = smoke(grid(clouds(), IN_BALL), scale=12.0)
COLOURS = smoke(
    grid(clouds(channels=3), IN_BALL, wrap_mode="mirror"),
    grid(clouds(5, 3, 0.5, seed=2), transform(scale=0.7), wrap_mode="repeat", filter_type="nearest"),
    scale=15.0,
)
PICTURES = {  # depth, objects
    "smoke": (8, {**LAMPS, "sky": BLUE_SKY, "ball": ball(interior=SMOKE)}),
    "colours": (8, {**LAMPS, "sky": BLUE_SKY, "ball": ball(1.4, interior=COLOURS)}),
    "no emitter sampling": (6, {"sky": BLUE_SKY, "ball": ball(interior=SMOKE | {"sample_emitters": False})}),
    "smoke in glass": (10, {"sky": BLUE_SKY, "ball": ball(bsdf=GLASS, interior=SMOKE)}),
    "smoke and mist": (6, {**LAMPS, "mist": ball(1.2, interior=MIST), "ball": ball(interior=SMOKE, exterior=MIST)}),
    "camera in smoke": (
        6,
        {**LAMPS, "sun": SUN, "sensor": CAMERA | {"medium": SMOKE | {"scale": 3.0}}, "ball": ball(9.0, interior=SMOKE)},
    ),
    "the unit cube": (6, {**LAMPS, "ball": ball(1.5, interior=smoke({"type": "constvolume", "value": rgb(1, 2, 4)}))}),
    "a slope": (6, {"sun": SUN, "ball": ball(interior=smoke(grid(ramp(0, 3), IN_BALL, filter_type="nearest"), 0.9))}),
    "instances": (
        6,
        {
            **LAMPS,
            "group": {"type": "shapegroup", "shape": ball(interior=SMOKE)},
            **{
                f"instance_{i}": {
                    "type": "instance",
                    "to_world": transform(x, scale=0.6),
                    "shape": {"type": "ref", "id": "group"},
                }
                for i, x in enumerate((-0.5, 0.7))
            },
        },
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_mitsubas(name, tmp_path):
    depth, objects = PICTURES[name]
    integrator = {"type": "volpath", "max_depth": depth, "rr_depth": 5}
    scene = {"type": "scene", "integrator": integrator, "sensor": CAMERA, "ground": GROUND, **objects}
    assert_same_picture(scene, tmp_path, spp=1024)


@pytest.mark.long
def test_a_picture_of_a_file_is_mitsubas(tmp_path):
    """The file's box, and a shape that is smaller than the volume."""
    write_vol(tmp_path / "a.vol", VolumeGrid(clouds(channels=3), np.array([[-1.0, -0.8, -1.2], [0.9, 1.1, 0.8]])))
    volume = {"type": "gridvolume", "filename": str(tmp_path / "a.vol"), "use_grid_bbox": True}
    cube = {"type": "cube", "to_world": TURN @ transform(scale=0.7), "bsdf": NULL, "interior": smoke(volume, scale=9.0)}
    integrator = {"type": "volpath", "max_depth": 6, "rr_depth": 5}
    scene = {"type": "scene", "integrator": integrator, "sensor": CAMERA, "ground": GROUND, **LAMPS, "cube": cube}
    assert_same_picture(scene, tmp_path, spp=1024)
