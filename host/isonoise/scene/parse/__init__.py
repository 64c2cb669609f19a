"""From scene files and dicts to a checked description."""
