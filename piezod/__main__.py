"""`python -m piezod` is the same as `piezod`: nothing is imported from the current folder, unless piezod itself is."""

import os
import sys

if not sys.flags.safe_path and sys.path[0] not in ("", os.path.dirname(os.path.dirname(__file__))):  # noqa: PTH120  # before any import
    del sys.path[0]

from piezod.cli import main

if __name__ == "__main__":
    main()
