"""`python -m piezod` is the same as `piezod`."""

from piezod.cli import main

if __name__ == "__main__":
    main()
