"""`python -m firmware_sim CONFIG`."""

import sys

from firmware_sim.cli import main

sys.exit(main())
