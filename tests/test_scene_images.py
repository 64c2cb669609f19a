"""Image files against Mitsuba 3's reader and against the written pixels; invalid files."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from PIL import Image

from isonoise.errors import SceneError
from isonoise.scene.image.image import read_image


def random_pixels(shape, seed: int = 1, dtype=np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape, dtype=dtype)


def palette() -> Image.Image:
    image = Image.fromarray(random_pixels((5, 7)) % 16)
    image.putpalette(random_pixels(48, 2).tobytes())
    return image


IMAGES = {  # file name -> (image, options of pillow's save)
    "grey.png": (lambda: Image.fromarray(random_pixels((5, 7))), {}),
    "rgb.png": (lambda: Image.fromarray(random_pixels((5, 7, 3))), {}),
    "rgba.png": (lambda: Image.fromarray(random_pixels((5, 7, 4))), {}),
    "grey-alpha.png": (lambda: Image.fromarray(random_pixels((5, 7, 2))), {}),
    "palette.png": (palette, {"transparency": 3}),
    "bit.png": (lambda: Image.fromarray(random_pixels((5, 7)) > 127), {}),
    "rgb.bmp": (lambda: Image.fromarray(random_pixels((5, 7, 3))), {}),
    "rgb.tga": (lambda: Image.fromarray(random_pixels((5, 7, 3))), {}),
    "packed.tga": (lambda: Image.fromarray(random_pixels((5, 7, 3)) // 128), {"compression": "tga_rle"}),
    "grey.jpg": (lambda: Image.fromarray(random_pixels((16, 24))), {"quality": 95}),
    "rgb.jpg": (lambda: Image.fromarray(random_pixels((16, 24, 3))), {"quality": 95, "subsampling": 0}),
}


@pytest.mark.parametrize("name", IMAGES)
def test_8_bit_images_equal_mitsubas(mitsuba, tmp_path, name):
    """Without alpha. JPEG decoders may differ by one step in the transform and one in the colour conversion."""
    make, options = IMAGES[name]
    make().save(tmp_path / name, **options)
    image = read_image(tmp_path / name)
    theirs = np.atleast_3d(np.array(mitsuba.Bitmap(str(tmp_path / name))))
    assert image.pixels.dtype != np.float32
    assert image.pixels.dtype == np.uint8
    assert theirs.dtype == np.uint8
    channels = 1 if theirs.shape[2] < 3 else 3
    ours = np.broadcast_to(image.pixels, (*image.pixels.shape[:2], channels)).astype(int)
    assert np.abs(ours - theirs[..., :channels]).max() <= (2 if name.endswith("jpg") else 0)


def png(pixels: np.ndarray, interlaced: bool = False, **changes) -> bytes:
    """A PNG of 8 or 16 bits with unfiltered rows."""
    height, width, channels = pixels.shape
    big = pixels.astype(pixels.dtype.newbyteorder(">"))
    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
    rows = b""
    for x, y, dx, dy in passes if interlaced else [(0, 0, 1, 1)]:
        part = big[y::dy, x::dx]
        rows += b"".join(b"\0" + row.tobytes() for row in part) if part.size else b""
    colour = {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    size = struct.pack(">II", changes.get("width", width), changes.get("height", height))
    header = size + bytes([8 * pixels.itemsize, colour, 0, 0, interlaced])

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("interlaced", [False, True])
def test_all_16_bits_of_a_png(tmp_path, channels, interlaced):
    pixels = random_pixels((13, 9, channels), dtype=np.uint16)
    (tmp_path / "deep.png").write_bytes(png(pixels, interlaced))
    image = read_image(tmp_path / "deep.png")
    assert image.pixels.dtype == np.uint16
    assert (image.pixels == pixels[..., : 1 if channels < 3 else 3]).all()
    assert image.linear(raw=True) == pytest.approx(image.pixels / 65535, abs=1e-7)


def test_linear_values(tmp_path):
    """The sRGB transfer function at its ends and around the end of its linear part."""
    Image.fromarray(np.array([[0, 10, 11, 128, 255]], np.uint8)).save(tmp_path / "grey.png")
    image = read_image(tmp_path / "grey.png")
    expected = [0, 10 / 255 / 12.92, ((11 / 255 + 0.055) / 1.055) ** 2.4, 0.21586050, 1]
    assert image.linear()[0, :, 0].tolist() == pytest.approx(expected, rel=1e-6)
    assert image.linear(raw=True)[0, :, 0].tolist() == pytest.approx([0, 10 / 255, 11 / 255, 128 / 255, 1], rel=1e-6)


def write_exr(path, **channels) -> None:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


def test_openexr(tmp_path):
    half = np.random.default_rng(3).random((5, 7)).astype(np.float16)
    whole, count = half.astype(np.float32) * 1e6, np.arange(35, dtype=np.uint32).reshape(5, 7)
    files = {
        "rgb": ({"R": half, "G": whole, "B": count, "A": half, "depth.Z": whole}, [half, whole, count]),
        "luminance": ({"Y": half, "A": half}, [half]),
        "single": ({"height": whole}, [whole]),
        "small": ({"r": half, "g": half, "b": whole}, [half, half, whole]),
    }
    for name, (channels, expected) in files.items():
        write_exr(tmp_path / f"{name}.exr", **channels)
        image = read_image(tmp_path / f"{name}.exr")
        assert image.pixels.dtype == np.float32
        assert (image.pixels == np.stack(expected, axis=-1).astype(np.float32)).all()
    write_exr(tmp_path / "other.exr", X=half, Q=half)
    with pytest.raises(SceneError, match="needs channels R, G, B, or Y alone; it has Q, X"):
        read_image(tmp_path / "other.exr")


# Radiance pictures


def random_rgbe(shape, seed: int = 5) -> np.ndarray:
    """Pixels (height, width, 4) with runs, without the codes of the format."""
    random = np.random.default_rng(seed)
    height, width = shape
    pixels = np.repeat(
        random.integers(2, 256, (height, width, 4), dtype=np.uint8), random.integers(1, 9, width), axis=1
    )
    pixels[random.random(pixels.shape[:2]) < 0.1] = 0
    return pixels[:, :width]


def decode_rgbe(rgbe: np.ndarray) -> np.ndarray:
    exponent = rgbe[..., 3:].astype(int)
    return np.where(exponent > 0, rgbe[..., :3] * 2.0 ** (exponent - 136), 0.0)


def hdr(body: bytes, size: str, header: str = "#?RADIANCE\n# made up\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=4\n\n") -> bytes:
    return f"{header}{size}\n".encode() + body


def encode_planar_line(line: np.ndarray) -> bytes:
    """One line, channel by channel: runs of 3 to 127 bytes are packed, the rest is copied in pieces of up to 128."""
    width = len(line)
    out = bytes([2, 2, width >> 8, width & 255])
    for channel in line.T:
        at = 0
        while at < width:
            run = 1
            while at + run < width and run < 127 and channel[at + run] == channel[at]:
                run += 1
            if run >= 3:
                out += bytes([128 + run, channel[at]])
                at += run
                continue
            end = at
            while end < width and end - at < 128 and not (end + 2 < width and len(set(channel[end : end + 3])) == 1):
                end += 1
            out += bytes([end - at]) + channel[at:end].tobytes()
            at = end
    return out


def encode_repeated_pixels(pixels: np.ndarray) -> bytes:
    """The older encoding: a pixel, then the count of its repetitions, one byte per record."""
    out, flat, at = b"", pixels.reshape(-1, 4), 0
    while at < len(flat):
        run = 1
        while at + run < len(flat) and (flat[at + run] == flat[at]).all():
            run += 1
        out += flat[at].tobytes()
        rest = run - 1
        while rest:
            out += bytes([1, 1, 1, rest & 255])
            rest >>= 8
        at += run
    return out


@pytest.mark.parametrize("width", [1, 7, 8, 129, 400])
@pytest.mark.parametrize("encoding", ["plain", "repeats", "packed"])
def test_radiance_pictures(mitsuba, tmp_path, width, encoding):
    """Equal to the written pixels and to Mitsuba's, which does not support repeats."""
    pixels = random_rgbe((6, width))
    if encoding == "packed":
        if width < 8:
            pytest.skip("lines shorter than 8 pixels are not packed")
        body = b"".join(encode_planar_line(line) for line in pixels)
    elif encoding == "repeats":
        pixels[2:4] = pixels[2, 0]  # a run of more than 255 where lines are long
        body = encode_repeated_pixels(pixels)
    else:
        body = pixels.tobytes()
    path = tmp_path / "picture.hdr"
    path.write_bytes(hdr(body, f"-Y 6 +X {width}"))
    image = read_image(path)
    assert image.pixels.dtype == np.float32
    assert (image.pixels == decode_rgbe(pixels)).all()
    if encoding != "repeats":
        assert (image.pixels == np.array(mitsuba.Bitmap(str(path)))).all()


def test_radiance_pictures_of_many_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("isonoise.scene.image.rgbe._CHUNK_BYTES", 1000)
    pixels = random_rgbe((37, 60))
    (tmp_path / "picture.hdr").write_bytes(hdr(b"".join(map(encode_planar_line, pixels)), "-Y 37 +X 60"))
    assert (read_image(tmp_path / "picture.hdr").pixels == decode_rgbe(pixels)).all()


def test_orientations_and_formats_of_radiance_pictures(tmp_path):
    pixels, path = random_rgbe((4, 9)), tmp_path / "picture.hdr"
    values = decode_rgbe(pixels)
    for size, expected in (
        ("+Y 4 +X 9", values[::-1]),
        ("-Y 4 -X 9", values[:, ::-1]),
        ("+Y 4 -X 9", values[::-1, ::-1]),
    ):
        path.write_bytes(hdr(pixels.tobytes(), size))
        assert (read_image(path).pixels == expected).all()
    for size, header, message in (
        ("+X 9 -Y 4", "#?RADIANCE\n\n", "column order is not supported"),
        ("-Y 4 +X 9", "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n", "32-bit_rle_xyze"),
        ("-Y 4 +X 9", "#?RADIANCE\n", "header"),
        ("", "#?RADIANCE\n\n", "no size"),
    ):
        path.write_bytes(hdr(pixels.tobytes(), size, header))
        with pytest.raises(SceneError, match=message):
            read_image(path)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"", "truncated"),
        (bytes([2, 2, 0, 16]) + bytes([144, 1]) * 3, "truncated"),
        (bytes([2, 2, 0, 16]) + bytes([144, 1]) * 3 + bytes([16, 1]), "truncated"),
        (bytes([2, 2, 0, 17]) + bytes([144, 1]) * 4, "damaged"),
        (bytes([2, 2, 0, 16]) + bytes([145, 1]) + bytes([143, 1]) + bytes([144, 1]) * 2, "damaged"),
        (bytes([2, 2, 0, 16]) + bytes([0, 144, 1]) + bytes([144, 1]) * 3, "damaged"),
        (bytes([2, 2, 0, 16]) + bytes([144, 1]) * 3 + bytes([145, 1]), "damaged"),
        (bytes([1, 1, 1, 5]) * 16, "damaged"),
        (bytes([9, 9, 9, 9]) * 15, "truncated"),
        (bytes([9, 9, 9, 9, 1, 1, 1, 14]), "truncated"),
    ],
)
def test_damaged_radiance_pictures(tmp_path, body, message):
    (tmp_path / "picture.hdr").write_bytes(hdr(body, "-Y 1 +X 16"))
    with pytest.raises(SceneError, match=message):
        read_image(tmp_path / "picture.hdr")


def test_repetitions_beyond_the_last_pixel_are_ignored(tmp_path):
    (tmp_path / "picture.hdr").write_bytes(hdr(bytes([9, 9, 9, 9]) + bytes([1, 1, 1, 255]) * 9, "-Y 2 +X 16"))
    assert (read_image(tmp_path / "picture.hdr").pixels == 9 * 2.0 ** (9 - 136)).all()


# Invalid files


@pytest.fixture(scope="module")
def small_images(tmp_path_factory):
    """A folder with a valid file of every format."""
    folder = tmp_path_factory.mktemp("small")
    for name in ("rgb.png", "palette.png", "rgb.bmp", "packed.tga", "rgb.jpg"):
        make, options = IMAGES[name]
        make().save(folder / name, **options)
    (folder / "deep.png").write_bytes(png(random_pixels((5, 7, 3), dtype=np.uint16)))
    write_exr(folder / "half.exr", **{c: np.random.default_rng(6).random((5, 7)).astype(np.float16) for c in "RGB"})
    pixels = random_rgbe((6, 20))
    (folder / "packed.hdr").write_bytes(hdr(b"".join(map(encode_planar_line, pixels)), "-Y 6 +X 20"))
    (folder / "repeats.hdr").write_bytes(hdr(encode_repeated_pixels(pixels), "-Y 6 +X 20"))
    return folder


def test_missing_files_and_other_formats(tmp_path):
    for name, content, message in (
        ("nothing.png", None, "No such file"),
        ("folder", "folder", "directory"),
        ("empty.png", b"", "not a supported image"),
        ("text.png", b"what is this " * 100, "not a supported image"),
        ("text.tga", b"what is this " * 100, "image"),
        ("text.hdr", b"#?RADIANCE but then nothing", "header"),
        ("text.exr", b"\x76\x2f\x31\x01" + b"x" * 100, "cannot be read"),
    ):
        path = tmp_path / name
        if content == "folder":
            path.mkdir()
        elif content is not None:
            path.write_bytes(content)
        with pytest.raises(SceneError, match=message) as caught:
            read_image(path)
        assert str(path) in str(caught.value)
    with pytest.raises(SceneError, match="cannot be read"):
        read_image("a\0b.png")


def test_truncated_files(small_images, tmp_path):
    """A truncated file is an error, unless only data after the pixels is missing."""
    for file in sorted(small_images.iterdir()):
        data, whole = file.read_bytes(), read_image(file).pixels
        path, errors = tmp_path / file.name, 0
        cuts = range(0, len(data), max(len(data) // 40, 1))
        for length in cuts:
            path.write_bytes(data[:length])
            try:
                pixels = read_image(path).pixels
            except SceneError:
                errors += 1
                continue
            assert pixels.shape == whole.shape
        assert errors > 0.8 * len(cuts), file.name


def test_random_changes_give_images_or_errors(small_images, tmp_path):
    """60 random changes of each file: the result is an image or a SceneError."""
    random = np.random.default_rng(7)
    for file in sorted(small_images.iterdir()):
        data = np.frombuffer(file.read_bytes(), np.uint8)
        path = tmp_path / file.name
        for _ in range(60):
            changed = data.copy()
            positions = random.integers(
                0, len(data) if random.random() < 0.5 else min(len(data), 64), random.integers(1, 5)
            )
            changed[positions] = random.integers(0, 256, len(positions))
            path.write_bytes(changed.tobytes())
            try:
                image = read_image(path)
            except SceneError:
                continue
            assert image.pixels.ndim == 3
            assert image.pixels.shape[2] in (1, 3)
            assert image.pixels.size > 0


def exr_of_size(data: bytes, width: int, height: int) -> bytes:
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    return data[:at] + struct.pack("<4i", 0, 0, width - 1, height - 1) + data[at + 16 :]


def files_of_size(small_images, width: int, height: int) -> dict[str, bytes]:
    """Small files whose headers state a size."""
    bmp, jpg = bytearray((small_images / "rgb.bmp").read_bytes()), bytearray((small_images / "rgb.jpg").read_bytes())
    bmp[18:26] = struct.pack("<ii", width, height)
    frame = jpg.index(b"\xff\xc0")
    jpg[frame + 5 : frame + 9] = struct.pack(">HH", min(height, 65535), min(width, 65535))
    return {
        "size.png": png(random_pixels((5, 7, 3)), width=width, height=height),
        "size.bmp": bytes(bmp),
        "size.jpg": bytes(jpg),
        "size.hdr": hdr(b"\0" * 999, f"-Y {height} +X {width}"),
        "size.exr": exr_of_size((small_images / "half.exr").read_bytes(), width, height),
    }


@pytest.mark.parametrize("size", [(60_000, 60_000), (2**30, 2**29), (30_000, 3_000), (0, 4), (4, 0)])
def test_huge_sizes_are_rejected_by_the_header(small_images, tmp_path, size):
    """Without allocating the pixels."""
    for name, data in files_of_size(small_images, *size).items():
        if name == "size.exr" and size == (30_000, 3_000):
            continue  # possible for an OpenEXR file, because its compression ratio is unbounded
        (tmp_path / name).write_bytes(data)
        tracemalloc.start()
        with pytest.raises(SceneError, match=rf"{name}.*image"):
            read_image(tmp_path / name)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 20e6, name
