"""Comparisons: the same scenes by several strategies and seeds, measured against references."""
