"""How far STL is supported: see `formats/support.py`."""

from isonoise.scene.formats.support import PARTLY, YES, Support

SUPPORT = {
    "triangles": Support(YES, "`mesh` with flat shading, for all solids of a file; binary and ASCII"),
    "vertex_colours": Support(PARTLY, "colours of facets in binary files (VisCAM, Magics); not in ASCII files"),
}
