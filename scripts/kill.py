"""Kills runs at random moments, starts them again, and checks that nothing is half-written and nothing is lost.

    python scripts/kill.py folder --kills 50 --seed 0
    python scripts/kill.py training --kills 50 --seed 0

SIGKILL, which no process can catch. Runs are repeated from an empty folder until there were so many kills; every one
must end with exactly the files of an undisturbed run.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "train"))

import numpy as np
import pytest
import trimesh
from train_cases import RECIPE, use_small_shapes

from gcnd.filters import Filter
from gcnd.many import denoise_many
from gcnd.mesh_io import load, save
from gcnd.train.corpus import generated_corpus
from gcnd.train.run import TrainingRun
from gcnd.weights.files import load_tensors

MESHES = ("a.ply", "b.obj", "c.stl", "d.off", "e.glb", "deep/f.ply", "deep/g.obj", "h.ply")

Files = dict[str, bytes]


def make_input(folder: Path) -> None:
    """Writes noisy meshes in every format."""
    for number, name in enumerate(MESHES):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        # By numpy: a process that has made noise with gcnd cannot be forked.
        heights = np.random.default_rng(number).normal(size=(len(mesh.vertices), 1))
        vertices = np.array(mesh.vertices) * (1.0 + 0.02 * heights)
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save((vertices, mesh.faces), folder / name)


def files_in(folder: Path) -> Files:
    """What is in a folder, by name."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


def is_hidden(name: str) -> bool:
    """Whether a file is one that no reader takes for a result."""
    return Path(name).name.startswith(".")


def run_folder(given: Path, out: Path) -> None:
    """A folder run; most of its time goes into writing, so that kills fall there."""
    outcomes = denoise_many(given, out, denoiser=Filter("laplacian", iterations=1))
    assert not any(outcome.status == "failed" for outcome in outcomes), outcomes


def check_folder(out: Path, reference: Files, *, is_done: bool) -> None:
    """Every result that is there is whole; at the end all are there, and nothing else."""
    found = files_in(out)
    whole = {name: data for name, data in found.items() if not is_hidden(name)}
    assert all(reference[name] == data for name, data in whole.items()), "a result is not whole"
    for name in whole:
        load(out / name)
    if is_done:
        assert found == reference, f"{sorted(found)} in place of {sorted(reference)}"


def run_training(_: Path, out: Path) -> None:
    """A tiny training run of two stages, with a checkpoint after every step."""
    with pytest.MonkeyPatch.context() as patched:
        use_small_shapes(patched)
        TrainingRun(out, RECIPE, generated_corpus(RECIPE, out, None), validate_every=2).run()


def check_training(out: Path, reference: Files, *, is_done: bool) -> None:
    """Every weights file and checkpoint can be read; at the end the weights are the same, bit for bit."""
    names = [name for name in files_in(out) if name.endswith(".safetensors") and not is_hidden(name)]
    for name in names:
        load_tensors(out / name)
    if is_done:
        found = files_in(out)
        leftovers = [name for name in found if is_hidden(name)]
        assert not leftovers, leftovers
        assert found.keys() == reference.keys(), f"{sorted(found)} in place of {sorted(reference)}"
        for name in names:
            assert found[name] == reference[name], f"{name} differs"


KINDS: dict[str, tuple[Callable[[Path, Path], None], Callable[..., None]]] = {
    "folder": (run_folder, check_folder),
    "training": (run_training, check_training),
}


def started(run: Callable[[Path, Path], None], given: Path, out: Path) -> int:
    """Starts a run in a process of its own; this one has started no threads, so that it may be doubled."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            run(given, out)
            code = 0
        except BaseException as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        finally:
            os._exit(code)
    return pid


def campaign(kind: str, n_kills: int, seed: int, home: Path) -> dict[str, int | float]:
    """Kills runs of one kind until there were so many kills; raises where something was lost."""
    run, check = KINDS[kind]
    given, straight = home / "in", home / "straight"
    given.mkdir()
    if kind == "folder":
        make_input(given)
    before, since = files_in(given), time.monotonic()
    assert os.waitstatus_to_exitcode(os.waitpid(started(run, given, straight), 0)[1]) == 0
    seconds, reference = time.monotonic() - since, files_in(straight)
    moments = random.Random(seed)
    kills = runs = left = 0
    while kills < n_kills:
        out, runs = home / f"out{runs}", runs + 1
        while True:
            pid = started(run, given, out)
            deadline = time.monotonic() + moments.uniform(0.0, 1.1 * seconds)
            ended = 0
            while not ended and time.monotonic() < deadline:
                ended, status = os.waitpid(pid, os.WNOHANG)
                time.sleep(0.001)
            if ended:
                assert os.waitstatus_to_exitcode(status) == 0, "a run after a kill failed"
                break
            os.kill(pid, signal.SIGKILL)
            _, status = os.waitpid(pid, 0)
            if os.waitstatus_to_exitcode(status) == 0:
                break  # it was faster
            kills += 1
            if out.exists():
                left += sum(map(is_hidden, files_in(out)))
                check(out, reference, is_done=False)
        check(out, reference, is_done=True)
        assert files_in(given) == before, "the input changed"
    return {"kills": kills, "runs": runs, "left_by_kills": left, "seconds_of_a_run": round(seconds, 2)}


def main() -> int:
    """Runs one campaign and prints what it did, as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        print(json.dumps(campaign(args.kind, args.kills, args.seed, Path(home)) | {"seed": args.seed}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
