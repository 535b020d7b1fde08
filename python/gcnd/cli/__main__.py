"""Runs the command line as `python -m gcnd.cli`."""

import sys

from gcnd.cli import main

if __name__ == "__main__":
    sys.exit(main())
