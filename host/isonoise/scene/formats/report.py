"""What an imported file contains, and what of it is not mapped. Readers fill in a report; `isonoise info` prints it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from isonoise.scene.formats.support import FEATURES, NO, Support

_MAX_PLACE_CHARS = 60


@dataclass
class ImportReport:
    """Counts, used features and losses of one file. A reader calls `count`, `use` and `limit`."""

    file: str
    support: Mapping[str, Support]  # of the file's format, by feature
    counts: dict[str, int] = field(default_factory=dict)  # by plural noun, such as 'meshes', in the order of reading
    used: dict[str, int] = field(default_factory=dict)  # feature -> how often the file uses it
    losses: dict[tuple[str, str], dict[str, None]] = field(default_factory=dict)  # (feature, problem) -> places

    def count(self, noun: str, number: int = 1) -> None:
        """Add to the number of objects of a kind that the file contains."""
        self.counts[noun] = self.counts.get(noun, 0) + number

    def use(self, feature: str, place: str = "") -> None:
        """Note that the file uses a feature. If the format's table says `NO`, it is a loss."""
        self.used[feature] = self.used.get(feature, 0) + 1
        if self.support[feature].status == NO:
            self.limit(feature, self.support[feature].note, place)

    def limit(self, feature: str, problem: str, place: str = "") -> None:
        """Note that something of the file is left out or approximated, so that the image differs."""
        self.used.setdefault(feature, 1)
        self.losses.setdefault((feature, problem), {})[place] = None

    def rows(self) -> list[tuple[str, str]]:
        """(label, text): what was found, the features that are mapped exactly, and a row for each loss."""
        lossy = {feature for feature, _ in self.losses}
        exact = [feature for feature in FEATURES if feature in self.used and feature not in lossy]
        notes = {feature: self.support[feature].note for feature in exact if feature in self.support}
        plain = ", ".join(FEATURES[feature] for feature in exact if not notes.get(feature))
        mapped = [plain] * bool(plain)
        mapped += [f"{FEATURES[feature]}: {note}" for feature, note in notes.items() if note]
        rows = [("found", ", ".join(f"{number:,} {_noun(noun, number)}" for noun, number in self.counts.items()))]
        rows += _labelled("mapped", mapped or ["nothing exactly"])
        return rows + _labelled("not exact", self.loss_texts())

    def warnings(self) -> list[str]:
        """One text for each feature and problem, with the number of places and the first one."""
        return [f"{self.file}: {text}" for text in self.loss_texts()]

    def loss_texts(self) -> list[str]:
        """The texts of `warnings` without the file's name."""
        return [f"{FEATURES[feature]}{_where(places)}: {problem}" for (feature, problem), places in self.losses.items()]


def _labelled(label: str, texts: list[str]) -> list[tuple[str, str]]:
    """The texts, with the label before the first one."""
    return list(zip([label, *[""] * len(texts)], texts, strict=False))


def _noun(plural: str, number: int) -> str:
    """The noun for a number; `plural` may have more after ' of '."""
    word, of, rest = plural.partition(" of ")
    if number == 1:
        ending, singular = next(
            pair
            for pair in (("ies", "y"), ("ches", "ch"), ("shes", "sh"), ("media", "medium"), ("s", ""), ("", ""))
            if word.endswith(pair[0])
        )
        word = word.removesuffix(ending) + singular
    return word + of + rest


def _where(places: dict[str, None]) -> str:
    named = [" ".join(place.split())[:_MAX_PLACE_CHARS] for place in places if place]
    if not named:
        return ""
    return f" of {named[0]}" if len(places) == 1 else f" of {named[0]} and {len(places) - 1} more"
