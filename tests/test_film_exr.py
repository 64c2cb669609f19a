"""OpenEXR files: exact values, atomic writes, references; and the checks before writing."""

import os
import stat
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from isonoise.errors import UserError
from isonoise.film.exr import read_exr, read_header, read_reference, write_exr
from isonoise.film.files import check_writable, write_atomically
from isonoise.film.output import check_output, write_image

LIMITED = "import resource, signal; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))"
"""Limits files to 4 KiB, which looks like a full disk."""


def image(height=5, width=7, seed=0):
    return np.random.default_rng(seed).lognormal(0, 3, (height, width, 3)).astype(np.float32)


def entries(folder):
    return sorted(path.name for path in folder.iterdir())


def run_python(code, cwd):
    return subprocess.run([sys.executable, "-c", textwrap.dedent(code)], cwd=cwd, capture_output=True, text=True)


def test_values_are_exact(tmp_path):
    rgb = image()
    samples = np.arange(35, dtype=np.uint32).reshape(5, 7) + (2**32 - 100)
    error = np.where(rgb[..., 0] > 1, np.inf, rgb[..., 1].astype(np.float64))
    write_exr(tmp_path / "a.exr", {"": rgb, "samples": samples, "error": error, "albedo": rgb[::-1]}, {})
    channels, _ = read_exr(tmp_path / "a.exr")
    assert set(channels) == {"R", "G", "B", "samples", "error", "albedo.R", "albedo.G", "albedo.B"}
    for i, name in enumerate("RGB"):
        np.testing.assert_array_equal(channels[name], rgb[..., i])
        np.testing.assert_array_equal(channels[f"albedo.{name}"], rgb[::-1, :, i])
    assert channels["samples"].dtype == np.uint32
    np.testing.assert_array_equal(channels["samples"], samples)
    np.testing.assert_array_equal(channels["error"], error.astype(np.float32))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 9), (17, 1), (33, 50)])
def test_odd_sizes_and_strided_arrays(tmp_path, height, width):
    rgb = np.asfortranarray(image(height, width))
    write_exr(tmp_path / "a.exr", {"": rgb}, {})
    np.testing.assert_array_equal(read_reference(tmp_path / "a.exr")[0], rgb)
    assert read_header(tmp_path / "a.exr")[:2] == (["B", "G", "R"], (width, height))


def test_numbers_in_the_header_are_exact(tmp_path):
    header = {"isonoise.samples": 2**53 + 1, "isonoise.time_s": 1 / 3, "isonoise.scene": "Küche.xml"}
    write_exr(tmp_path / "a.exr", {"": image()}, header)
    _, _, found = read_header(tmp_path / "a.exr")
    assert int(found["isonoise.samples"]) == 2**53 + 1
    assert float(found["isonoise.time_s"]) == 1 / 3
    assert found["isonoise.scene"] == "Küche.xml"
    assert read_exr(tmp_path / "a.exr")[1] == found


def test_equal_images_give_equal_files(tmp_path):
    for name in "ab":
        write_exr(tmp_path / f"{name}.exr", {"": image(), "samples": np.ones((5, 7), np.uint32)}, {"isonoise.seed": 1})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_mitsuba_reads_our_layers(tmp_path):
    mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba is in the extra 'peers'")
    mitsuba.set_variant("scalar_rgb")
    rgb, samples = image(), np.full((5, 7), 1000, np.uint32)
    write_exr(tmp_path / "a.exr", {"": rgb, "samples": samples, "M_x": rgb[..., 1], "stderr": rgb / 8}, {"n": 1})
    bitmap = mitsuba.Bitmap(str(tmp_path / "a.exr"))
    pixels = np.array(bitmap)
    found = {field.name: pixels[..., i] for i, field in enumerate(bitmap.struct_())}
    expected = {"samples": samples, "M_x": rgb[..., 1]}
    expected |= {name: rgb[..., i] for i, name in enumerate("RGB")}
    expected |= {f"stderr.{name}": rgb[..., i] / 8 for i, name in enumerate("RGB")}
    assert set(found) == set(expected)
    for name, plane in expected.items():
        np.testing.assert_array_equal(found[name], plane, err_msg=name)


def test_references_with_and_without_standard_error(tmp_path):
    rgb = image()
    write_exr(tmp_path / "plain.exr", {"": rgb}, {})
    write_exr(tmp_path / "both.exr", {"": rgb, "stderr": rgb / 10}, {})
    assert read_reference(tmp_path / "plain.exr")[1] is None
    found, stderr = read_reference(tmp_path / "both.exr")
    np.testing.assert_array_equal(found, rgb)
    np.testing.assert_array_equal(stderr, rgb / 10)


def test_public_reference(public_scenes):
    rgb, stderr = read_reference(public_scenes / "cornell-box" / "reference.exr")
    assert rgb.shape == stderr.shape == (256, 256, 3)
    assert rgb.dtype == stderr.dtype == np.float32
    assert 0 < np.median(stderr) < 0.02 * np.median(rgb)


def test_unusable_references(tmp_path):
    with pytest.raises(UserError, match=r"nothing\.exr.*No such file"):
        read_reference(tmp_path / "nothing.exr")
    with pytest.raises(UserError, match="Is a directory"):
        read_reference(tmp_path)
    (tmp_path / "text.exr").write_text("no image")
    with pytest.raises(UserError, match="not an OpenEXR file"):
        read_reference(tmp_path / "text.exr")
    write_exr(tmp_path / "depth.exr", {"Z": image()[..., 0]}, {})
    with pytest.raises(UserError, match="no channels R, G, B, only Z"):
        read_reference(tmp_path / "depth.exr")
    rgb = image()
    rgb[2, 3, 1] = np.nan
    write_exr(tmp_path / "nan.exr", {"": rgb}, {})
    with pytest.raises(UserError, match="not finite"):
        read_reference(tmp_path / "nan.exr")


def test_a_truncated_file_is_an_error(tmp_path):
    write_exr(tmp_path / "a.exr", {"": image(40, 40)}, {})
    whole = (tmp_path / "a.exr").read_bytes()
    for length in np.linspace(0, len(whole) - 1, 40, dtype=int):
        (tmp_path / "cut.exr").write_bytes(whole[:length])
        with pytest.raises(UserError, match="cannot read"):
            read_exr(tmp_path / "cut.exr")


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt(), ValueError("bug")])
def test_a_failed_write_changes_no_file(tmp_path, failure):
    target = tmp_path / "a.exr"
    target.write_bytes(b"old")

    def write(temporary):
        temporary.write_bytes(b"half of the")
        raise failure

    with pytest.raises(UserError if isinstance(failure, OSError) else type(failure)):
        write_atomically(target, write)
    assert entries(tmp_path) == ["a.exr"]
    assert target.read_bytes() == b"old"


@pytest.mark.skipif(sys.platform == "win32", reason="file size limits are POSIX")
@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_a_full_disk_is_reported_and_leaves_no_file(tmp_path, name):
    code = f"""
        {LIMITED}
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        import numpy as np
        from isonoise.errors import UserError
        from isonoise.film.output import write_image
        try:
            write_image("{name}", {{"": np.random.default_rng(0).random((64, 64, 3), dtype=np.float32)}}, {{}})
        except UserError as error:
            print("message:", error)
        """
    done = run_python(code, tmp_path)
    assert f"message: cannot write '{name}'" in done.stdout, done.stderr
    assert entries(tmp_path) == []


@pytest.mark.skipif(sys.platform == "win32", reason="permission bits are POSIX")
def test_files_get_the_permissions_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_exr(tmp_path / "a.exr", {"": image()}, {})
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.exr").stat().st_mode) == 0o640


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are Unicode")
def test_names_that_are_not_utf8(tmp_path):
    folder = tmp_path / "d\udcff"
    folder.mkdir()
    write_exr(folder / "\udcfe.exr", {"": image()}, {"isonoise.scene": "\udcfe.xml"})
    channels, header = read_exr(folder / "\udcfe.exr")
    np.testing.assert_array_equal(channels["R"], image()[..., 0])
    assert header["isonoise.scene"] == "\\udcfe.xml"


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "far").mkdir()
    link = tmp_path / "a.exr"
    link.symlink_to(tmp_path / "far" / "b.exr")
    check_writable(link)
    write_exr(link, {"": image()}, {})
    assert link.is_symlink()
    assert entries(tmp_path / "far") == ["b.exr"]


def test_unwritable_paths_are_found_beforehand(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "loop.exr").symlink_to(tmp_path / "loop.exr")
    for path, message in {
        tmp_path / "no" / "a.exr": "there is no folder .*no",
        tmp_path / "file" / "a.exr": "there is no folder|Not a directory",
        tmp_path: "it is a folder",
        tmp_path / ("a" * 300 + ".exr"): "too long",
        tmp_path / "loop.exr": "cannot write",
        "a\0.exr": "null",
        "/dev/null": "not a regular file",
    }.items():
        with pytest.raises(UserError, match=message):
            check_writable(path)
    assert entries(tmp_path) == ["file", "loop.exr"]


def test_a_read_only_folder_is_found_beforehand(tmp_path, monkeypatch):
    # permission bits do not stop root, so the system call is patched to fail
    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", refuse)
    with pytest.raises(UserError, match="Permission denied"):
        check_writable(tmp_path / "a.exr")


def test_checking_leaves_no_file(tmp_path):
    (tmp_path / "old.exr").write_bytes(b"old")
    assert check_writable(tmp_path / "new.exr") == (tmp_path / "new.exr").resolve()
    check_writable(tmp_path / "old.exr")
    assert entries(tmp_path) == ["old.exr"]
    assert (tmp_path / "old.exr").read_bytes() == b"old"


@pytest.mark.parametrize("name", ["a", "a.jpg", "a.exr.bak", ".exr"])
def test_unknown_extensions(tmp_path, name):
    with pytest.raises(UserError, match=r"use \.exr .* or \.png"):
        check_output(tmp_path / name)
    with pytest.raises(UserError, match=r"use \.exr .* or \.png"):
        write_image(tmp_path / name, {"": image()}, {})
    assert entries(tmp_path) == []
