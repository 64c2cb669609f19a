"""The strategy `uniform`: the same number of samples in every pixel."""

from collections.abc import Iterator
from dataclasses import dataclass

from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameters import ranged
from isonoise.strategies.schedule import uniform_waves


@dataclass(kw_only=True, eq=False)
class Uniform(Strategy):
    """The same number of samples in every pixel. It plans no adaptive wave, so `allocate` is never called.

    Parameters
    ----------
    wave_spp : int
        Samples per pixel of every wave; 0 lets the waves grow with the samples so far.
    warmup : int
        Samples per pixel of the first wave, 1 to 65536.
    growth : float
        Later waves have this many times the samples so far, 0.01 to 4.
    """

    name = "uniform"
    is_adaptive = False

    wave_spp: int = ranged(0, 0, 2**20)
    warmup: int = ranged(16, 1, 65536)
    growth: float = ranged(0.25, 0.01, 4)

    def waves(self) -> Iterator[Wave]:
        if self.wave_spp == 0:
            yield from uniform_waves(self.warmup, self.growth)
        while True:
            yield Wave("uniform", self.wave_spp)
