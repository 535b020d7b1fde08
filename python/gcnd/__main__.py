"""Runs the command line as `python -m gcnd`."""

from gcnd.cli import program

if __name__ == "__main__":
    program()
