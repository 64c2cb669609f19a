"""The program `isonoise`, and `python -m isonoise`: `isonoise.cli.main`, with signals handled before other imports."""

import sys

from isonoise.signals import deferred, handle_signals


def main() -> int:
    """Run the command line of this process; return the exit code."""
    with handle_signals():
        with deferred():  # importing modules may lose a KeyboardInterrupt
            from isonoise import cli
        return cli.main()


if __name__ == "__main__":
    sys.exit(main())
