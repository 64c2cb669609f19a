"""The bounding volume hierarchy."""
