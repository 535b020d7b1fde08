"""E_a of a preset against the classical filters on clean meshes with seeded noise along the normals.

    python benches/accuracy.py --procedural 12 --meshes DIR --out results.json

DIR holds meshes, by kind in subfolders (cad, smooth, feature). Filters that take a parameter are given the best of
several, chosen per mesh and level with the truth in hand. A row is written when it is finished; a second run fills
in only what is missing, so that new weights cost no new baselines.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from gcnd.data.noise import add_noise
from gcnd.data.shape_cache import load_shapes
from gcnd.denoise import denoise_arrays
from gcnd.mesh_io import load, to_arrays
from gcnd.metrics import normal_error, vertex_error
from gcnd.weights import load_cascade
from reference import bilateral_normal

LEVELS = (0.1, 0.2, 0.3)
FIRST_PROCEDURAL_SEED = 1_000_100
"""Apart from the seeds of training (from 0) and of the validation during training (from 1 000 000)."""

NOISE_SEED = 7
EV_SAMPLES = 100_000


def classical(vertices: np.ndarray, faces: np.ndarray) -> dict[str, Callable[[], np.ndarray]]:
    """The filters, each as a call that returns positions (V, 3)."""

    def smoother(run: Callable[..., object], **options: float) -> np.ndarray:
        mesh = trimesh.Trimesh(vertices.copy(), faces, process=False)
        run(mesh, **options)
        return np.asarray(mesh.vertices)

    filters: dict[str, Callable[[], np.ndarray]] = {
        f"bilateral-normal {sigma_r}": lambda s=sigma_r: bilateral_normal.denoise(vertices, faces, sigma_r=s)
        for sigma_r in (0.2, 0.35, 0.45)
    }
    filters["taubin"] = lambda: smoother(trimesh.smoothing.filter_taubin, iterations=60)
    filters["humphrey"] = lambda: smoother(trimesh.smoothing.filter_humphrey, iterations=30)
    return filters


def test_meshes(
    procedural: int, shapes: Path, folder: Path | None
) -> list[tuple[str, str, np.ndarray, np.ndarray]]:
    """(source/name, kind, vertices, faces) of every clean mesh."""
    meshes = [
        (f"procedural/{s.name}", s.kind, s.vertices, s.faces)
        for s in load_shapes(procedural, FIRST_PROCEDURAL_SEED, shapes)
    ]
    if folder is not None:
        for path in sorted(folder.glob("*/*.ply")):
            arrays, _ = to_arrays(load(path))
            meshes.append(
                (f"val/{path.stem}", path.parent.name, arrays.vertices, arrays.faces.astype(np.uint32))
            )
    return meshes


def errors(result: np.ndarray, truth: np.ndarray, faces: np.ndarray, seconds: float) -> dict[str, float]:
    """E_a in degrees, E_v × 1000 and seconds."""
    return {
        "e_a": normal_error(result, truth, faces),
        "e_v": vertex_error(result, faces, truth, faces, samples=EV_SAMPLES) * 1000,
        "seconds": seconds,
    }


def main() -> None:
    """Fills the table in and prints it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--procedural", type=int, default=12)
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--meshes", type=Path)
    parser.add_argument("--preset", action="append", default=[], help="name or .safetensors; may repeat")
    parser.add_argument("--out", type=Path, default=Path("runs/accuracy.json"))
    options = parser.parse_args()
    rows = json.loads(options.out.read_text()) if options.out.exists() else {}
    cascades = {name: load_cascade(name) for name in options.preset}
    for name, kind, truth, faces in test_meshes(options.procedural, options.shapes, options.meshes):
        for level in LEVELS:
            row = rows.setdefault(f"{name} {level}", {"kind": kind, "level": level, "faces": len(faces)})
            noisy = add_noise(truth, faces, level=level, seed=NOISE_SEED)
            row.setdefault("noisy", errors(noisy, truth, faces, 0.0))
            methods = classical(noisy, faces)
            for preset, cascade in cascades.items():
                methods[preset] = lambda c=cascade, v=noisy, f=faces: denoise_arrays(v, f, c)
            for method, run in methods.items():
                if method not in row:
                    started = time.perf_counter()
                    row[method] = errors(run(), truth, faces, time.perf_counter() - started)
                    options.out.write_text(json.dumps(rows, indent=1))
            best = min(row[m]["e_a"] for m in classical(noisy, faces))
            ours = "".join(f"  {p} {row[p]['e_a']:.2f} ({row[p]['e_a'] / best:.2f})" for p in options.preset)
            print(
                f"{name} {level}: noisy {row['noisy']['e_a']:.2f}  best classical {best:.2f}{ours}",
                flush=True,
            )
    summarise(rows, options.preset)


def summarise(rows: dict[str, dict], presets: list[str]) -> None:
    """Prints mean E_a by source, kind and level, and each preset's ratio to the best classical filter."""
    print("| source | kind | level | noisy | best classical |" + "".join(f" {p} | ratio |" for p in presets))
    print("|---|---|---|---|---|" + "---|---|" * len(presets))
    groups: dict[tuple[str, str, str], list[dict]] = {}
    for key, row in rows.items():
        source = key.split("/")[0]
        for level in (str(row["level"]), "all"):
            groups.setdefault((source, row["kind"], level), []).append(row)
            groups.setdefault((source, "all", level), []).append(row)
    for (source, kind, level), members in sorted(groups.items()):
        done = [m for m in members if all(p in m for p in presets)]
        best = np.mean(
            [min(v["e_a"] for k, v in m.items() if k.startswith(("bil", "tau", "hum"))) for m in done]
        )
        noisy = np.mean([m["noisy"]["e_a"] for m in done])
        line = f"| {source} | {kind} | {level} | {noisy:.2f} | {best:.2f} |"
        for preset in presets:
            ours = np.mean([m[preset]["e_a"] for m in done])
            line += f" {ours:.2f} | {ours / best:.2f} |"
        print(line)


if __name__ == "__main__":
    main()
