"""The strategy `oracle`: the variance of every pixel is read from a file. For experiments."""

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from isonoise.errors import UserError
from isonoise.input_files import open_regular_file
from isonoise.statistics import Statistics
from isonoise.strategies.adaptive import AdaptiveBase
from isonoise.strategies.parameters import ranged

LAYER = "variance"


@dataclass(kw_only=True, eq=False)
class Oracle(AdaptiveBase):
    """Measure: the relative error, with variances from an independent long run: the bound for unbiased strategies.

    Parameters
    ----------
    file : str
        An .exr file with a float layer `variance`: for every pixel n times the variance of the mean luminance of n
        samples, over max(mean, floor)^2. `isonoise compare` makes one if the strategy is named without a file.

    Further parameters: those of `AdaptiveBase`.
    """

    name = "oracle"

    file: str
    clip: float = ranged(1.0, 0.5, 1)

    def state(self) -> dict[str, object]:
        return {}  # the variances are in the file

    def __getstate__(self) -> dict[str, object]:
        return vars(self) | {"_variance": self._variance}  # for another machine, which lacks the file

    @cached_property
    def _variance(self) -> np.ndarray:
        import OpenEXR

        try:
            open_regular_file(self.file).close()
            with OpenEXR.File(os.fsencode(self.file)) as file:
                return file.channels()[LAYER].pixels.astype(np.float64)
        except KeyError:
            raise UserError(f"strategy oracle: '{self.file}' has no layer '{LAYER}'") from None
        except OSError as error:
            raise UserError(f"strategy oracle: cannot read '{self.file}': {error.strerror}") from error
        except Exception as error:  # the binding raises bare RuntimeErrors
            raise UserError(f"strategy oracle: cannot read '{self.file}': {error}") from error

    def variance(self, statistics: Statistics, floor: float) -> np.ndarray:
        if self._variance.shape != statistics.shape:
            sizes = ["x".join(map(str, shape[::-1])) for shape in (self._variance.shape, statistics.shape)]
            raise UserError(f"strategy oracle: '{self.file}' is {sizes[0]} and the image {sizes[1]}")
        return self._variance.copy()
