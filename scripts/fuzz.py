"""Runs many random cases against every entry of the package, and says how many, and how to repeat one that fails.

    python scripts/fuzz.py --cases 1000 --seed 0
    python scripts/fuzz.py --only "file: ply" --seed 0 --first 4711 --cases 1

Every entry runs in a process of its own with bounded memory; one that dies, hangs or fails is reported with the case.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "safety"))

GIB = 1 << 30
MEMORY = 3 * GIB
"""Address space a process may take beyond what it has when the cases begin."""

SECONDS = 120.0
"""What one case may take."""

SHOWN = 5


def run_entry(name: str, args: argparse.Namespace, told: Any, at: Any) -> None:
    """Runs the cases of one entry; tells (accepted, failures)."""
    import torch
    from fuzz_cases import run_case

    torch.set_num_threads(1)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    accepted, failures = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(args.first, args.first + args.cases):
            at.value = number
            try:
                accepted += run_case(name, args.seed, number, Path(folder))
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                failures.append((number, "".join(traceback.format_exception(error)[-4:])))
                if len(failures) >= SHOWN:
                    break
    told.put((accepted, failures))


def watch(name: str, args: argparse.Namespace) -> tuple[str, bool]:
    """Runs one entry in a process of its own; returns what to print, and whether all was well."""
    # What the parent has imported need not be imported again; it has started no threads.
    context = multiprocessing.get_context("fork")
    told, at = context.Queue(), context.Value("q", -1)
    process = context.Process(target=run_entry, args=(name, args, told, at))
    process.start()
    last, since = -1, time.monotonic()
    # The queue is read first: a process does not end before what it tells has been taken.
    result = None
    while result is None and process.is_alive():
        if not told.empty():
            result = told.get()
            break
        time.sleep(0.05)
        if at.value != last:
            last, since = at.value, time.monotonic()
        elif last >= 0 and time.monotonic() - since > SECONDS:
            process.kill()
            process.join()
            return f"case {last} took longer than {SECONDS:g} s", False
    process.join(5)
    if result is None and not told.empty():
        result = told.get()
    if result is None:
        return f"the process died with exit code {process.exitcode} in case {at.value}", False
    accepted, failures = result
    if failures:
        shown = "\n".join(f"case {number}:\n{text}" for number, text in failures)
        return f"FAILED\n{shown}", False
    return f"{args.cases} cases, {accepted} accepted", True


def main() -> int:
    """Runs the entries that were asked for, and exits with 1 if a case failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000, help="for each entry")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", default="", help="entries whose name begins so")
    args = parser.parse_args()
    from fuzz_cases import CASES

    names = [name for name in CASES if name.startswith(args.only)]
    started, all_well = time.monotonic(), True
    for name in names:
        since = time.monotonic()
        text, is_well = watch(name, args)
        all_well &= is_well
        print(f"{name:32} {time.monotonic() - since:7.1f} s  {text}", flush=True)
    total = args.cases * len(names)
    print(
        f"{total} cases, seed {args.seed}, {time.monotonic() - started:.0f} s: {'all well' if all_well else 'FAILED'}"
    )
    return 0 if all_well else 1


if __name__ == "__main__":
    sys.exit(main())
