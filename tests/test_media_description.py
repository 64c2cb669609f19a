"""Media in scene files: compiled records, errors, and scenes without media."""

import pytest
from media_scenes import HALF, LIGHT, lit_floor, sheets

from isonoise.errors import SceneError
from isonoise.integrator.features import features
from isonoise.integrator.kernel_table import PATH_STATE
from isonoise.scene import compile_scene, load_description, structs
from isonoise.scene.material.bsdf_kinds import bsdf_bits
from isonoise.scene.mesh.triangle_records import triangle_records


def inside_ball(inside: str, integrator: str = "volpath") -> str:
    return f'<integrator type="{integrator}"/><shape type="sphere"><bsdf type="null"/>{inside}</shape>'


def test_media_of_a_file(scene_of):
    compiled = compile_scene(
        scene_of(
            """<integrator type="volpath"/>
            <medium type="homogeneous" id="fog"><rgb name="sigma_t" value="0.1 0.2 0.3"/><float name="scale" value="2"/>
                <boolean name="has_spectral_extinction" value="true"/></medium>
            <phase type="hg" id="onwards"/>
            <shape type="sphere"><bsdf type="null"/><ref name="exterior" id="fog"/>
                <medium name="interior" type="homogeneous"><ref id="onwards"/>
                <boolean name="sample_emitters" value="false"/>
                <volume name="albedo" type="constvolume"><rgb name="value" value="0.1 0.2 0.3"/></volume>
                </medium></shape>
            <shape type="cube"><bsdf type="null"/><ref name="interior" id="fog"/></shape>
            <shape type="rectangle"/>
            <emitter type="point"><ref id="fog"/></emitter>
            <sensor type="perspective"><ref id="fog"/></sensor>"""
        )
    )
    assert compiled.volumetric
    fog, own = compiled.media[compiled.sensor_medium], compiled.media[compiled.shapes["media"][0] & 0xFFFF]
    assert len(compiled.media) == 2
    assert fog["sigma_t"] == pytest.approx([0.2, 0.4, 0.6])
    assert fog["albedo"] == pytest.approx([0.75] * 3)
    assert own["sigma_t"] == pytest.approx([1.0] * 3)
    assert own["albedo"] == pytest.approx([0.1, 0.2, 0.3])
    phases = compiled.bsdfs[[fog["phase"], own["phase"]]]
    assert (phases["kind"] == bsdf_bits("hg")).all()
    assert phases["constants"][:, 0] == pytest.approx([0.0, 0.8])
    assert (phases["flags"] & structs.BSDF_NO_LIGHT_SAMPLING).astype(bool).tolist() == [False, True]
    sphere, cube, plain = compiled.shapes["media"]
    assert sphere >> 16 == compiled.sensor_medium
    assert (cube & 0xFFFF, cube >> 16) == (compiled.sensor_medium, structs.MEDIUM_NONE)
    assert plain == structs.NONE
    seen_through = (compiled.shapes["flags"] & structs.SHAPE_PASS_THROUGH) != 0
    assert seen_through.tolist() == [True, True, False]
    records = triangle_records(compiled)
    assert set(records["media"]) == {cube, plain}


@pytest.mark.parametrize(
    ("inside", "problem"),
    [
        ('<medium type="homogeneous"/>', "has to be named interior or exterior"),
        ('<medium name="inside" type="homogeneous"/>', "has to be named interior or exterior, got 'inside'"),
        ('<medium name="interior" type="homogeneous"/>' * 2, "'interior' is given twice"),
        *(
            (f'<medium name="interior" type="homogeneous">{inner}</medium>', problem)
            for inner, problem in (
                ('<phase type="hg"><float name="g" value="1"/></phase>', r"'g' has to be in \(-1, 1\)"),
                ('<phase type="hg"/><phase type="isotropic"/>', "only one phase"),
                ('<phase type="rayleigh"/>', "phase 'rayleigh' is not supported"),
                ('<float name="sigma_t" value="-1"/>', "cannot be negative"),
                ('<float name="albedo" value="1.5"/>', "at most 1"),
                ('<rgb name="albedo" value="0.5 0.5 1.5"/>', "at most 1"),
                ('<volume name="albedo" type="constvolume"><float name="value" value="2"/></volume>', "at most 1"),
                (
                    '<volume name="albedo" type="gridvolume"/>',
                    "'albedo' of a medium 'homogeneous' cannot be a gridvolume.*'heterogeneous' can",
                ),
                ('<texture name="albedo" type="checkerboard"/>', "cannot contain a texture"),
                ('<float name="scale" value="-1"/>', "scale"),
                ('<float name="sigma_t" value="1e20"/><float name="scale" value="1e20"/>', "overflow"),
                ('<float name="sigma_s" value="1"/>', "no parameter 'sigma_s'"),
            )
        ),
    ],
)
def test_media_that_are_wrong(scene_of, inside, problem):
    with pytest.raises(SceneError, match=problem):
        scene_of(inside_ball(inside))


def test_blends_of_what_is_seen_through_have_a_limit(scene_of):
    def nested(depth: int) -> str:
        inner = '<bsdf type="null"/>' if depth == 0 else nested(depth - 1)
        return f'<bsdf type="blendbsdf"><float name="weight" value="0.5"/>{inner}<bsdf type="null"/></bsdf>'

    def scene(depth: int):
        return compile_scene(scene_of(f'<integrator type="volpath"/><shape type="sphere">{nested(depth)}</shape>'))

    scene(7)
    with pytest.raises(SceneError, match="more than 8 deep"):
        scene(8)


# What it costs.


def test_scenes_without_media_do_not_pay_for_them():
    """The same features under `volpath` as under `path`; so the same programs and buffers."""
    path, volpath = (
        features(compile_scene(load_description(lit_floor(integrator) | {"light": LIGHT})))
        for integrator in ("path", "volpath")
    )
    assert path == volpath
    assert not path["VOLPATH"]
    assert not path["MEDIA"]
    cornell = features(compile_scene(load_description("cornell")))
    assert not cornell["VOLPATH"]
    assert not cornell["MEDIA"]


def test_masks_pay_for_no_media(scene_of):
    on = features(compile_scene(load_description(sheets([HALF]))))
    assert on["VOLPATH"]
    assert not on["MEDIA"]
    assert PATH_STATE["medium"].planes == 1
