"""`python -m isonoise` is the same as the command `isonoise`."""

import sys

from isonoise.cli import main

sys.exit(main())
