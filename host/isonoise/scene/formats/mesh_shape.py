"""The scene dicts of meshes in memory, which readers of several formats share."""

from collections.abc import Mapping

from isonoise.scene.mesh.mesh import Mesh


def mesh_shape(mesh: Mesh, bsdf: Mapping, face_normals: bool = False, to_world=None) -> dict:
    """A shape of type `mesh` with everything that the mesh has.

    Parameters
    ----------
    mesh : v = 0 of its texture coordinates is the top row of an image
    bsdf : its dict, shared by all shapes that get the same object
    face_normals : shade flat, whether or not there are vertex normals
    to_world : (4, 4); None: the vertices are in world space
    """
    shape = {
        "type": "mesh",
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "face_normals": face_normals,
        "bsdf": bsdf,
    }
    if to_world is not None:
        shape["to_world"] = to_world
    if len(mesh.normals):
        shape["normals"] = mesh.normals
    if len(mesh.uvs):
        shape["texcoords"] = mesh.uvs
    if mesh.attributes:
        shape["attributes"] = mesh.attributes
    return shape


def rgb(value) -> dict:
    """A linear RGB colour of a scene dict."""
    return {"type": "rgb", "value": [float(channel) for channel in value]}
