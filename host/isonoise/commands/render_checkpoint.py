"""Checkpoints of `isonoise render`: continues from one, and writes them while the render runs and when it ends."""

import argparse
import os
from dataclasses import asdict, fields
from pathlib import Path

from isonoise.command_output import logger
from isonoise.errors import UserError
from isonoise.film.fallback import WrittenFile, write_elsewhere
from isonoise.film.files import PathLock, check_writable
from isonoise.film.log import LogRow, row_from_values
from isonoise.loop import Periodic, RenderLoop
from isonoise.renderer import Renderer
from isonoise.scene.view import View
from isonoise.state.state import State, split_strategy_state
from isonoise.strategies.registry import is_built_in

_OPTIONS = ("seed", "strategy", "sampler", "size", "max_depth", "parameters", "layers")
_OPTIONS += tuple(field.name for field in fields(View))
"""Options that a continued render takes from the checkpoint if they are not given."""
_LIMITS = ("spp", "time", "error")
_DEFAULTS = {"seed": 0, "parameters": [], "layers": (), "quantile": 0.99, "confidence": 0.95}


class Checkpoints:
    """The checkpoint file of a render.

    Parameters
    ----------
    options : Namespace
        Options of the command. Those that were not given are set to those of the checkpoint that is continued, or else
        to their defaults.

    Attributes
    ----------
    state : State or None
        The state to continue from, until the first new one is taken.

    Raises
    ------
    UserError
        If the file to continue from cannot be read, or the one to write cannot be written or holds another render.
    """

    def __init__(self, options: argparse.Namespace):
        self.path: str | None = options.checkpoint or options.resume
        self._interval_s = options.checkpoint_every
        self._lock = self._writer = self._last_state = None
        self._has_warned = False
        self.state: State | None = None
        is_same = bool(options.resume and self.path) and Path(options.resume).resolve() == Path(self.path).resolve()
        if options.resume and not (is_same and options.checkpoint and not Path(options.resume).exists()):
            from isonoise.state.checkpoint import read_checkpoint  # a render without checkpoints starts faster

            self.state = read_checkpoint(options.resume)
        if options.checkpoint and os.path.lexists(options.checkpoint) and not is_same:
            raise UserError(f"--checkpoint {self.path} exists; continue it with --resume {self.path}, or remove it")
        if self.path:
            self._lock = PathLock(check_writable(self.path))
            from isonoise.state.checkpoint_writer import CheckpointWriter

            self._writer = CheckpointWriter(self.path)
        _complete(options, self.state)

    @property
    def rows(self) -> list[LogRow]:
        """The log of the render before it is continued."""
        loop = self.state.values.get("loop", {}) if self.state else {}
        return [row_from_values(row) for row in loop.get("rows", ())]

    def check(self, renderer: Renderer) -> None:
        """Raise UserError if the strategy keeps something that no checkpoint can hold. Warns of another device."""
        if self.path:
            split_strategy_state(renderer.strategy.name, renderer.strategy.state())
            _ = renderer.settings  # hashes the files of the scene: they may change while it is rendered
        before = self.state.settings.get("device") if self.state else None
        device = ", ".join(renderer.devices)
        if before not in (None, device):
            logger.warning(f"the render was begun on {before}; its last bits may differ on {device}")

    def periodic(self) -> list[Periodic]:
        """What the render loop does at intervals."""
        return [Periodic(self._interval_s, self.keep)] if self.path else []

    def keep(self, loop: RenderLoop) -> None:
        """Begin to write the state of a render, unless it has no samples; `end` completes the last one."""
        if self.path and loop.renderer.samples:
            self._save(loop)

    def end(self) -> WrittenFile | None:
        """Wait for the last checkpoint, which goes to another place if it cannot be written; None if there is none."""
        if self._last_state is None:
            return None
        state, self._last_state = self._last_state, None
        try:
            self._writer.finish()
            return WrittenFile(self.path)
        except UserError as error:
            from isonoise.state.checkpoint import write_checkpoint

            return write_elsewhere(self.path, lambda path: write_checkpoint(path, state), error)

    def close(self) -> None:
        """Let other processes write the file."""
        if self._lock:
            self._lock.release()

    def _save(self, loop: RenderLoop) -> None:
        """Begin to write a state. The render goes on if the one before could not be written."""
        try:
            self._writer.finish()
        except UserError as error:
            if not self._has_warned:
                logger.warning(f"{error}; the render goes on without checkpoints until one can be written")
            self._has_warned = True
        reuse = self._last_state or self.state  # a continued render has taken over what it needs of it
        self._last_state = self.state = None
        self._last_state = loop.state(reuse)
        self._writer.begin(self._last_state)


def _complete(options: argparse.Namespace, state: State | None) -> None:
    """Set the options that were not given."""
    if state is not None and "loop" in state.values:
        stored = state.settings["overrides"] | {name: state.settings[name] for name in ("seed", "strategy", "layers")}
        if options.strategy is None and not is_built_in(stored["strategy"]):
            raise UserError(
                f"--resume {options.resume}: the strategy '{stored['strategy']}' is no part of isonoise, and a file "
                "does not choose which code runs; name it again with --strategy"
            )
        stored |= asdict(View(**{field.name: stored["view"][field.name] for field in fields(View)}))
        for name in _OPTIONS:
            if getattr(options, name) is None:
                value = stored[name]
                setattr(options, name, list(value.items()) if name == "parameters" else value)
        limits = state.values["loop"]["stops"]
        names = ("quantile", "confidence")
        if not any(getattr(options, name) for name in _LIMITS):
            names = (*names, *_LIMITS)
        for name in names:
            if getattr(options, name) is None:
                setattr(options, name, limits[name])
    for name, default in _DEFAULTS.items():
        if getattr(options, name) is None:
            setattr(options, name, default)
