import numpy as np

from isonoise import Strategy, Wave


class Proportional(Strategy):
    name = "proportional"

    def waves(self):
        while True:
            yield Wave("uniform", 8)
            yield Wave("adaptive", 8)

    def allocate(self, statistics, budget):
        share = np.cumsum(np.sqrt(statistics.variance) + np.finfo(float).tiny)
        edges = np.rint(budget * share / share[-1])
        return np.diff(edges, prepend=0).astype(np.uint32).reshape(statistics.shape)
