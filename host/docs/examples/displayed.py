import numpy as np

import isonoise


def displayed_error(statistics, floor):
    """Standard error of the displayed value L^(1/2.2), by its slope at the mean."""
    slope = np.maximum(statistics.mean, floor) ** (1 / 2.2 - 1) / 2.2
    return isonoise.measures.standard_error(statistics) * slope
