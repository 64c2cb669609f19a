"""The bounding volume hierarchy (BVH)."""
