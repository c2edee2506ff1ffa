"""`python -m freeflyer`: the command `freeflyer`."""

import sys

from freeflyer.cli.main import main

sys.exit(main())
