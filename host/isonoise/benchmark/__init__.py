"""Benchmarks: a scene measured kernel by kernel, compared with an earlier measurement, or with other renderers."""
