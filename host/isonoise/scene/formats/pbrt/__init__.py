"""Reads pbrt-v4 files into scene dicts."""
