"""pbrt scenes of Benedikt Bitterli against his own images, made by another renderer, Tungsten: image means.

Tungsten is not pbrt: depths are counted in another way, and a coat absorbs nothing. Each test says what it changes.
Standard errors of our means are below 0.5 %; tolerances are 2 % and 4 %.
"""

from pathlib import Path

import numpy as np
import pytest

import isonoise
from isonoise.film.exr import read_exr

pytestmark = pytest.mark.long
SIZE, BATCHES = 128, 8


def read_image(path: Path) -> np.ndarray:
    channels, _ = read_exr(path)
    return np.stack([channels[c] for c in "RGB"], axis=-1, dtype=np.float64)


def render_batches(scene, spp: int, size: tuple[int, int]) -> np.ndarray:
    """Images (BATCHES, height, width, 3) of independent seeds."""
    images = [isonoise.render(scene, spp=spp, size=size, strategy="uniform", seed=seed).rgb for seed in range(BATCHES)]
    return np.array(images, np.float64)


def assert_means_agree(batches: np.ndarray, reference: np.ndarray, tolerance: float) -> None:
    """The means over the image and over the channels agree, and the noise of ours is small."""
    means = batches.mean(axis=(1, 2))  # (BATCHES, 3)
    standard_error = means.std(axis=0, ddof=1) / BATCHES**0.5
    expected = reference.mean(axis=(0, 1))
    assert (standard_error < 0.01 * expected).all()
    assert means.mean() == pytest.approx(expected.mean(), rel=tolerance)
    assert means.mean(axis=0) == pytest.approx(expected, rel=2 * tolerance)


def test_cornell_box(public_scenes):
    """With the depth of the published file, 65: the copy beside the image was cut to 4 bounces."""
    folder = public_scenes / "pbrt-cornell-box" / "pbrt"
    scene = isonoise.load(folder / "scene-v4.pbrt")
    scene["integrator"]["max_depth"] = 66
    batches = render_batches(scene, 32, (SIZE, SIZE))
    assert_means_agree(batches, read_image(folder / "TungstenRender.exr"), 0.02)


def test_coffee(public_scenes):
    """As the file is. pbrt's coats absorb about 2 % on the way in and out, Tungsten's do not."""
    folder = public_scenes / "pbrt-coffee" / "pbrt"
    batches = render_batches(isonoise.load(folder / "scene-v4.pbrt"), 32, (SIZE, SIZE * 5 // 4))
    assert_means_agree(batches, read_image(folder / "TungstenRender.exr"), 0.04)


WIDENING = 8
"""Factor on the sides of the light of 5 x 4 mm, whose radiance is divided by its square.

Otherwise a path through the glass sphere hits the light once in some millions, and the mean is noise. The light stays
small against its distance of 0.5 from the sphere.
"""


def test_volumetric_caustic(public_scenes, tmp_path):
    """Tungsten counts the front of the box, where the gas begins, as a bounce, and ends after six: five edges for us.

    In its image the pixels of the light itself have lost most of their light: sums of 16-bit floats stopped growing at
    powers of two. So that part of the image is left out.
    """
    folder = public_scenes / "pbrt-volumetric-caustic" / "pbrt"
    reference = read_image(folder / "TungstenRender.exr")
    light = reference[96, 509] / reference[96, 509].max()
    assert reference[96, 509] == pytest.approx([4096, 2048, 1024], rel=0.02)
    assert light[1] < 0.9 * 381971.8 / 541126.75  # not the light's colour
    text = (folder / "scene-v4.pbrt").read_text()
    before, after = text.split("AreaLightSource")
    radiance = "541126.75 381971.8 127323.94"
    assert radiance in after
    after = after.replace(radiance, " ".join(str(float(word) / WIDENING**2) for word in radiance.split()))
    x, z = (0.0025 * WIDENING, 0.002 * WIDENING)
    corners = ((x, z), (-x, z), (-x, -z), (x, -z))
    points = " ".join(f"{corner[0] - 0.005} 1.98 {corner[1] - 0.03}" for corner in corners)
    head, tail = after.split('"point3 P" [')
    after = f'{head}"point3 P" [ {points} ]{tail.partition("]")[2]}'
    path = tmp_path / "scene.pbrt"
    path.write_text(f"{before}AreaLightSource{after}")
    scene = isonoise.load(path)
    scene["integrator"]["max_depth"] = 5
    batches = render_batches(scene, 256, (SIZE, SIZE))
    factor = len(reference) // SIZE
    pixels = reference.reshape(SIZE, factor, SIZE, factor, 3).mean(axis=(1, 3))
    rows, columns = slice(4, 20), slice(50, 76)  # around the light
    is_compared = np.ones((SIZE, SIZE), bool)
    is_compared[rows, columns] = False
    assert_means_agree(batches[:, is_compared][:, None], pixels[is_compared][None], 0.02)
