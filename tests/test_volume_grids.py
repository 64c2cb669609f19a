"""Volumes on the host: .vol files, compiled grids, bounds of the extinction, and what is refused."""

import struct

import numpy as np
import pytest
import small_files
from grid_reference import grid, ramp, value_at
from media_scenes import NULL, rgb, transform
from scalar_mitsuba import import_mitsuba

from isonoise.errors import SceneError
from isonoise.integrator.features import features
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.volume.grid_file import VolumeGrid, read_vol, write_vol

VALUES = np.random.default_rng(1).random((5, 6, 7, 3)).astype(np.float32)
TURN = np.array([[0.8, -0.6, 0, 0], [0.6, 0.8, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def scene_of_medium(shape: dict | None = None, integrator: str = "volpath", **medium) -> dict:
    cube = {"type": "cube", "bsdf": NULL, "interior": {"type": "heterogeneous", **medium}, **(shape or {})}
    scene = {"type": "scene", "integrator": {"type": integrator}, "sensor": {"type": "perspective"}, "cube": cube}
    scene["sky"] = {"type": "constant"}
    return scene


def compiled(**medium):
    return compile_scene(load_description(scene_of_medium(**medium)))


def matrix(rows: np.ndarray) -> np.ndarray:
    return np.vstack([rows.reshape(3, 4), [0, 0, 0, 1]]).astype(float)


def test_a_file_is_written_and_read(tmp_path):
    grid_ = VolumeGrid(VALUES, np.array([[-1.0, -2.0, -3.0], [1.0, 2.0, 5.0]]))
    write_vol(tmp_path / "a.vol", grid_)
    again = read_vol(tmp_path / "a.vol")
    assert (again.values == VALUES).all()
    assert (again.bounds == grid_.bounds).all()
    mitsuba = import_mitsuba()
    assert (np.array(mitsuba.VolumeGrid(str(tmp_path / "a.vol"))) == VALUES).all()
    mitsuba.VolumeGrid(VALUES[..., :1]).write(str(tmp_path / "b.vol"))
    assert (read_vol(tmp_path / "b.vol").values == VALUES[..., :1]).all()


SOUND = small_files.vol()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "does not begin with VOL"),
        (b"VOX" + SOUND[3:], "does not begin with VOL"),
        (SOUND[:40], "truncated"),
        (SOUND[:-1], "truncated.*cannot hold the 4 x 3 x 2 cells with 1 channels"),
        (b"VOL\x02" + SOUND[4:], "version 2"),
        (SOUND[:4] + b"\x02" + SOUND[5:], "encoding 2 is not supported"),
        (SOUND[:8] + struct.pack("<3i", 2**30, 2**30, 2**30) + SOUND[20:], "truncated.*cannot hold"),
        (SOUND[:8] + struct.pack("<i", -4) + SOUND[12:], "-4 x 3 x 2 cells"),
        (SOUND[:8] + struct.pack("<i", 0) + SOUND[12:], "there is nothing in it"),
        (SOUND[:8] + struct.pack("<4i", 2, 3, 2, 2) + SOUND[24:], "2 channels; 1 and 3"),
        (SOUND[:-4] + struct.pack("<f", np.nan), "not finite"),
        (SOUND[:-4] + struct.pack("<f", np.inf), "not finite"),
        (SOUND[:-4] + struct.pack("<f", -1), "cannot be negative, got -1"),
    ],
)
def test_damaged_files(tmp_path, content, problem):
    """Sizes that a header claims are checked before they are allocated: 2^90 values need no memory."""
    (tmp_path / "a.vol").write_bytes(content)
    with pytest.raises(SceneError, match=f"a.vol.*{problem}"):
        compiled(sigma_t={"type": "gridvolume", "filename": str(tmp_path / "a.vol")})


@pytest.mark.parametrize(
    ("medium", "problem"),
    [
        ({"sigma_t": {"type": "gridvolume"}}, "one of 'filename', 'grid' and 'data'"),
        ({"sigma_t": grid(VALUES, filename="a.vol")}, "one of 'filename', 'grid' and 'data'"),
        ({"sigma_t": grid(VALUES, use_grid_bbox=True)}, "use_grid_bbox needs a file"),
        ({"sigma_t": grid(VALUES[..., :2])}, "2 channels"),
        ({"sigma_t": grid(VALUES[0, 0])}, "'data' has to be an array"),
        ({"sigma_t": grid(VALUES[:0])}, "no cells"),
        ({"sigma_t": grid(VALUES, np.diag([1.0, 1, 0, 1]))}, "cannot be inverted"),
        ({"sigma_t": grid(VALUES, transform(scale=1e-39))}, "32-bit floats"),
        ({"sigma_t": grid(VALUES), "scale": 1e9}, "is limited to 9.69e.*optical thickness"),
        ({"albedo": grid(2 * VALUES)}, "albedo is at most 1"),
        ({"albedo": {"type": "constvolume", "value": 2.0}}, "at most 1"),
        ({"majorant": 2.0}, "no parameter 'majorant'"),
        ({"sigma_t": {"type": "gridvolume", "filename": "absent.vol"}}, "absent.vol.*cannot be read"),
    ],
)
def test_volumes_that_are_wrong(medium, problem):
    with pytest.raises(SceneError, match=problem):
        compiled(**medium)


def test_a_grid_that_several_media_name_is_stored_once(tmp_path):
    (tmp_path / "a.vol").write_bytes(small_files.vol(channels=3))
    volume = {"type": "gridvolume", "filename": str(tmp_path / "a.vol")}
    scene = scene_of_medium(sigma_t=volume)
    for number in range(3):
        medium = {"type": "heterogeneous", "sigma_t": {**volume}, "albedo": {**volume, "wrap_mode": "mirror"}}
        scene[f"shape {number}"] = {"type": "sphere", "bsdf": NULL, "interior": medium}
    all_ = compile_scene(load_description(scene))
    media = all_.heterogeneous
    assert (len(all_.media), len(media.records), len(media.grids), media.values.size) == (2, 2, 2, 72)


def test_homogeneous_media_keep_their_records():
    fog = {"type": "homogeneous", "sigma_t": 2.0}
    scene = scene_of_medium(sigma_t=grid(VALUES)) | {"ball": {"type": "sphere", "bsdf": NULL, "interior": fog}}
    media = compile_scene(load_description(scene))
    assert media.heterogeneous.records["sigma_t"].tolist() == [0, structs.NONE]
    assert media.media["sigma_t"].tolist() == [[1.0] * 3, [2.0] * 3]


def test_scenes_without_grids_have_no_feature_and_no_arrays():
    for scene in (
        scene_of_medium(integrator="path", sigma_t=grid(VALUES)),
        scene_of_medium() | {"cube": {"type": "cube", "interior": {"type": "homogeneous"}}},
    ):
        without = compile_scene(load_description(scene))
        assert without.heterogeneous is None
        assert not features(without)["HETEROGENEOUS"]
    assert features(compiled(sigma_t=grid(VALUES)))["HETEROGENEOUS"]


def test_the_hash_changes_with_the_values():
    hashes = {compiled(sigma_t=grid(VALUES * factor)).hash for factor in (1.0, 1.0, 0.5)}
    hashes.add(compiled(sigma_t=grid(VALUES, wrap_mode="mirror")).hash)
    assert len(hashes) == 3


PLACES = {  # to_world, wrap_mode, filter_type
    "unit cube": (np.eye(4), "clamp", "trilinear"),
    "axes exchanged": (transform(x=1, y=2)[[1, 2, 0, 3]] * 3, "clamp", "trilinear"),
    "turned": (TURN @ transform(x=3.0, scale=(2.0, 0.5, 1.0)), "repeat", "trilinear"),
    "turned, mirrored": (TURN, "mirror", "nearest"),
    "turned, clamped": (TURN, "clamp", "nearest"),
}


@pytest.mark.parametrize("name", PLACES)
def test_bounds_of_cells_hold_at_all_points(name):
    """At random points of the box, against values in float64; and the box is that around the volume."""
    to_world, wrap, filter_type = PLACES[name]
    to_world = to_world.copy()
    to_world[3] = 0, 0, 0, 1
    values = np.random.default_rng(2).random((21, 18, 30, 1)).astype(np.float32) ** 8
    values *= np.linspace(0, 1, 30, dtype=np.float32)[:, None]
    medium = compiled(sigma_t=grid(values, to_world, wrap_mode=wrap, filter_type=filter_type), scale=3.0).heterogeneous
    record = medium.records[0]
    corners = np.array([[i, j, k, 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) @ to_world.T
    assert record["lower"] == pytest.approx(corners[:, :3].min(axis=0), abs=1e-6)
    assert record["upper"] == pytest.approx(corners[:, :3].max(axis=0), abs=1e-6)
    points = np.random.default_rng(3).uniform(record["lower"], record["upper"], (20_000, 3))
    points = np.hstack([points, np.ones((len(points), 1))])
    cells = np.clip((points @ matrix(record["to_cells"]).T)[:, :3].astype(int), 0, record["cells"].astype(int) - 1)
    x, y, z = cells.T
    index = record["first_cell"] + (z * record["cells"][1] + y) * record["cells"][0] + x
    low, high = medium.extinction_bounds[index].T
    local = (points @ matrix(medium.grids[0]["to_local"]).T)[:, :3]
    assert np.abs(local - (points @ np.linalg.inv(to_world).T)[:, :3]).max() < 1e-5
    sigma = 3.0 * value_at(values, local, wrap, filter_type == "nearest")[:, 0]
    assert (low <= sigma * (1 + 1e-6)).all()
    assert (high >= sigma * (1 - 1e-6)).all()
    assert (high < sigma.max() * 0.9).mean() > 0.1  # they are not all the same


def test_a_constant_fills_the_unit_cube():
    media = compiled(sigma_t={"type": "constvolume", "value": rgb(1, 2, 3), "to_world": transform(x=1, scale=2.0)})
    record = media.heterogeneous.records[0]
    assert (record["lower"].tolist(), record["upper"].tolist()) == ([1, 0, 0], [3, 2, 2])
    assert media.heterogeneous.values.tolist() == [1, 2, 3]
    assert media.heterogeneous.extinction_bounds.tolist() == [[1, 3]]


@pytest.mark.filterwarnings("ignore::UserWarning")  # about the camera, which stays behind
def test_far_and_small_scenes_are_placed_with_their_volumes():
    """A scene far from the origin and one of a tiny size keep the place of the volume in the shape, and its depth."""
    for x, size in ((1e5, 1.0), (0.0, 1e-12), (3e4, 1e-3)):
        to_world = transform(x=x, y=x, z=x, scale=size)
        for sigma_t in (grid(ramp(0, 1), to_world), {"type": "constvolume", "value": 1.0, "to_world": to_world}):
            shape = {"to_world": to_world @ transform(0.5, 0.5, 0.5, scale=0.5)}
            scene = compile_scene(load_description(scene_of_medium(shape, sigma_t=sigma_t, scale=1 / size)))
            record = scene.heterogeneous.records[0]
            assert record["lower"] == pytest.approx(scene.bounds[0], abs=1e-3)
            assert record["upper"] == pytest.approx(scene.bounds[1], abs=1e-3)
            depth = scene.media["sigma_t"][0, 0] * (record["upper"] - record["lower"]).max()
            assert depth == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("wrap", ["clamp", "repeat", "mirror"])
@pytest.mark.parametrize("filter_type", ["trilinear", "nearest"])
def test_values_are_mitsubas(wrap, filter_type):
    """The float64 reference of these tests, at points in and around the volume. Beside borders of cells, where
    rounding decides which cell is nearest."""
    mitsuba = import_mitsuba()
    volume = {"type": "gridvolume", "grid": mitsuba.VolumeGrid(VALUES), "wrap_mode": wrap, "filter_type": filter_type}
    loaded = mitsuba.load_dict(volume)
    points = np.random.default_rng(4).uniform(-1.4, 2.4, (200, 3))
    off = np.abs(points * (7, 6, 5) % 1 - 0.5) < 0.49
    interaction, theirs = mitsuba.Interaction3f(), []
    for point in points[off.all(axis=1)]:
        interaction.p = point
        theirs.append(np.array(loaded.eval(interaction)))
    ours = value_at(VALUES, points[off.all(axis=1)], wrap, filter_type == "nearest")
    assert ours == pytest.approx(np.array(theirs), abs=2e-5)


def test_the_box_of_the_file_is_mitsubas(tmp_path):
    write_vol(tmp_path / "a.vol", VolumeGrid(VALUES, np.array([[-1.0, -2.0, -3.0], [1.0, 2.0, 5.0]])))
    volume = {"type": "gridvolume", "filename": str(tmp_path / "a.vol"), "use_grid_bbox": True}
    to_world = TURN @ transform(x=10, scale=(2.0, 3.0, 4.0))
    mitsuba = import_mitsuba()
    box = mitsuba.load_dict(volume | {"to_world": mitsuba.ScalarTransform4f(to_world)}).bbox()
    record = compiled(sigma_t=volume | {"to_world": to_world}).heterogeneous.records[0]
    assert record["lower"] == pytest.approx(np.array(box.min), rel=1e-5)
    assert record["upper"] == pytest.approx(np.array(box.max), rel=1e-5)


def test_a_file_has_to_be_inside_the_folder(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "a.vol").write_bytes(SOUND)
    (tmp_path / "scene" / "b.vol").write_bytes(SOUND)
    text = """<scene version="3.0.0"><integrator type="volpath"/><sensor type="perspective"/><shape type="cube">
        <bsdf type="null"/><medium type="heterogeneous" name="interior"><volume type="gridvolume" name="sigma_t">
        <string name="filename" value="{}"/></volume></medium></shape></scene>"""
    for name in ("../a.vol", "b.vol"):
        (tmp_path / "scene" / "s.xml").write_text(text.format(name))
        if name == "b.vol":
            assert compile_scene(load_description(tmp_path / "scene" / "s.xml")).heterogeneous.values.size == 24
        else:
            with pytest.raises(SceneError, match="outside the scene's folder"):
                load_description(tmp_path / "scene" / "s.xml")
