"""Grids of values in space, for heterogeneous media. Imported only where a scene has them."""


def is_volume(value) -> bool:
    """Whether the value of a parameter of a medium is a volume, not a constant."""
    return isinstance(value, dict) and value["type"] in ("constvolume", "gridvolume")
