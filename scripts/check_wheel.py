"""Checks a wheel: what is in it, and that it denoises a mesh in an empty environment of every Python at hand.

    python scripts/check_wheel.py dist/*.whl                          # every python3.10 to python3.13 on the path
    python scripts/check_wheel.py dist --python /opt/py312/bin/python --python python3.13
    python scripts/check_wheel.py dist --install                      # this Python, all dependencies installed

The network needs torch, which is large. So that it is not fetched for every Python, an environment of this Python's
version borrows what is installed here; the others get all but torch, and run the compiled module through a classical
filter. ``--install`` installs everything into an empty environment instead.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "python" / "gcnd"
VERSIONS = ("3.10", "3.11", "3.12", "3.13")
WITHOUT_TORCH = (
    "numpy>=1.26",
    "trimesh>=4.5",
    "scipy>=1.11",
    "safetensors>=0.4.5",
    "typer>=0.15",
    "rich>=13",
    "filelock>=3.12",
)
LICENCES = ("LICENSE-MIT", "LICENSE-APACHE", "THIRD-PARTY-LICENSES", "python/gcnd/viewer/three/LICENSE")
COMPILED = ("gcnd/_geom.abi3.so", "gcnd/_geom.pyd")

PROGRAM = """
import sys
from pathlib import Path
import numpy as np
import gcnd
from gcnd.data.noise import add_noise
from gcnd.mesh_io import load, save
import trimesh

assert Path(gcnd.__file__).is_relative_to(sys.prefix), gcnd.__file__
truth = trimesh.creation.icosphere(subdivisions=3)
noisy = add_noise(truth.vertices, truth.faces, level=0.3, seed=1)
save((noisy, truth.faces), "noisy.ply")
np.save("truth.npy", truth.vertices)
"""
MEASURE = """
import sys
import numpy as np
from gcnd.mesh_io import load
from gcnd.metrics import normal_error

truth, noisy, clean = np.load("truth.npy"), load("noisy.ply"), load("clean.ply")
assert (noisy.faces == clean.faces).all()
before, after = (normal_error(mesh.vertices, truth, mesh.faces) for mesh in (noisy, clean))
print(f"Python {sys.version.split()[0]}: E_a {before:.1f} -> {after:.1f} degrees, {sys.argv[1]}")
sys.exit(not after < before / 2)
"""


def source_files(package: Path) -> set[str]:
    """Names in a wheel of the package's own files, compiled ones left out."""
    return {
        f"gcnd/{path.relative_to(package).as_posix()}"
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.suffix not in (".so", ".pyd")
    }


def problems(wheel: Path, package: Path = PACKAGE) -> list[str]:
    """Lists what is wrong with a wheel's name and contents."""
    found = []
    if "-cp310-abi3-" not in wheel.name:
        found.append(f"{wheel.name} is not an abi3 wheel for CPython 3.10 and later")
    if "-linux_" in wheel.name:
        found.append(f"{wheel.name} is for this Linux alone, not manylinux")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        info = next((name.split("/")[0] for name in names if ".dist-info/" in name), "")
        own = {name for name in names if not name.startswith(f"{info}/")}
        if not own & set(COMPILED):
            found.append("no compiled module")
        expected = source_files(package)
        found += [f"missing: {name}" for name in sorted(expected - own)]
        found += [f"not of the package: {name}" for name in sorted(own - expected - set(COMPILED))]
        found += [f"no licence: {name}" for name in LICENCES if f"{info}/licenses/{name}" not in names]
        for card in sorted(
            name for name in own if name.startswith("gcnd/weights/") and name.endswith(".json")
        ):
            weights = card.replace(".json", ".safetensors")
            digest = hashlib.sha256(archive.read(weights)).hexdigest() if weights in own else None
            if digest != json.loads(archive.read(card))["sha256"]:
                found.append(f"not the weights of their card: {weights}")
    return found


def pythons_at_hand() -> list[str]:
    """Interpreters of the supported versions on the path that start, this one first for its version."""
    own = f"{sys.version_info[0]}.{sys.version_info[1]}"
    found = {own: sys.executable}
    for version in VERSIONS:
        command = shutil.which(f"python{version}")
        if version not in found and command and _starts(command):
            found[version] = command
    return [found[version] for version in sorted(found, key=lambda v: int(v.split(".")[1]))]


def _starts(command: str) -> bool:
    return subprocess.run([command, "-c", ""], capture_output=True, check=False).returncode == 0


def run_in_clean_environment(wheel: Path, python: str, install: bool) -> bool:
    """Installs the wheel into an empty environment of a Python and denoises a sphere with it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([python, "-m", "venv", "env"], cwd=folder, check=True)
        scripts = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        inside = str(scripts / "python")
        version = ("-c", "import sys; print(*sys.version_info[:2])")
        of_inside = subprocess.run([inside, *version], capture_output=True, text=True, check=True).stdout
        pip = [inside, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        with_network = True
        if install:
            subprocess.run([*pip, str(wheel)], check=True)
        else:
            subprocess.run([*pip, "--no-deps", str(wheel)], check=True)
            if of_inside.split() == [str(number) for number in sys.version_info[:2]]:
                _borrow(inside)
            else:
                subprocess.run([*pip, *WITHOUT_TORCH], check=True)
                with_network = False
        method = ("--preset", "fast") if with_network else ("--method", "bilateral-normal")
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        steps = (
            [inside, "-c", PROGRAM],
            [str(scripts / "gcnd"), "denoise", "noisy.ply", "clean.ply", "--quiet", *method],
            [inside, "-c", MEASURE, " ".join(method)],
        )
        return all(
            subprocess.run(step, cwd=folder, env=environment, check=False).returncode == 0 for step in steps
        )


def _borrow(python: str) -> None:
    """Lets an environment see the packages that are installed here, behind its own."""
    where = (
        subprocess.run(
            [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
            capture_output=True,
            text=True,
            check=True,
        )
    ).stdout.strip()
    paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (Path(where) / "borrowed.pth").write_text("\n".join(sorted(paths)) + "\n", encoding="utf-8")


def main() -> int:
    """Checks the wheel that the command line names; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("wheel", type=Path, help="a wheel, or a folder with one in it")
    parser.add_argument("--python", action="append", help="interpreter to try; by default all at hand")
    parser.add_argument("--install", action="store_true", help="this Python alone, with all dependencies")
    options = parser.parse_args()
    wheels = sorted(options.wheel.glob("*.whl")) if options.wheel.is_dir() else [options.wheel]
    if len(wheels) != 1:
        parser.error(f"{options.wheel} holds {len(wheels)} wheels, not one")
    wheel = wheels[0].resolve()
    found = problems(wheel)
    print("\n".join(found) or f"{wheel.name}: all files of the package, weights as on their cards, licences")
    pythons = options.python or ([sys.executable] if options.install else pythons_at_hand())
    failed = [python for python in pythons if not run_in_clean_environment(wheel, python, options.install)]
    for python in failed:
        print(f"failed with {python}", file=sys.stderr)
    return 1 if found or failed else 0


if __name__ == "__main__":
    sys.exit(main())
