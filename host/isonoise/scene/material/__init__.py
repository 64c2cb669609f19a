"""BSDFs, textures and media as device records."""
