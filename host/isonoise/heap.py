"""Keeps freed memory in the process. Called by the command line and by workers, not by the library."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt(3)
_MAX_ARRAY_BYTES = 32 * 2**20  # the largest value that glibc takes
_MAX_FREE_BYTES = 2**28  # what a few waves of a large image need


def keep_freed_memory() -> None:
    """Let glibc keep the memory of freed arrays for the next ones; other C libraries are left as they are.

    By default glibc gives large arrays back to the system, which clears new pages for the arrays of the next wave:
    that took 27 of 87 ns per pixel and adaptive wave.
    """
    import ctypes  # takes some milliseconds, which `--help` does not need

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # no glibc
        return
    mallopt(_M_MMAP_THRESHOLD, _MAX_ARRAY_BYTES)
    mallopt(_M_TRIM_THRESHOLD, _MAX_FREE_BYTES)
