"""Values that `isonoise bench --tune` found to be the fastest, stored in the program cache per device and driver."""

import json

from isonoise.device import program_cache
from isonoise.device.drivers import driver_identity
from isonoise.input_files import parse_json


def load_tuned(device, name: str) -> object:
    """The value stored under this name; None if there is none or its file is damaged. The caller checks it."""
    content = program_cache.load(_key(device, name))
    try:
        return parse_json(content or b"{}")[name]
    except (ValueError, LookupError, TypeError):
        return None


def store_tuned(device, name: str, value: object) -> None:
    """Store a value, if the cache can be written; None removes the stored one."""
    if value is None:
        program_cache.remove(_key(device, name))
    else:
        program_cache.store(_key(device, name), json.dumps({name: value}).encode())


def _key(device, name: str) -> str:
    return program_cache.program_key(name, (), driver_identity(device))
