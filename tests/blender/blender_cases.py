"""The Blender add-on's own modules, and a program in the place of the `gcnd` command, for its tests."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PLUGINS = ROOT / "plugins" / "blender"

sys.path.insert(0, str(PLUGINS))

MOVES = """
import sys
from pathlib import Path
import numpy as np
source, target = Path(sys.argv[2]), Path(sys.argv[3])
Path(__file__).with_name("folder.txt").write_text(str(source.parent))
data = source.read_bytes()
start = data.index(b"end_header\\n") + 11
n = int(data.split(b"element vertex ")[1].split()[0])
moved = np.frombuffer(data, "<f4", 3 * n, start) + np.float32(0.5)
print("normals, pass 1 of 2 (40% done)", file=sys.stderr, flush=True)
target.write_bytes(data[:start] + moved.tobytes() + data[start + 12 * n :])
"""
"""Moves every coordinate by 0.5, and notes in which folder it worked."""


def program(folder: Path, text: str) -> tuple[str, ...]:
    """Writes a program; returns the command that runs it."""
    path = folder / "program.py"
    path.write_text(text, encoding="utf-8")
    return (sys.executable, str(path))


def executable(folder: Path, *command: str) -> Path:
    """Writes one file that runs a command; for systems with a shell."""
    path = folder / "gcnd"
    path.write_text(f'#!/bin/sh\nexec {" ".join(command)} "$@"\n', encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path
