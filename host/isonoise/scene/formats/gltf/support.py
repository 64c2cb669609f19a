"""How far glTF 2.0 is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import YES, Support

SUPPORT = {
    "triangles": Support(YES, "`mesh`"),
}
