"""Longest time for which a filter tells nothing and cannot be stopped, at its defaults on a noisy torus.

    python benches/filter_silence.py [--faces 100000] [--methods l0 tgv] [--until 0.1]

Seconds on the clock and of the processor, which other work beside it does not lengthen and threads add up in; and how
far the filter was when it fell silent. What comes before the filter, which tells of itself, is left out.
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise

from filter_memory import noisy_torus

from gcnd import Cancelled
from gcnd.filters import apply_filter, list_filters


def longest_silence(method: str, n_faces: int, until: float) -> tuple[float, float, float]:
    """Seconds on the clock and of the processor between two calls of ``progress``, and how far it was at the first."""
    calls: list[tuple[float, float, float]] = []

    def told(fraction: float, _: str) -> bool:
        calls.append((time.perf_counter(), time.process_time(), fraction))
        return fraction < until

    try:
        apply_filter(noisy_torus(n_faces), method, progress=told)
    except Cancelled:
        print(f"{method} stopped at {calls[-1][2]:.0%}")
    gaps = [(b[0] - a[0], b[1] - a[1], a[2]) for a, b in pairwise(calls)]
    return max(gaps, key=lambda gap: gap[1])


def main() -> None:
    """Prints a line for each filter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [info.name for info in list_filters()]
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--methods", nargs="+", choices=names, default=names, metavar="NAME")
    parser.add_argument("--until", type=float, default=1.1, help="Fraction at which to stop.")
    options = parser.parse_args()
    for method in options.methods:
        clock, processor, fraction = longest_silence(method, options.faces, options.until)
        print(f"{method}: {clock:.2f} s, {processor:.2f} s of the processor, at {fraction:.1%}", flush=True)


if __name__ == "__main__":
    main()
