import numpy as np

import isonoise


def half_uniform(count, variance, budget, wave_index):
    """Half of the samples alike to all pixels, half in proportion to the variance of a sample."""
    variance = np.nan_to_num(variance, posinf=0.0)
    return isonoise.allocation.distribute_in_proportion(variance + variance.mean(), budget, wave_index)
