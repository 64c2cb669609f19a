"""`python -m isonoise` runs the command `isonoise`."""

import sys

from isonoise.cli import main

sys.exit(main())
