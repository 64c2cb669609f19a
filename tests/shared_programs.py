"""Lets the scenes of a test file share their programs: compiling kernels takes most of the time of such tests."""

import pytest

from isonoise.integrator import set_up
from isonoise.integrator.features import features
from isonoise.integrator.wavefront import Wavefront
from isonoise.statistics import BASIC_NEEDS

SHAPES = ("TRIANGLES", "ANALYTICS", "SPHERES", "DISKS", "CYLINDERS")
_MESH_LIGHTS = ("TRIANGLE_LIGHTS", "PARALLELOGRAM_LIGHTS")
AREA_LIGHTS = ("AREA_LIGHTS", *_MESH_LIGHTS, "SPHERE_LIGHTS", "DISK_LIGHTS", "CYLINDER_LIGHTS")
LIGHTS = (*AREA_LIGHTS, "POINT_LIGHTS", "DIRECTIONAL_LIGHTS", "CONSTANT_LIGHT", "MANY_LIGHTS", "NEXT_EVENT")


def share_programs(*feature_sets: tuple[str, ...]):
    """Returns a fixture: renders of scenes that use only features of one of the sets have all features of the set.

    Other scenes keep their own programs. Features that a scene does not use change no bit of its image:
    tests/test_features.py. Only scenes for `volpath` get VOLPATH, MEDIA and HETEROGENEOUS. Each keeps its sampler.
    """

    def create(device, scene, bvh, needs=BASIC_NEEDS, seed=0, pool_size=None, **options):
        chosen = features(scene, needs)
        used = {name for name, on in chosen.items() if on} - {"SOBOL", "NET_MEANS"}
        for feature_set in feature_sets:
            if used <= {*feature_set}:
                volpath = ("VOLPATH", "MEDIA", "HETEROGENEOUS")
                chosen |= {name: True for name in feature_set if chosen["VOLPATH"] or name not in volpath}
                break
        return Wavefront(device, scene, bvh, needs, seed, pool_size, chosen, **options)

    @pytest.fixture(autouse=True)
    def shared_programs(monkeypatch):
        monkeypatch.setattr(set_up, "Wavefront", create)

    return shared_programs
