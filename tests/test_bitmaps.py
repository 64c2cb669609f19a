"""Textures that readers of formats make from images: factors, channels, alpha, cutoffs, wrap modes, normal maps.

Textures are compared with the operation on interpolated values, in float64.
"""

import io

import numpy as np
import PIL.Image
import pytest

from isonoise.errors import SceneError
from isonoise.scene.formats.bitmaps import BILINEAR, CLAMP, MIRROR, NEAREST, REPEAT, Bitmaps, Sampling
from isonoise.scene.image.image import Image, decode_image, read_image
from isonoise.scene.spectra import srgb_to_linear

RNG = np.random.default_rng(20)
COLOURS = RNG.integers(0, 256, (4, 6, 3), np.uint8)
ALPHA = RNG.integers(0, 256, (4, 6, 1), np.uint8)
IMAGE = Image(COLOURS, ALPHA)
UVS = RNG.uniform(-1.4, 2.4, (2000, 2))


def wrapped(index: np.ndarray, size: int, wrap: str) -> np.ndarray:
    """Texel indices of glTF's wrap modes."""
    if wrap == CLAMP:
        return np.clip(index, 0, size - 1)
    if wrap == REPEAT:
        return index % size
    index = index % (2 * size)
    return np.where(index >= size, 2 * size - 1 - index, index)


def sample(values: np.ndarray, uvs: np.ndarray, wrap_u: str, wrap_v: str, filter_type: str = BILINEAR) -> np.ndarray:
    """The values (height, width, channels) at texture coordinates (n, 2)."""
    height, width, _ = values.shape
    texels = uvs * (width, height) - (0.5 if filter_type == BILINEAR else 0.0)
    first = np.floor(texels).astype(int)
    weights = (texels - first if filter_type == BILINEAR else np.zeros_like(texels))[..., None]
    result = 0.0
    for dx in (0, 1):
        for dy in (0, 1):
            share = (weights[:, 0] if dx else 1 - weights[:, 0]) * (weights[:, 1] if dy else 1 - weights[:, 1])
            columns, rows = wrapped(first[:, 0] + dx, width, wrap_u), wrapped(first[:, 1] + dy, height, wrap_v)
            result = result + share * values[rows, columns]
    return result


def sample_texture(texture: dict, uvs: np.ndarray) -> np.ndarray:
    """A `bitmap` as Mitsuba 3 reads it."""
    to_uv = texture.get("to_uv", np.eye(4))
    mapped = uvs @ to_uv[:2, :2].T + to_uv[:2, 3]
    values = texture["bitmap"].linear(texture["raw"]).astype(np.float64)
    return sample(values, mapped, texture["wrap_mode"], texture["wrap_mode"], texture["filter_type"])


def png(pixels: np.ndarray, **options) -> bytes:
    file = io.BytesIO()
    PIL.Image.fromarray(pixels.squeeze()).save(file, "PNG", **options)
    return file.getvalue()


def test_alpha_of_decoded_images(tmp_path):
    rgba = png(np.concatenate([COLOURS, ALPHA], axis=2))
    image = decode_image(rgba, "an image", with_alpha=True)
    np.testing.assert_array_equal(image.pixels, COLOURS)
    np.testing.assert_array_equal(image.alpha, ALPHA)
    assert decode_image(rgba, "an image").alpha is None
    opaque = np.concatenate([COLOURS, np.full_like(ALPHA, 255)], axis=2)
    assert decode_image(png(opaque), "an image", with_alpha=True).alpha is None
    (tmp_path / "a.png").write_bytes(png(np.concatenate([COLOURS[..., :1], ALPHA], axis=2)))
    grey = read_image(tmp_path / "a.png", with_alpha=True)
    np.testing.assert_array_equal(grey.pixels, COLOURS[..., :1])
    np.testing.assert_array_equal(grey.alpha, ALPHA)
    palette = PIL.Image.fromarray(np.array([[0, 1]], np.uint8), "P")
    palette.putpalette([255, 0, 0, 0, 0, 255])
    file = io.BytesIO()
    palette.save(file, "PNG", transparency=bytes([10, 200]))
    image = decode_image(file.getvalue(), "an image", with_alpha=True)
    assert image.pixels.tolist() == [[[255, 0, 0], [0, 0, 255]]]
    assert image.alpha.ravel().tolist() == [10, 200]


def test_alpha_of_16_bits(tmp_path):
    import struct
    import zlib

    rgba = RNG.integers(0, 1 << 16, (3, 5, 4), np.uint16)
    header = struct.pack(">IIBBBBB", 5, 3, 16, 6, 0, 0, 0)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in rgba)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )
    image = decode_image(data, "an image", with_alpha=True)
    np.testing.assert_array_equal(np.concatenate([image.pixels, image.alpha], axis=2), rgba)


def test_undecodable_bytes():
    with pytest.raises(SceneError, match=r"an image: .*not a supported image"):
        decode_image(b"nothing", "an image")


def test_equal_operations_return_the_same_object():
    bitmaps = Bitmaps()
    assert bitmaps.scaled(IMAGE, 1.0) is IMAGE
    assert bitmaps.scaled(IMAGE, (1, 1, 1)) is IMAGE
    assert bitmaps.scaled(IMAGE, 0.5) is bitmaps.scaled(IMAGE, 0.5)
    assert bitmaps.scaled(IMAGE, 0.5) is not bitmaps.scaled(IMAGE, 0.25)
    assert bitmaps.texture(IMAGE) is bitmaps.texture(IMAGE)
    assert bitmaps.texture(IMAGE) is not bitmaps.texture(IMAGE, raw=True)
    assert bitmaps.channel(IMAGE, 1) is bitmaps.channel(IMAGE, 1)
    assert bitmaps.texture(bitmaps.channel(IMAGE, 0), True, Sampling(CLAMP, MIRROR))["bitmap"].pixels.dtype == np.uint8


def test_pixel_arithmetic():
    bitmaps, linear = Bitmaps(), srgb_to_linear(COLOURS / 255)
    np.testing.assert_allclose(bitmaps.scaled(IMAGE, (0.2, 0.5, 3)).linear(), linear * (0.2, 0.5, 3), rtol=3e-7)
    np.testing.assert_array_equal(bitmaps.channel(IMAGE, 2).pixels, COLOURS[..., 2:])
    np.testing.assert_array_equal(bitmaps.alpha(IMAGE).pixels, ALPHA)
    assert bitmaps.alpha(Image(COLOURS)) is None
    product = bitmaps.product(IMAGE, bitmaps.alpha(IMAGE)).linear()
    np.testing.assert_allclose(product, linear * ALPHA / 255, rtol=3e-7)
    largest = bitmaps.largest_channel(IMAGE)
    ratio = bitmaps.ratio(IMAGE, largest, 0.5).linear()
    np.testing.assert_allclose(ratio * largest.linear(), 0.5 * linear, rtol=3e-7)
    np.testing.assert_allclose(bitmaps.mean(IMAGE), linear.mean(axis=(0, 1)), rtol=3e-7)
    assert bitmaps.constant(IMAGE) is None
    np.testing.assert_allclose(bitmaps.constant(Image(np.full((2, 3, 1), 51, np.uint8)), raw=True), 0.2)


@pytest.mark.parametrize("filter_type", [BILINEAR, NEAREST])
@pytest.mark.parametrize("wrap_v", [REPEAT, MIRROR, CLAMP])
@pytest.mark.parametrize("wrap_u", [REPEAT, MIRROR, CLAMP])
def test_wrap_modes_that_differ_along_the_axes(wrap_u, wrap_v, filter_type):
    """Exact inside the bounds of the mesh, also with a transform of the coordinates."""
    bitmaps, sampling = Bitmaps(), Sampling(wrap_u, wrap_v, filter_type)
    bounds = ((-1.4, 2.4), (-1.4, 2.4))
    texture = bitmaps.texture(IMAGE, True, sampling, bounds)
    assert bitmaps.is_exact(IMAGE, sampling, bounds)
    expected = sample(COLOURS / 255, UVS, wrap_u, wrap_v, filter_type)
    np.testing.assert_allclose(sample_texture(texture, UVS), expected, atol=2e-6)
    rows = ((0.3, -0.5, 0.1), (0.6, 0.4, -0.2))
    texture = bitmaps.texture(IMAGE, True, sampling._replace(to_uv=rows), bounds)
    mapped = UVS @ np.array(rows)[:, :2].T + np.array(rows)[:, 2]
    expected = sample(COLOURS / 255, mapped, wrap_u, wrap_v, filter_type)
    np.testing.assert_allclose(sample_texture(texture, UVS), expected, atol=2e-6)


def test_clamping_of_one_axis_is_limited():
    sampling = Sampling(CLAMP, REPEAT)
    assert not Bitmaps().is_exact(IMAGE, sampling, ((0, 100), (0, 1)))
    assert Bitmaps().is_exact(IMAGE, sampling, ((0, 1), (0, 100)))
    assert max(Bitmaps().texture(IMAGE, True, sampling, ((0, 1e9), (0, 1)))["bitmap"].pixels.shape) < 40
    huge = sampling._replace(to_uv=((1e300, -1e300, 0.0), (1e300, 1e300, 0.0)))
    with np.errstate(all="ignore"):
        assert not Bitmaps().is_exact(IMAGE, huge, ((-1e30, 1e30), (-1e30, 1e30)))


@pytest.mark.parametrize(("cutoff", "factor"), [(0.5, 1.0), (0.25, 0.7), (1.0, 1.0), (0.0, 0.5), (2.0, 1.0)])
def test_thresholds_compare_after_interpolation(cutoff, factor):
    bitmaps = Bitmaps()
    texture = bitmaps.texture(bitmaps.threshold(bitmaps.alpha(IMAGE), cutoff, factor), True)
    opacity = np.clip(sample_texture(texture, UVS), 0, 1)  # as a mask does
    alpha = factor * sample(ALPHA / 255, UVS, REPEAT, REPEAT)
    is_clear = np.abs(alpha - cutoff) > 1 / 65536 + 1e-6
    np.testing.assert_array_equal(opacity[is_clear], (alpha >= cutoff)[is_clear])
    assert is_clear.mean() > 0.99 or cutoff == 0


def test_texels_at_the_cutoff_are_opaque():
    alpha = Image(np.full((2, 2, 1), 51, np.uint8))
    threshold = Bitmaps().threshold(alpha, 0.2)
    assert np.clip(threshold.pixels, 0, 1).min() > 1 - 1e-6
    np.testing.assert_array_equal(Bitmaps().clipped(Bitmaps().threshold(alpha, 0.21)).pixels, 0.0)


def test_normal_maps():
    bitmaps = Bitmaps()
    assert bitmaps.normal_map(IMAGE, ((1.0, 0.0), (0.0, 1.0))) is IMAGE
    flipped = bitmaps.normal_map(IMAGE, ((1.0, 0.0), (0.0, -1.0))).pixels
    assert flipped.dtype == np.uint8
    np.testing.assert_array_equal(flipped, np.stack([COLOURS[..., 0], 255 - COLOURS[..., 1], COLOURS[..., 2]], axis=2))
    turned = bitmaps.normal_map(IMAGE, ((0.0, -1.0), (1.0, 0.0))).pixels
    np.testing.assert_array_equal(turned, np.stack([255 - COLOURS[..., 1], COLOURS[..., 0], COLOURS[..., 2]], axis=2))
    matrix = np.array([[0.5, -0.2], [0.1, 2.0]])
    normals = 2 * bitmaps.normal_map(IMAGE, tuple(map(tuple, matrix.tolist()))).linear(raw=True) - 1
    expected = COLOURS / 127.5 - 1
    np.testing.assert_allclose(normals[..., :2], expected[..., :2] @ matrix.T, atol=1e-6)
    np.testing.assert_allclose(normals[..., 2], expected[..., 2], atol=1e-6)
