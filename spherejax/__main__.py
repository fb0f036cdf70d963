"""`python -m spherejax`: the command line, where the command itself is not on the path."""

import sys

from spherejax.cli import main

if __name__ == "__main__":
    sys.exit(main())
