"""Compiles bsdfs, textures and media to device records."""
