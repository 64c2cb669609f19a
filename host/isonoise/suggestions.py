"""The known name that is most similar to a wrong one, for error messages."""

from collections.abc import Collection
from difflib import get_close_matches

_MAX_COMPARED_CHARS, _MAX_COMPARED_NAMES = 60, 1000  # comparing names takes time quadratic in their length


def closest_name(name: str, known: Collection[str]) -> str:
    """The known name that is most similar to `name`; '' if none is similar or there are too many."""
    ordered = sorted(known) if len(known) <= _MAX_COMPARED_NAMES else ()
    by_key = {each[:_MAX_COMPARED_CHARS].lower(): each for each in ordered}
    match = get_close_matches(name[:_MAX_COMPARED_CHARS].lower(), list(by_key), n=1)
    return by_key[match[0]] if match else ""


def suggestion(name: str, known: Collection[str]) -> str:
    """The end of a message about an unknown name: ` (did you mean '...'?)`, or '' if no known name is similar."""
    hint = closest_name(name, known)
    return f" (did you mean '{hint}'?)" if hint else ""
