"""Ranges of numbers that users give, on the command line, in scene files and in Python."""

MIN_STOP, MAX_STOP = 1e-30, 1e30
"""Limits of a render: samples per pixel, seconds, errors. Their squares and their products with pixels stay finite."""
MAX_PIXELS = 1 << 28
"""Largest image. Beyond it the statistics alone need over 10 GiB, so the size is most likely a mistake."""
MAX_DEPTH = 2**31 - 1
"""Largest number of path segments."""
