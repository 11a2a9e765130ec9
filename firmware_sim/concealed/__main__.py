"""`python -m firmware_sim.concealed`."""

import sys

from firmware_sim.concealed.cli import main

if __name__ == "__main__":  # the makers of cases import this again
    sys.exit(main())
