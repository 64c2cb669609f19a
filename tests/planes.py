"""What the stages read and write for each path, as kernels/path/path_state.h keeps it: planes."""

import numpy as np

from isonoise.device.opencl import Device


def as_planes(rows: np.ndarray) -> np.ndarray:
    """Records (n, k) as k planes of n numbers: for a pool of n paths."""
    return np.ascontiguousarray(rows.T)


def read_rows(device: Device, buffer, n: int, k: int) -> np.ndarray:
    """Records (n, k) float32 of a pool of n paths."""
    return np.ascontiguousarray(device.read(buffer, np.float32, n * k).reshape(k, n).T)
