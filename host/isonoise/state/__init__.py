"""The state of a render: everything that it is at a moment. Checkpoints, and merging renders of one scene."""

from isonoise.state.state import State

__all__ = ["State"]
