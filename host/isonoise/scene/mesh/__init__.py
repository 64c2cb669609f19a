"""Mesh file readers, and the surfaces made from meshes and analytic shapes."""
