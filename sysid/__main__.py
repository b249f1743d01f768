"""`python -m sysid` is the command `identify`."""

import sys

from sysid.cli import main

sys.exit(main())
