"""`python -m gcnd.train`: the same as `gcnd train`, for torchrun, which starts modules."""

from __future__ import annotations

import sys

from gcnd.cli.app import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
