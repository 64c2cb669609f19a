import numpy as np

from isonoise.strategies.allocation import distribute_in_proportion


def half_uniform(count, variance, budget, wave_index):
    """Half of the samples alike to all pixels, half in proportion to the variance of a sample."""
    variance = np.nan_to_num(variance, posinf=0.0)
    return distribute_in_proportion(variance + variance.mean(), budget, wave_index)
