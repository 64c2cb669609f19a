"""CompileCache: what a `Scene` keeps of its last compilation, so that a change does not compile everything again."""

from collections.abc import Callable, Hashable
from typing import TypeVar

import numpy as np

from isonoise.scene.accel.bvh import Bvh

T = TypeVar("T")


class CompileCache:
    """Meshes, BVH, images and environment map of the last compilation. Results are shared, so nobody may change them.

    `get` keeps a result as long as every compilation asks for it. `geometry` has the result for all shapes; it is kept
    until `forget_shapes`.
    """

    def __init__(self):
        self._last: dict[Hashable, object] = {}
        self._current: dict[Hashable, object] = {}
        self.geometry: object = None
        self._bvh: tuple[np.ndarray, Bvh] | None = None  # the vertices of its scene, and the tree

    def begin(self) -> None:
        """Begin a compilation: drop what the last one did not ask for."""
        self._last, self._current = self._current, {}

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The result with this key, made if there is none."""
        if key not in self._current:
            self._current[key] = self._last[key] if key in self._last else make()
        return self._current[key]

    def bvh(self, vertices: np.ndarray, build: Callable[[], Bvh]) -> Bvh:
        """The BVH of a scene that was compiled with this cache and has these vertices."""
        if self._bvh is None or self._bvh[0] is not vertices:
            self._bvh = vertices, build()
        return self._bvh[1]

    def forget_shapes(self) -> None:
        """Shapes have changed."""
        self.geometry = self._bvh = None

    def copy(self) -> "CompileCache":
        """One with the same results, for a copy of the scene."""
        copied = CompileCache()
        copied.__dict__.update(self.__dict__)
        copied._last, copied._current = dict(self._last), dict(self._current)
        return copied

    def __reduce__(self):
        return CompileCache, ()  # a scene that is sent to another process compiles there
