"""Compares images with those of another renderer, or of another method: estimates, standard scores, tests.

An image is an `Estimate`: a mean and its standard error for every value. Two estimates of the same image are compared
value by value (`assert_agree`) and by their image means (`assert_means_agree`).

A value passes if the difference is not larger than chance allows at 1 % for the whole image (Sidak: 5.3 standard errors
for 65,536 values). This detects local errors: a missing surface, a light on the wrong side, a shifted edge. It does not
detect a bias below the noise of single pixels, and hardly any fireflies: one outlier of size v among n samples changes
the mean by v/n and the standard error by as much, so no outlier is much more than one standard error off. Therefore the
means of 8x8 blocks are compared, too (an eighth of the noise, and 64 times the samples for rare paths), and the image
means, which a wrong weight of any kind of path changes.
"""

import hashlib
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

import numpy as np

import isonoise
from isonoise.film.exr import read_exr, write_exr
from isonoise.luminance import luminance
from isonoise.statistics import Statistics

ROUNDING = 1e-4
"""Relative difference that may be rounding: a float32 sum of 1,024 equal samples has an error of up to
1024 * 2^-24 = 6e-5. It matters in pixels without noise, where both standard errors are 0."""


@dataclass(frozen=True)
class Estimate:
    """Mean, standard error and degrees of freedom of the standard error, per value: float64 (height, width, channels).

    `dof` may be one number for all values.
    """

    mean: np.ndarray
    se: np.ndarray
    dof: float | np.ndarray

    def blocks(self, size: int) -> "Estimate":
        """Means of size x size blocks; the standard error assumes that the pixels are independent."""
        return Estimate(block_means(self.mean, size), np.sqrt(block_means(self.se**2, size)) / size, self.dof)


def block_means(image: np.ndarray, size: int) -> np.ndarray:
    """Means of size x size blocks of (..., height, width, channels); incomplete blocks are left out."""
    *batches, height, width, channels = image.shape
    rows, columns = height // size, width // size
    cropped = image[..., : rows * size, : columns * size, :]
    return cropped.reshape(*batches, rows, size, columns, size, channels).mean(axis=(-4, -2))


def from_batches(batches: np.ndarray) -> Estimate:
    """Estimate from independent images of equal sample counts, (batches, height, width, channels)."""
    count = len(batches)
    batches = np.asarray(batches, dtype=np.float64)
    return Estimate(batches.mean(axis=0), batches.std(axis=0, ddof=1) / np.sqrt(count), count - 1)


def wave_batches(scene, spp: int, batches: int, seed: int = 0, allow_outside: bool = False) -> np.ndarray:
    """Independent images of a scene, (batches, height, width, 3) float64, with a seed each. No sample may be rejected.

    Waves of one render would not do: samples of `sobol` complement each other. Programs are built for small pools only:
    PoCL compiles again for 2^16 paths and more.
    """
    images = []
    for batch in range(batches):
        options = {"strategy": f"uniform:wave_spp={spp}", "seed": seed * batches + batch, "pool_size": 1 << 15}
        renderer = isonoise.Renderer(scene, allow_outside=allow_outside, **options)
        renderer.step()
        statistics = renderer.statistics()
        assert (statistics.count == spp).all()
        assert not statistics.rejected.any(), f"{statistics.rejected.sum()} samples are no numbers"
        images.append(statistics.rgb.astype(np.float64))
    return np.stack(images)


def from_statistics(statistics: list[Statistics]) -> Estimate:
    """Estimate of the luminance from renders with equal counts and different seeds, using their sample variances."""
    mean = np.mean([s.mean for s in statistics], axis=0)
    squared = np.mean([s.variance_of_mean() for s in statistics], axis=0) / len(statistics)
    dof = sum(s.count.astype(np.float64) - 1 for s in statistics)
    return Estimate(mean[..., None], np.sqrt(squared)[..., None], dof[..., None])


def read_reference(path: Path) -> Estimate:
    """A reference file: channels R G B with stderr.R stderr.G stderr.B, and the number of batches in its header."""
    channels, header = read_exr(path)
    mean, se = (
        np.stack([channels[prefix + c] for c in "RGB"], axis=-1, dtype=np.float64) for prefix in ("", "stderr.")
    )
    return Estimate(mean, se, int(header["batches"]) - 1)


def luminance_of(rgb: Estimate) -> Estimate:
    """Luminance of an RGB estimate.

    The errors of the channels are assumed to be fully correlated: an upper bound, and nearly exact if all channels come
    from the same paths.
    """
    return Estimate(luminance(rgb.mean)[..., None], luminance(rgb.se)[..., None], rgb.dof)


def standard_scores(image: Estimate, reference: Estimate, rounding: float = ROUNDING) -> np.ndarray:
    """Differences over their standard error, as standard normal deviates; 0 for relative differences up to `rounding`.

    The degrees of freedom are those of Welch and Satterthwaite. Student's t is converted to a normal deviate by
    D. L. Wallace, "Bounds on normal approximations to Student's and the chi-square distributions" (Annals of
    Mathematical Statistics 30, 1959), good to 1 % in the tails used here (15 degrees of freedom and more).
    """
    squared_image, squared_reference = image.se**2, reference.se**2
    squared = squared_image + squared_reference
    difference = image.mean - reference.mean
    difference[np.abs(difference) <= rounding * np.abs(reference.mean)] = 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = squared**2 / (squared_image**2 / image.dof + squared_reference**2 / reference.dof)
        t = difference / np.sqrt(squared)
    score = np.sign(t) * np.sqrt(dof * np.log1p(t**2 / dof)) * (8 * dof + 1) / (8 * dof + 3)
    return np.where(squared > 0, score, np.where(difference == 0, 0.0, np.copysign(np.inf, difference)))


def assert_agree(
    image: Estimate,
    reference: Estimate,
    folder: Path,
    share: float = 0.9975,
    alpha: float = 0.01,
    rounding: float = ROUNDING,
) -> np.ndarray:
    """Assert that at least `share` of the values agree; returns the standard scores.

    The threshold is Sidak's: all values together fail by chance with probability `alpha`. The share is Mitsuba 3's
    (src/render/tests/test_renders.py): it allows for edge pixels that two renderers round to different sides, and makes
    the false-alarm rate far smaller than `alpha`. On failure image, reference and scores are written to `folder` and
    named in the message.
    """
    assert image.mean.shape == reference.mean.shape
    assert np.isfinite(image.mean).all()
    scores = standard_scores(image, reference, rounding)
    threshold = NormalDist().inv_cdf(1 - (1 - (1 - alpha) ** (1 / scores.size)) / 2)
    passed = np.abs(scores) <= threshold
    if passed.mean() < share:
        row, column, _ = np.unravel_index(np.argmax(np.abs(scores)), scores.shape)
        raise AssertionError(
            f"{passed.mean():.4%} of the values are within {threshold:.2f} standard errors, {share:.2%} wanted; the "
            f"worst is at column {column}, row {row}: {image.mean[row, column]} for {reference.mean[row, column]}. "
            f"See {', '.join(map(str, _write_failure(folder, image, reference, scores)))}"
        )
    return scores


def assert_means_agree(image: Estimate, reference: Estimate, relative: float = 0.003, errors: float = 3.0) -> None:
    """Assert that the image mean of every channel agrees within 0.3 % or three standard errors, whichever is larger.

    Pixels are independent, so their squared errors add up. If three standard errors are the larger bound, a correct
    program fails with probability 0.0027 per channel, by the normal distribution.
    """
    means, squared = [], 0.0
    for estimate in (image, reference):
        pixels = estimate.mean.shape[0] * estimate.mean.shape[1]
        means.append(estimate.mean.mean(axis=(0, 1)))
        squared = squared + (estimate.se**2).sum(axis=(0, 1)) / pixels**2
    tolerance = np.maximum(relative * means[1], errors * np.sqrt(squared))
    assert (np.abs(means[0] - means[1]) <= tolerance).all(), (
        f"image means {means[0]} for {means[1]}, ratio {means[0] / means[1]}, tolerance {tolerance / means[1]}"
    )


def _write_failure(folder: Path, image: Estimate, reference: Estimate, scores: np.ndarray) -> list[Path]:
    """Write both images and the scores as EXR, and the scores as PNG (white: 6 standard errors too bright)."""
    from PIL import Image

    finite = np.nan_to_num(np.broadcast_to(scores, (*scores.shape[:2], 3)), posinf=1e3, neginf=-1e3)
    images = {"image": image.mean, "reference": reference.mean, "scores": finite}
    paths = []
    for name, pixels in images.items():
        paths.append(folder / f"{name}.exr")
        write_exr(paths[-1], {"": np.broadcast_to(pixels, finite.shape).astype(np.float32)}, {})
    paths.append(folder / "scores.png")
    Image.fromarray((255 * np.clip(finite / 12 + 0.5, 0, 1)).astype(np.uint8)).save(paths[-1])
    return paths


def resized(scene: Path, side: int, folder: Path) -> Path:
    """A copy of an XML scene whose film is side x side pixels."""
    tree = ElementTree.parse(scene)
    for name in ("width", "height"):
        tree.find(f"./sensor/film/integer[@name='{name}']").set("value", str(side))
    path = folder / f"{scene.stem}-{side}.xml"
    tree.write(path)
    return path


def cache_folder(cache) -> Path | None:
    """Persistent folder: ISONOISE_REFERENCE_CACHE, else one in pytest's cache; None if that is disabled."""
    if folder := os.environ.get("ISONOISE_REFERENCE_CACHE"):
        return Path(folder)
    return Path(cache.mkdir("mitsuba")) if cache else None


def mitsuba_batches(
    scene: Path,
    spp: int,
    batches: int,
    folder: Path,
    variants: Sequence[str] = ("llvm_ad_rgb", "scalar_rgb"),
    files: Iterable[Path] = (),
) -> np.ndarray:
    """Images of a scene file by Mitsuba 3, (batches, height, width, 3) float32, each with its own seed.

    The first variant that works renders them: llvm_ad_rgb needs libLLVM, scalar_rgb is several times slower. They are
    cached in `folder` under a hash of scene, `files` (those that the scene refers to), version and counts. Mitsuba runs
    in its own process: an unsuitable libLLVM aborts the process, and OpenCL drivers load an LLVM of their own.
    """
    import mitsuba

    digest = hashlib.sha256(scene.read_bytes() + f"{mitsuba.__version__} {spp} {batches}".encode())
    for file in sorted(files):
        digest.update(file.name.encode() + file.read_bytes())
    path = folder / f"{scene.stem}-{digest.hexdigest()[:16]}.npy"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npy")
        command = [sys.executable, __file__, str(scene), str(part), str(spp), str(batches)]
        for variant in variants:
            run = subprocess.run([*command, variant], capture_output=True, text=True)
            if run.returncode == 0:
                break
        else:
            raise RuntimeError(f"Mitsuba cannot render {scene}: {run.stderr}")
        part.replace(path)
    return np.load(path)


def _mitsuba_main(scene: str, output: str, spp: str, batches: str, variant: str) -> None:
    import mitsuba

    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    loaded = mitsuba.load_file(scene, optimize=False)  # merging meshes fails for some scenes (3.9.1)
    images = [np.array(mitsuba.render(loaded, spp=int(spp), seed=seed)) for seed in range(int(batches))]
    np.save(output, np.stack(images)[..., :3].astype(np.float32))


if __name__ == "__main__":
    _mitsuba_main(*sys.argv[1:])
