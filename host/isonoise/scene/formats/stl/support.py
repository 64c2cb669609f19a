"""How far STL is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import YES, Support

SUPPORT = {
    "triangles": Support(YES, "`mesh`"),
}
