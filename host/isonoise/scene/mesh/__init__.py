"""Meshes and analytic shapes: file readers, and the arrays made of them."""
