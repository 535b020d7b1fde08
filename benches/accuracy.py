"""E_a of presets against the classical filters on clean meshes with seeded noise.

    python benches/accuracy.py --procedural 12 --meshes DIR --preset default --out results.json

DIR holds meshes, by kind in subfolders (cad, smooth, feature). Filters that take a parameter are given the best of
several, chosen per mesh and level with the truth in hand. A row is written when it is finished; a second run fills
in only what is missing, so that new weights cost no new baselines. Of a preset, the error of the last stage's normals
is kept too, before and after refinement.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from last_pass import last_prediction

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.data.shape_cache import load_shapes
from gcnd.denoise import denoise_arrays
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, to_arrays
from gcnd.metrics import normal_error, vertex_error
from gcnd.nn.cascade import Cascade
from gcnd.predict import refined
from gcnd.weights import load_cascade

LEVELS = {"gaussian": (0.1, 0.2, 0.3), "impulsive": (0.1, 0.3, 0.6)}
"""Strength in mean edge lengths along the normals; impulsive noise moves that fraction of the vertices."""

FIRST_PROCEDURAL_SEED = 1_000_100
"""Apart from the seeds of training (from 0) and of the validation during training (from 1 000 000)."""

NOISE_SEED = 7
EV_SAMPLES = 100_000

Method = Callable[[np.ndarray, np.ndarray], np.ndarray]


def filtered(method: str, vertices: np.ndarray, faces: np.ndarray, **parameters: float) -> np.ndarray:
    """One of ours: positions (V, 3)."""
    return apply_filter((vertices, faces), method, **parameters)[0]


def smoothed(name: str, vertices: np.ndarray, faces: np.ndarray, *, iterations: int) -> np.ndarray:
    """One of trimesh's smoothers: positions (V, 3)."""
    mesh = trimesh.Trimesh(vertices.copy(), faces, process=False)
    getattr(trimesh.smoothing, f"filter_{name}")(mesh, iterations=iterations)
    return np.asarray(mesh.vertices)


CLASSICAL: dict[str, Method] = {
    **{
        f"{method} {sigma_r}": partial(filtered, method, sigma_r=sigma_r)
        for method in ("bilateral-normal", "guided-normal")
        for sigma_r in (0.2, 0.35, 0.45)
    },
    "l0": partial(filtered, "l0"),
    "taubin": partial(smoothed, "taubin", iterations=60),
    "humphrey": partial(smoothed, "humphrey", iterations=30),
}


@dataclass(frozen=True)
class Truth:
    """A clean mesh: "source/name", its kind, positions (V, 3) and faces (F, 3)."""

    name: str
    kind: str
    vertices: np.ndarray
    faces: np.ndarray


def clean_meshes(procedural: int, shapes: Path, folder: Path | None) -> list[Truth]:
    """The generated shapes, then the meshes in a folder."""
    meshes = [
        Truth(f"procedural/{s.name}", s.kind, s.vertices, s.faces)
        for s in load_shapes(procedural, FIRST_PROCEDURAL_SEED, shapes)
    ]
    for path in sorted(folder.glob("*/*.ply")) if folder is not None else []:
        arrays, _ = to_arrays(load(path))
        meshes.append(Truth(f"val/{path.stem}", path.parent.name, arrays.vertices, arrays.faces))
    return meshes


def errors(result: np.ndarray, truth: Truth, seconds: float) -> dict[str, float]:
    """E_a in degrees, E_v × 1000 and seconds."""
    return {
        "e_a": normal_error(result, truth.vertices, truth.faces),
        "e_v": vertex_error(result, truth.faces, truth.vertices, truth.faces, samples=EV_SAMPLES) * 1000,
        "seconds": seconds,
    }


def measured(method: Method, noisy: np.ndarray, truth: Truth) -> dict[str, float]:
    """Runs a method on a noisy mesh."""
    started = time.perf_counter()
    result = method(noisy, truth.faces)
    return errors(result, truth, time.perf_counter() - started)


def normal_errors(cascade: Cascade, noisy: np.ndarray, truth: Truth) -> dict[str, float]:
    """E_a of the last stage's normals as predicted and as refined, in degrees."""
    topology = _geom.Topology(truth.faces, len(noisy))
    vertices, prediction = last_prediction(topology, noisy - noisy.mean(axis=0), cascade)
    normals = refined(topology, vertices, prediction, cascade.config.refinement)
    clean = _geom.face_geometry(truth.vertices, truth.faces)[0]

    def mean(found: np.ndarray) -> float:
        return float(np.nanmean(_geom.normal_angles(found, clean)))

    return {"e_a_predicted": mean(prediction.normals), "e_a_refined": mean(normals)}


def fill(row: dict, noisy: np.ndarray, truth: Truth, cascades: dict[str, Cascade]) -> bool:
    """Measures what a row lacks; whether anything was."""
    before = len(row)
    if "noisy" not in row:
        row["noisy"] = errors(noisy, truth, 0.0)
    for name, method in CLASSICAL.items():
        if name not in row:
            row[name] = measured(method, noisy, truth)
    for name, cascade in cascades.items():
        if name not in row:
            found = measured(lambda v, f, c=cascade: denoise_arrays(v, f, c), noisy, truth)
            row[name] = found | normal_errors(cascade, noisy, truth)
    return len(row) > before


def main() -> None:
    """Fills the table in and prints it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--procedural", type=int, default=12)
    parser.add_argument("--shapes", type=Path, default=Path("runs/shapes"))
    parser.add_argument("--meshes", type=Path)
    parser.add_argument("--noise", choices=list(LEVELS), default="gaussian")
    parser.add_argument("--levels", type=float, nargs="+", help="only these; all of the kind if left out")
    parser.add_argument("--preset", action="append", default=[], help="name or .safetensors; may repeat")
    parser.add_argument("--out", type=Path, default=Path("runs/accuracy.json"))
    options = parser.parse_args()
    rows = json.loads(options.out.read_text()) if options.out.exists() else {}
    cascades = {name: load_cascade(name) for name in options.preset}
    for truth in clean_meshes(options.procedural, options.shapes, options.meshes):
        for level in options.levels or LEVELS[options.noise]:
            key = f"{truth.name} {options.noise} {level}"
            about = {"kind": truth.kind, "noise": options.noise, "level": level, "faces": len(truth.faces)}
            row = rows.setdefault(key, about)
            kind = {"kind": options.noise, "fraction": level} if options.noise == "impulsive" else {}
            noisy = add_noise(truth.vertices, truth.faces, level=level, seed=NOISE_SEED, **kind)
            if fill(row, noisy, truth, cascades):
                options.out.write_text(json.dumps(rows, indent=1))
            best = best_classical(row)
            ours = "".join(f"  {p} {row[p]['e_a']:.2f} ({row[p]['e_a'] / best:.2f})" for p in options.preset)
            print(f"{key}: noisy {row['noisy']['e_a']:.2f}  best classical {best:.2f}{ours}", flush=True)
    summarise(rows, options.noise, options.preset)


def best_classical(row: dict) -> float:
    """E_a of the best classical filter on one mesh and level."""
    return min(row[method]["e_a"] for method in CLASSICAL)


def summarise(rows: dict[str, dict], noise: str, presets: list[str]) -> None:
    """Prints mean E_a by source, kind and level, and each preset's ratio to the best classical filter, and E_v."""
    print(
        "| source | kind | level | noisy | best classical |"
        + "".join(f" {p} | ratio | E_v |" for p in presets)
    )
    print("|---|---|---|---|---|" + "---|---|---|" * len(presets))
    groups: dict[tuple[str, str, str], list[dict]] = {}
    for key, row in rows.items():
        if row["noise"] == noise and all(preset in row for preset in presets):
            for kind in (row["kind"], "all"):
                for level in (str(row["level"]), "all"):
                    groups.setdefault((key.split("/")[0], kind, level), []).append(row)
    for (source, kind, level), members in sorted(groups.items()):
        best = np.mean([best_classical(row) for row in members])
        noisy = np.mean([row["noisy"]["e_a"] for row in members])
        line = f"| {source} | {kind} | {level} | {noisy:.2f} | {best:.2f} |"
        for preset in presets:
            e_a, e_v = (np.mean([row[preset][name] for row in members]) for name in ("e_a", "e_v"))
            line += f" {e_a:.2f} | {e_a / best:.2f} | {e_v:.2f} |"
        print(line)


if __name__ == "__main__":
    main()
