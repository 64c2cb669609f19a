"""Small pbrt files for tests."""

from pathlib import Path

from isonoise.scene.formats.pbrt.read import read
from isonoise.scene.formats.pbrt.support import SUPPORT
from isonoise.scene.formats.report import ImportReport

RICH = """
# most directives; it names a.ply, a.png, a.exr and part.pbrt
Option "bool disablewavelengthjitter" true
ColorSpace "srgb"
LookAt 0 1 -5  0 0 0  0 1 0
Scale -1 1 1
Camera "perspective" "float fov" [ 40 ] "float lensradius" 0.01 "float focaldistance" 5
Film "rgb" "integer xresolution" [ 8 ] "integer yresolution" [ 6 ] "float cropwindow" [ 0 1 0.25 1 ] "float iso" 150
PixelFilter "gaussian" "float xradius" 1.5 "float yradius" 1.5 "float sigma" 0.4
Sampler "halton" "integer pixelsamples" 4
Integrator "volpath" "integer maxdepth" 3
Accelerator "bvh"
WorldBegin
LightSource "infinite" "string filename" "a.exr" "float scale" 0.5
LightSource "infinite" "rgb L" [ 0.1 0.2 0.3 ]
LightSource "point" "rgb I" [ 1 2 3 ] "point3 from" [ 0 2 0 ]
LightSource "spot" "blackbody I" 5000 "point3 from" [ 0 2 0 ] "point3 to" [ 0 0 0 ] "float coneangle" 40
LightSource "distant" "spectrum L" [ 400 1 500 2 700 1 ] "point3 from" [ 1 2 3 ] "float illuminance" 2
LightSource "goniometric" "rgb I" [ 1 1 1 ] "string filename" "a.png"
LightSource "projection" "string filename" "a.png" "float fov" 30 "float power" 5
Texture "checks" "spectrum" "checkerboard" "rgb tex1" [ 1 0 0 ] "float uscale" 4 "float vscale" 4
Texture "picture" "spectrum" "imagemap" "string filename" "a.png" "string wrap" "clamp" "float scale" 0.5
Texture "grey" "float" "imagemap" "string filename" "a.png"
Texture "both" "spectrum" "scale" "texture tex" "picture" "texture scale" "grey"
Texture "mixed" "spectrum" "mix" "texture tex1" "checks" "texture tex2" "both" "float amount" 0.3
MakeNamedMedium "fog" "string type" "homogeneous" "rgb sigma_a" [ 0.1 0.2 0.3 ] "rgb sigma_s" [ 1 1 1 ] "float g" 0.3
MakeNamedMedium "smoke" "string type" "uniformgrid" "integer nx" 2 "float density" [ 0 1 ] "point3 p1" [ 1 2 3 ]
MakeNamedMaterial "red" "string type" "coateddiffuse" "texture reflectance" "mixed" "float roughness" 0.2
MakeNamedMaterial "glass" "string type" "dielectric" "spectrum eta" "glass-BK7"
MakeNamedMaterial "mix" "string type" "mix" "string materials" [ "red" "glass" ] "float amount" 0.25
AttributeBegin
  Translate 1 0 0
  Rotate 30 0 1 0
  ConcatTransform [ 1 0 0 0 0 2 0 0 0 0 1 0 0 0 0 1 ]
  ReverseOrientation
  NamedMaterial "mix"
  Attribute "shape" "float alpha" 0.5
  Shape "sphere" "float radius" 0.5 "float zmin" -0.2 "float phimax" 200
  Shape "plymesh" "string filename" "a.ply"
AttributeEnd
AttributeBegin
  MediumInterface "fog" "smoke"
  Material "interface"
  Shape "sphere" "float radius" 2
AttributeEnd
Material "conductor" "spectrum eta" "metal-Au-eta" "spectrum k" "metal-Au-k" "float uroughness" 0.1
CoordinateSystem "here"
ObjectBegin "thing"
  Shape "trianglemesh" "point3 P" [ 0 0 0 1 0 0 0 1 0 ] "integer indices" [ 0 1 2 ] "point2 uv" [ 0 0 1 0 0 1 ]
  Shape "bilinearmesh" "point3 P" [ 0 0 0 1 0 0 0 1 0 1 1 1 ]
  Shape "loopsubdiv" "integer levels" 1 "point3 P" [ 0 0 0 1 0 0 0 1 0 ] "integer indices" [ 0 1 2 ]
  Shape "heightfield" "integer nu" 2 "integer nv" 2 "float Pz" [ 0 0 0 1 ]
ObjectEnd
ObjectInstance "thing"
CoordSysTransform "here"
Scale 2 2 2
ObjectInstance "thing"
TransformBegin
  Transform [ 1 0 0 0 0 1 0 0 0 0 1 0 0 3 0 1 ]
  AreaLightSource "diffuse" "rgb L" [ 5 5 5 ] "bool twosided" true "float power" 10
  Material "uber" "rgb Kd" [ 0.2 0.3 0.4 ] "rgb opacity" [ 0.5 0.5 0.5 ]
  Shape "disk" "float radius" 0.5 "float height" 1
TransformEnd
Include "part.pbrt"
"""
PART = 'Material "matte" "rgb Kd" [ 0.1 0.2 0.3 ]\nShape "cylinder" "float radius" 0.2\n'

TRIANGLE = 'Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "integer indices" [0 1 2]\n'


def read_text(tmp_path: Path, text: str) -> tuple[dict, ImportReport]:
    """The scene dict and the report of a whole file."""
    path = tmp_path / "scene.pbrt"
    path.write_text(text, "utf-8")
    report = ImportReport(path.name, SUPPORT)
    return read(path, tmp_path.resolve(), report), report


def read_world(tmp_path: Path, world: str, options: str = "") -> tuple[dict, ImportReport]:
    """The same of a file with the given text before and after WorldBegin."""
    return read_text(tmp_path, f"{options}\nWorldBegin\n{world}\n")


def objects(scene: dict, type_: str) -> list[dict]:
    """The objects of a type in a scene dict."""
    return [value for value in scene.values() if isinstance(value, dict) and value["type"] == type_]


def only(scene: dict, type_: str) -> dict:
    """The only object of a type."""
    (found,) = objects(scene, type_)
    return found


def material(tmp_path: Path, text: str, before: str = "") -> tuple[dict, ImportReport]:
    """The BSDF of a triangle under the given directive."""
    scene, report = read_world(tmp_path, f"{before}\n{text}\n{TRIANGLE}")
    return only(scene, "mesh")["bsdf"], report
