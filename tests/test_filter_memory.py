"""Peak memory of every filter grows with the faces, and no faster than docs/limits.md says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gcnd.filters import list_filters
from gcnd.memory import filter_bytes_a_face

ROOT = Path(__file__).parent.parent
BENCH = ROOT / "benches" / "filter_memory.py"
ROW = re.compile(r"^\| `([a-z0-9-]+)` \| ([\d,]+) \|(?: ([\d,]+) \|)?$", re.MULTILINE)

# The slow ones on less; the others need more, or what they take would drown in what the allocator keeps.
SIZES = {"l0": (4_000, 12_000), "tgv": (4_000, 12_000), "low-rank": (10_000, 30_000)}


def bounds() -> dict[str, float]:
    """MiB per million faces by filter, as the document has them."""
    text = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    return {name: float(bound.replace(",", "")) for name, _, bound in ROW.findall(text) if bound}


def test_every_filter_has_a_bound() -> None:
    assert set(bounds()) == {info.name for info in list_filters()}


def test_what_was_measured_is_less_than_what_is_foreseen() -> None:
    text = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    measured = {name: float(mib.replace(",", "")) for name, mib, bound in ROW.findall(text) if bound}
    assert set(measured) == {info.name for info in list_filters()}
    for name, mib in measured.items():  # at 50,000 to 200,000 faces
        assert mib * 2**20 / 1e6 < filter_bytes_a_face(name, 100_000), name


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
def test_memory_is_bounded() -> None:
    measured: dict[str, float] = {}
    names = list(bounds())
    groups = [([name for name in names if name not in SIZES], (20_000, 60_000))]
    groups += [([name], sizes) for name, sizes in SIZES.items()]
    for methods, sizes in groups:
        command = [sys.executable, str(BENCH), "--faces", *map(str, sizes), "--methods", *methods]
        told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
        measured |= {name: float(mib.replace(",", "")) for name, mib, _ in ROW.findall(told)}
    assert set(measured) == set(names)
    for name, bound in bounds().items():
        assert 50 < measured[name] < bound, f"{name}: {measured[name]:.0f} MiB per million faces"
