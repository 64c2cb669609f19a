"""Pictures of media and pass-through surfaces against Mitsuba 3."""

import numpy as np
import pytest
import references
from media_scenes import HALF, LAMBERT, NULL, OUT_OF_SIGHT, look_at, medium, rgb, transform
from scalar_mitsuba import assert_same_picture

import isonoise

PICTURE = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
CAMERA = {"type": "perspective", "fov": 40.0, "to_world": look_at((0.0, 1.0, 5.0), (0, 0, 0)), "film": PICTURE}
TILT = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
GROUND = {"type": "rectangle", "to_world": transform(y=-1.2) @ TILT @ transform(scale=4.0), "bsdf": LAMBERT}
LAMP = {
    "type": "rectangle",
    "to_world": transform(y=2.5) @ np.linalg.inv(TILT) @ transform(scale=0.7),
    "emitter": {"type": "area", "radiance": rgb(9.0, 8.0, 6.0)},
}
LAMPS = {"point": {"type": "point", "position": [1.5, 2.0, 1.0], "intensity": 8.0}, "lamp": LAMP}
SUN = {"type": "directional", "direction": [0.3, -1.0, -0.4], "irradiance": 2.0}
BLUE_SKY = {"type": "constant", "radiance": rgb(0.5, 0.7, 1.0)}
TINTED = medium(rgb(0.2, 0.6, 1.0), rgb(0.9, 0.5, 0.2), 0.5, scale=2.0)
MIST = medium(0.5, 0.9, 0.4)


def ball(radius: float = 1.0, **more) -> dict:
    return {"type": "sphere", "radius": radius, "bsdf": NULL, **more}


GLASS = {"type": "dielectric", "int_ior": 1.5}
PICTURES = {  # depth, objects
    "tinted fog": (6, {**LAMPS, "ball": ball(interior=TINTED)}),
    "glass with fog": (10, {"sky": BLUE_SKY, "ball": ball(bsdf=GLASS, interior=TINTED)}),
    "glass with fog, lights unsampled": (
        8,
        {"sky": BLUE_SKY, "ball": ball(bsdf=GLASS, interior=TINTED | {"sample_emitters": False})},
    ),
    "fog cube, sun and sky": (
        6,
        {
            "sun": SUN,
            "sky": BLUE_SKY,
            "cube": {"type": "cube", "to_world": transform(scale=(0.8, 0.5, 0.9)), "bsdf": NULL, "interior": TINTED},
        },
    ),
    "balls within one another": (
        6,
        {**LAMPS, "mist": ball(1.2, interior=MIST), "ball": ball(0.5, interior=TINTED, exterior=MIST)},
    ),
    "its outside not named": (6, {**LAMPS, "mist": ball(1.2, interior=MIST), "ball": ball(0.5, interior=TINTED)}),
    "glass in mist": (
        8,
        {**LAMPS, "mist": ball(1.3, interior=MIST), "ball": ball(0.5, bsdf=GLASS, exterior=MIST)},
    ),
    "a lamp in fog": (
        6,
        {
            "ball": ball(interior=MIST),
            "lamp": {"type": "sphere", "radius": 0.3, "exterior": MIST, "emitter": {"type": "area", "radiance": 6.0}},
        },
    ),
    "camera in fog": (6, {**LAMPS, "sensor": CAMERA | {"medium": MIST}, "ball": ball(8.0, interior=MIST)}),
    "fog without end": (6, {"sun": SUN, "sensor": CAMERA | {"medium": medium(0.2, 0.8)}}),
    "mask before lamps": (
        6,
        {**LAMPS, "mask": {"type": "disk", "to_world": transform(y=1.5) @ TILT, "bsdf": HALF}},
    ),
    "panes": (
        8,
        {
            **LAMPS,
            "sky": BLUE_SKY,
            "pane": ball(bsdf=OUT_OF_SIGHT["pane"] | {"specular_transmittance": rgb(0.9, 0.5, 0.3)}, interior=MIST),
        },
    ),
    "lights hidden": (5, {**LAMPS, "sky": BLUE_SKY, "ball": ball(interior=MIST)}),
}
QUICK = ("tinted fog",)


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in PICTURES]
)
def test_pictures_are_mitsubas(name, tmp_path):
    depth, objects = PICTURES[name]
    hidden = name == "lights hidden"
    integrator = {"type": "volpath", "max_depth": depth, "rr_depth": 5, "hide_emitters": hidden}
    scene = {"type": "scene", "integrator": integrator, "sensor": CAMERA, "ground": GROUND, **objects}
    assert_same_picture(scene, tmp_path, spp=64 if name in QUICK else 2048)


@pytest.mark.long
@pytest.mark.parametrize("name", ["test_homo_null_envmap", "test_homo_area_light"])
def test_mitsubas_own_scenes_of_media(public_scenes, name, tmp_path):
    """Against the mean images of Mitsuba's tests. As there, their own error is ignored: by the stored variances it is
    that of some 10,000 samples."""
    from isonoise.film.exr import read_exr

    folder = public_scenes / "mitsuba-tests" / "tests" / "scenes" / "participating_media"
    mean = read_exr(folder / "refs" / f"{name}_ref_rgb.exr")[0]
    theirs = np.stack([mean[c] for c in "RGB"], axis=-1).astype(float)
    batches = [
        isonoise.render(
            folder / f"{name}_volpath.xml", spp=64, strategy="uniform", seed=seed, allow_outside=True
        ).statistics.rgb
        for seed in range(16)
    ]
    references.assert_agree(
        references.from_batches(np.stack(batches)), references.Estimate(theirs, 0 * theirs, 1e6), tmp_path
    )
