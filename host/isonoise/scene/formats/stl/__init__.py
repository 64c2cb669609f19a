"""Reads STL files into scene dicts."""
