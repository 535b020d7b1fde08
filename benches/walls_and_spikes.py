"""E_a on thin walls and around spikes, with and without what is done about them.

    python benches/walls_and_spikes.py --preset default

Lengths are in edges. "all" are patches of all faces within the radius, spikes left where they are; "one" is what
``gcnd.denoise`` does.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import trimesh

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.denoise import denoise_arrays
from gcnd.nn.cascade import PatchConfig
from gcnd.spikes import Spikes
from gcnd.weights import load_cascade

SIDE = 28


class Case(NamedTuple):
    """A clean and a noisy mesh, and the faces that are measured."""

    name: str
    truth: np.ndarray
    noisy: np.ndarray
    faces: np.ndarray
    counted: np.ndarray


def sheet(side: int = SIDE) -> tuple[np.ndarray, np.ndarray]:
    """A flat grid, faces up."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    n = side + 1
    corners = (np.arange(side)[:, None] * n + np.arange(side)).ravel()
    faces = np.concatenate([corners[:, None] + half for half in ([0, n, n + 1], [0, n + 1, 1])])
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), faces


def plate(thickness: float, side: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """A closed plate, one quad high at its rim."""
    flat, faces = sheet(side)
    ids = np.arange(len(flat)).reshape(side + 1, side + 1)
    top = np.concatenate([ids[:-1, 0], ids[-1, :-1], ids[:0:-1, -1], ids[0, :0:-1]])
    after, n = np.roll(top, -1), len(flat)
    rim = [np.column_stack(part) for part in ((after, top, top + n), (after, top + n, after + n))]
    vertices = np.concatenate([flat + np.array([0.0, 0.0, thickness]), flat])
    return vertices, np.concatenate([faces, faces[:, ::-1] + n, *rim])


def shell(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A ball with a hollow."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    outer = ball.vertices / ball.edges_unique_length.mean()
    inner = outer * (1.0 - gap / np.linalg.norm(outer, axis=1).mean())
    return np.concatenate([outer, inner]), np.concatenate([ball.faces, ball.faces[:, ::-1] + len(outer)])


def slot(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Two sheets face to face."""
    flat, faces = sheet(20)
    vertices = np.concatenate([flat + np.array([0.0, 0.0, gap]), flat])
    return vertices, np.concatenate([faces[:, ::-1], faces + len(flat)])


def walls() -> Iterator[Case]:
    """Two sheets back to back and bodies that have such places."""
    flat, faces = sheet()
    for gap, level in ((0.15, 0.03), (0.5, 0.1), (1.0, 0.2), (2.0, 0.2), (0.5, 0.2), (1.0, 0.4)):
        truth = np.concatenate([flat + np.array([0.0, 0.0, gap]), flat])
        noisy = truth.copy()
        noisy[:, 2] += level * np.random.default_rng(5).normal(size=len(truth))
        both = np.concatenate([faces, faces[:, ::-1] + len(flat)])
        counted = np.arange(len(both)) < len(faces)
        yield Case(f"sheets {gap}, noise {level}", truth, noisy, both, counted)
        yield Case(
            "    the first alone",
            flat,
            noisy[: len(flat)] - np.array([0.0, 0.0, gap]),
            faces,
            counted[counted],
        )
    for name, make in (("plate", plate), ("shell", shell), ("slot", slot)):
        for gap, level in ((0.5, 0.1), (1.0, 0.2)):
            truth, faces = make(gap)
            noisy = add_noise(truth, faces, level=level, seed=3)
            yield Case(f"{name} {gap}, noise {level}", truth, noisy, faces, np.ones(len(faces), dtype=bool))


def spikes() -> Iterator[Case]:
    """Nine vertices of a sheet drawn out; four triangles that hang on its rim. Their own faces do not count."""
    truth, faces = sheet()
    noisy = truth.copy()
    noisy[:, 2] += 0.2 * np.random.default_rng(1).normal(size=len(truth))
    ids = (np.array([7, 14, 21])[:, None] * (SIDE + 1) + [7, 14, 21]).ravel()
    for height in (3.0, 4.0, 6.0, 8.0):
        drawn = noisy.copy()
        drawn[ids, 2] += height * np.where(np.arange(9) % 2, 1.0, -1.0)
        is_own = np.isin(faces, ids).any(axis=1)
        away = np.linalg.norm(truth[faces].mean(axis=1)[:, None] - truth[ids], axis=2).min(axis=1)
        yield Case(f"spikes of {height}, within 4", truth, drawn, faces, ~is_own & (away < 4.0))
        yield Case("    and beyond", truth, drawn, faces, away >= 4.0)
    starts = np.arange(3, SIDE - 3, 6)
    edges = np.column_stack([(starts + 1) * (SIDE + 1), starts * (SIDE + 1)])
    tips = truth[edges].mean(axis=1) + np.array([0.0, -1.0, 9.0])
    hanging = np.column_stack([edges, len(truth) + np.arange(len(edges))])
    middles = truth[faces].mean(axis=1)
    away = np.linalg.norm(middles[:, None] - truth[edges].mean(axis=1), axis=2).min(axis=1)
    clean, drawn = (np.concatenate([v, tips]) for v in (truth, noisy))
    counted = np.concatenate([away < 3.0, np.zeros(len(edges), dtype=bool)])
    yield Case("hanging triangles, within 3", clean, drawn, np.concatenate([faces, hanging]), counted)
    yield Case("    the same without them", truth, noisy, faces, away < 3.0)


@contextmanager
def nothing_done() -> Iterator[None]:
    """Patches of all faces within the radius, spikes left where they are."""
    with (
        patch.object(PatchConfig, "sheets", "all"),
        patch.object(Spikes, "taken_off", lambda _, vertices: vertices),
        patch.object(Spikes, "tips_put_back", lambda _, vertices: vertices),
    ):
        yield


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="default")
    cascade = load_cascade(parser.parse_args().preset)
    print(f"{'':30}{'noisy':>8}{'all':>8}{'one':>8}")
    for case in (*walls(), *spikes()):
        faces = np.ascontiguousarray(case.faces, dtype=np.uint32)

        def error(vertices: np.ndarray, case: Case = case, faces: np.ndarray = faces) -> float:
            found, wanted = (_geom.face_geometry(v, faces)[0] for v in (vertices, case.truth))
            return float(_geom.normal_angles(found, wanted)[case.counted].mean())

        errors = [error(case.noisy)]
        for way in (nothing_done(), nullcontext()):
            with way:
                errors.append(error(denoise_arrays(case.noisy, faces, cascade)))
        print(f"{case.name:30}" + "".join(f"{e:8.2f}" for e in errors), flush=True)


if __name__ == "__main__":
    main()
