"""`python -m sysid` is the command `identify`."""

import sys

from sysid.command.cli import main

sys.exit(main())
