"""Reads glTF 2.0 files into scene dicts."""
