"""The strategy `uniform`: the same number of samples in every pixel."""

from collections.abc import Iterator

from isonoise.strategies.base import Strategy, Wave
from isonoise.strategies.parameter_checks import check_range
from isonoise.strategies.schedule import uniform_waves


class Uniform(Strategy):
    """The same number of samples in every pixel. It plans no adaptive wave, so `allocate` is never called.

    - `wave_spp`: samples per pixel of every wave; 0 (the default) lets the waves grow with the samples so far.
    - `warmup`: samples per pixel of the first wave, 1 to 65536.
    - `growth`: later waves bring this many times the samples so far, 0.01 to 4.
    """

    name = "uniform"

    def __init__(self, *, wave_spp: int = 0, warmup: int = 16, growth: float = 0.25):
        check_range("wave_spp", wave_spp, 0, 2**20)
        check_range("warmup", warmup, 1, 65536)
        check_range("growth", growth, 0.01, 4)
        self.wave_spp, self.warmup, self.growth = wave_spp, warmup, growth

    def waves(self) -> Iterator[Wave]:
        if self.wave_spp == 0:
            yield from uniform_waves(self.warmup, self.growth)
        while True:
            yield Wave("uniform", self.wave_spp)
