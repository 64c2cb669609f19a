"""Parses scene files and dicts, and checks them against the vocabulary."""
