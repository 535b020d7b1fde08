"""The command line: parse, call, print.

Each command lives in its own module and imports what it needs when it runs, so that `gcnd --help` is quick.
"""

from __future__ import annotations

from gcnd.cli.app import app, main, program

__all__ = ["app", "main", "program"]
