"""Distinct names for objects and files. Used by the reader of pbrt files and by `convert`."""


class UniqueNames:
    """Numbers names that are asked for again. The time per name does not depend on how often it was asked for.

    Parameters
    ----------
    ignore_case : bool
        Whether names that differ only in case count as the same: some file systems do not distinguish them.
    """

    def __init__(self, ignore_case: bool = False):
        self._ignore_case = ignore_case
        self._numbers: dict[str, int] = {}  # the last number of each name that was given

    def add(self, stem: str, suffix: str = "") -> str:
        """`stem` + `suffix`, or `stem_2` + `suffix` and so on if that name was given before."""
        name, first_key = stem + suffix, self._key(stem + suffix)
        number = self._numbers.get(first_key, 1)
        while self._key(name) in self._numbers:
            number += 1
            name = f"{stem}_{number}{suffix}"
        self._numbers[self._key(name)] = 1
        self._numbers[first_key] = number
        return name

    def _key(self, name: str) -> str:
        return name.lower() if self._ignore_case else name
