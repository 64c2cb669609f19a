"""Reads PLY files into scene dicts."""
