"""`python -m firmware_sim CONFIG`: serves the emulated bench."""

import sys

from firmware_sim.cli import main

sys.exit(main())
