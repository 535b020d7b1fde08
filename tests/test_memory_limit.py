"""docs/limits.md says how much memory a mesh takes: measured here at two sizes, in processes of their own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gcnd.memory import BYTES_A_FACE, BYTES_OF_FACTORS, needed_bytes

LIMITS = (Path(__file__).parent.parent / "docs" / "limits.md").read_text(encoding="utf-8")

MARGIN = 1.1
"""Of other versions of what is linked, and of the system's pages."""

MEASURE = """
import sys
from pathlib import Path
import torch
import gcnd
from sheet_cases import even_sheet, with_noise

torch.set_num_threads(2)
side, preset = int(sys.argv[1]), sys.argv[2]
vertices, faces = even_sheet(side)
clean = gcnd.denoise((with_noise(vertices, 0), faces), preset=preset)[0]
assert abs(clean - vertices).max() < 1.0
# Of getrusage, a process inherits the most that its parent held.
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
# Of the libraries' code the system maps what it likes: the file system and its pages decide, not the mesh.
peak, code = (int(status[entry].split()[0]) for entry in ("VmHWM", "RssFile"))
print(len(faces), (peak - code) * 1024)
"""


def stated(pattern: str) -> float:
    found = re.search(pattern, LIMITS)
    assert found is not None, pattern
    return float(found[1].replace(",", ""))


def measured(side: int, preset: str) -> tuple[int, int]:
    """Faces of a sheet and the most bytes beside the code of libraries that the process of denoising it held."""
    environment = os.environ | {"RAYON_NUM_THREADS": "2", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, str(side), preset],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    faces, peak = done.stdout.split()
    return int(faces), int(peak)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of peak memory in kibibytes")
@pytest.mark.parametrize(("preset", "sides"), [("fast", (90, 250)), ("default", (50, 130))])
def test_a_mesh_takes_no_more_than_is_stated(preset: str, sides: tuple[int, int]) -> None:
    (few, small), (many, large) = (measured(side, preset) for side in sides)
    program = stated(r"([\d.]+) GiB for the program and the network") * 2**30
    a_face = stated(r"and ([\d,]+) bytes a face")
    for faces, peak in ((few, small), (many, large)):
        assert peak < MARGIN * (program + a_face * faces), f"{faces} faces took {peak / 2**20:.0f} MiB"
    # A program that takes next to nothing was not measured.
    assert large > 0.3 * program


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of peak memory in kibibytes")
@pytest.mark.skipif("GCND_LARGE" not in os.environ, reason="takes some minutes and 6 GB: make test-large")
def test_ten_million_faces_take_less_than_six_gigabytes() -> None:
    faces, peak = measured(2237, "fast")
    assert faces > 10_000_000
    assert peak < 6e9, f"{faces:,} faces took {peak / 1e9:.1f} GB beside the code"


def test_what_is_foreseen_is_what_is_stated() -> None:
    for method, bytes_a_face in BYTES_OF_FACTORS.items():
        assert stated(rf"`{method}` at ([\d,]+) bytes a face") == bytes_a_face
    assert stated(r"estimated at ([\d,]+) bytes a face") == BYTES_A_FACE
    assert stated(r"plus ([\d,]+) for a vertex beyond") == needed_bytes(7, 12) - needed_bytes(6, 12)
    # More than was measured, so that no mesh is begun that does not fit.
    assert 1.2 * stated(r"and ([\d,]+) bytes a face") < BYTES_A_FACE
    gibibytes = stated(r"([\d.]+) GiB for a million faces")
    assert gibibytes == pytest.approx(stated(r"and ([\d,]+) bytes a face") * 1e6 / 2**30, abs=0.005)
