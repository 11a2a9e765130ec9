"""`python -m firmware_sim.concealed`."""

import sys

from firmware_sim.concealed.cli import main

if __name__ == "__main__":  # spawned worker processes import this module again
    sys.exit(main())
