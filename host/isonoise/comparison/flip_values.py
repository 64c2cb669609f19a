"""FLIP of the final images of a comparison's runs, kept in flip.json because it takes seconds per image.

Called by `summary` if the comparison's metrics include `flip`; read by `tidy_tables`.
"""

import json
from functools import lru_cache
from pathlib import Path

from isonoise.comparison.checked_files import file_digest
from isonoise.comparison.image_metrics import flip
from isonoise.comparison.results import Results, Run
from isonoise.film.files import write_atomically
from isonoise.input_files import read_json
from isonoise.progress import ProgressBar

FLIP_FILE = "flip.json"


class FlipValues:
    """FLIP by the SHA-256 of the run's file, which depends on the run's reference as well."""

    def __init__(self, directory: Path):
        self._path = Path(directory) / FLIP_FILE
        self._values = _read_values(self._path)

    def get(self, run: Run) -> float | None:
        """The mean FLIP of a run's final image; None if it is not computed."""
        return self._values.get(file_digest(run.path))

    def update(self, results: Results) -> None:
        """Compute the missing values and write the file, also when it is interrupted.

        Raises UserError if flip-evaluator is not installed, or the file cannot be written.
        """
        runs = [(scene, run) for scene in results.plan.scenes for run in results.all_runs(scene)]
        digests = {run.path: file_digest(run.path) for _, run in runs}
        reference = lru_cache(1)(results.reference)
        known, self._values = self._values, {}
        try:
            with ProgressBar() as bar:
                for done, (scene, run) in enumerate(runs):
                    bar.show(done, len(runs), "FLIP")
                    digest = digests[run.path]
                    value = known.get(digest)
                    self._values[digest] = flip(run.rgb, reference(scene).rgb) if value is None else value
        finally:
            values = {digest: known[digest] for digest in digests.values() if digest in known} | self._values
            text = json.dumps(values, indent=1, sort_keys=True) + "\n"
            write_atomically(self._path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _read_values(path: Path) -> dict[str, float]:
    """What an earlier `update` has written; empty if the file is missing or damaged: the values are computed again."""
    try:
        values = read_json(path)
    except (OSError, ValueError):
        return {}
    if not isinstance(values, dict) or not all(isinstance(value, float) for value in values.values()):
        return {}
    return values
