"""C macros over the kinds of BSDF or light whose feature is on. Used by `bsdf_kinds` and `light_kinds`."""

from collections.abc import Iterable, Mapping


def any_feature(features: Iterable[str]) -> str:
    """A C condition: whether any of the features is on."""
    return " || ".join(f"FEATURE_{name}" for name in dict.fromkeys(features)) or "0"


def define_lists(entries: Mapping[str, tuple[str, str]], lists: Mapping[str, Iterable[str]]) -> list[str]:
    """C lines that define a macro LIST(DO) for every list: DO(arguments) for each of its entries that is on.

    Parameters
    ----------
    entries : name -> feature, arguments of DO
    lists : name of the macro -> names of its entries
    """
    lines = []
    for name, (feature, arguments) in entries.items():
        lines += [f"#if FEATURE_{feature}", f"#define FOR_{name}(DO) DO({arguments})"]
        lines += ["#else", f"#define FOR_{name}(DO)", "#endif"]
    lines += [f"#define {macro}(DO) {' '.join(f'FOR_{name}(DO)' for name in names)}" for macro, names in lists.items()]
    return lines
