"""Meshes, numbers, arrays and files as nobody should hand them over, drawn from a seeded generator."""

from __future__ import annotations

import re
import struct
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

Rng = np.random.Generator

NUMBERS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    2.0,
    1e-3,
    1e3,
    1e-300,
    1e300,
    -1e300,
    5e-324,
    1e-12,
    1e12,
    np.inf,
    -np.inf,
    np.nan,
)

SCALES = (1.0, 1.0, 1.0, 1e-3, 1e3, 1e-12, 1e12, 1e-150, 1e150, 1e-300, 1e300, 1e-320, 1e308)

TEXTS = (
    b"", b"-1", b"0", b"1.5", b"nan", b"inf", b"-inf", b"1e999", b"1e-999", b"4294967295", b"4294967296",
    b"-2147483649", b"9223372036854775807", b"9223372036854775808", b"1000000000000", b"1000000000",
    b"99999999999999999999999", b"1_0", b"0x10", b"null", b"true", b"[]", b"{}", b'"3"', b"\xff\xfe",
    b"3 0 1", b"\n", b"#",
)  # fmt: skip

WORDS = (0, 1, 3, 0x7F, 0xFF, 0xFFFF, 1 << 20, 1 << 28, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def number(rng: Rng) -> float:
    """One of the numbers that break things, or an ordinary one."""
    return float(rng.choice(NUMBERS)) if rng.random() < 0.6 else float(rng.normal())


def below(rng: Rng, n: int) -> int:
    return int(rng.integers(0, max(n, 1)))


def base_mesh(rng: Rng) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Small and of any kind: closed, open, non-manifold, folded, in several parts, or any triples at all."""
    kind = below(rng, 7)
    if kind == 0:
        mesh = trimesh.creation.icosphere(subdivisions=below(rng, 3))
    elif kind == 1:
        mesh = trimesh.creation.box()
    elif kind == 2:
        n = 2 + below(rng, 6)
        x, y = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
        faces = np.concatenate(
            [
                np.stack([corner, corner + n + 1, corner + 1], 1),
                np.stack([corner + 1, corner + n + 1, corner + n + 2], 1),
            ]
        )
        return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1).astype(np.float64), faces
    elif kind == 3:
        n = 1 + below(rng, 40)
        return rng.normal(size=(n, 3)), rng.integers(0, n, size=(1 + below(rng, 120), 3))
    elif kind == 4:  # many faces on one edge
        n = 1 + below(rng, 12)
        return rng.normal(size=(n + 2, 3)), np.stack(
            [np.zeros(n), np.ones(n), np.arange(2, n + 2)], 1
        ).astype(np.int64)
    elif kind == 5:  # a soup
        n = 1 + below(rng, 60)
        return rng.normal(size=(3 * n, 3)), np.arange(3 * n).reshape(-1, 3)
    else:
        mesh = trimesh.creation.torus(1.0, 0.3, major_sections=8, minor_sections=6)
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)


def shaken(rng: Rng, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Moves, flattens, merges and scales positions; all stay finite."""
    points = vertices + rng.choice([0.0, 1e-3, 0.3]) * rng.normal(size=vertices.shape)
    if rng.random() < 0.15:
        points[:, below(rng, 3)] = number(rng) if rng.random() < 0.3 else 0.0
        points = np.nan_to_num(points, nan=0.0, posinf=1e300, neginf=-1e300)
    if rng.random() < 0.1:
        points[:, 1:] = 0.0
    if rng.random() < 0.2:
        points[rng.integers(0, len(points), size=len(points) // 2)] = points[below(rng, len(points))]
    with np.errstate(over="ignore"):
        points = points * rng.choice(SCALES)
        if rng.random() < 0.2:
            points = points + rng.choice([1.0, 1e6, 1e15, 1e300])
    return np.clip(np.nan_to_num(points), -1.7e308, 1.7e308)


def mesh(rng: Rng) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
    """Of the types that the core takes, valid or nearly so."""
    vertices, corners = base_mesh(rng)
    vertices, faces = shaken(rng, vertices), corners.astype(np.uint32)
    choice = rng.random()
    if choice < 0.08:
        vertices[below(rng, len(vertices)), below(rng, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    elif choice < 0.16:
        faces[below(rng, len(faces)), below(rng, 3)] = rng.choice([len(vertices), 0xFFFFFFFF, 0x7FFFFFFF])
    elif choice < 0.22:
        faces[below(rng, len(faces))] = below(rng, len(vertices))
    elif choice < 0.26:
        faces = faces[:0]
    elif choice < 0.28:
        vertices = vertices[:0]
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces)


def pair(rng: Rng) -> tuple[Any, Any]:
    """As people hand meshes over: any type, shape, order and nesting."""
    vertices, faces = mesh(rng)
    given: list[Any] = [vertices, faces.astype(rng.choice(["i8", "i4", "u4", "u8", "i2"]))]
    for which in (0, 1):
        choice = below(rng, 24)
        array = given[which]
        with np.errstate(over="ignore", invalid="ignore"):
            if choice == 0:
                given[which] = array.astype(rng.choice(["f4", "f2", "f8", "c16", "U8", "?", "O", "M8[s]"]))
            elif choice == 1:
                given[which] = array.tolist()
            elif choice == 2:
                given[which] = np.asfortranarray(array)[::-1]
            elif choice == 3:
                given[which] = array.reshape(-1)
            elif choice == 4:
                given[which] = array[:, : below(rng, 3)]
            elif choice == 5:
                given[which] = array[None]
            elif choice == 6:
                given[which] = [*array.tolist(), [0]]
            elif choice == 7:
                given[which] = rng.choice(np.array([None, "mesh", 3.5], dtype=object))
            elif choice == 8:
                given[which] = array.astype(">f8" if which == 0 else ">i4")
            elif choice == 9:
                given[which] = -array.astype(np.int64)
    return given[0], given[1]


def normals(rng: Rng, n: int) -> NDArray[np.float64]:
    """Unit normals (n, 3), some of them zero, and now and then no normals at all."""
    values = rng.normal(size=(n, 3))
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-300)
    if n and rng.random() < 0.2:
        values[below(rng, n)] = 0.0
    if n and rng.random() < 0.1:
        values[below(rng, n), below(rng, 3)] = number(rng)
    if rng.random() < 0.05:
        values = values[: n // 2]
    return np.ascontiguousarray(values)


def mutated(rng: Rng, data: bytes) -> bytes:
    """A file with one to four faults: flipped bytes, other numbers, pieces lost, doubled or put in."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        data = _MUTATIONS[below(rng, len(_MUTATIONS))](rng, data)
    return data


def _flip(rng: Rng, data: bytes) -> bytes:
    changed = bytearray(data)
    for _ in range(1 + below(rng, 8)):
        if changed:
            changed[below(rng, len(changed))] ^= 1 << below(rng, 8)
    return bytes(changed)


def _cut(rng: Rng, data: bytes) -> bytes:
    return data[: below(rng, len(data))]


def _insert(rng: Rng, data: bytes) -> bytes:
    at = below(rng, len(data))
    return data[:at] + rng.bytes(1 + below(rng, 16)) + data[at:]


def _renumber(rng: Rng, data: bytes) -> bytes:
    # Mostly in the first kilobytes, where headers are.
    found = list(re.finditer(rb"-?\d+(\.\d+)?(e[-+]?\d+)?", data[: 2048 if rng.random() < 0.6 else None]))
    if not found:
        return data
    match = found[below(rng, len(found))]
    return data[: match.start()] + TEXTS[below(rng, len(TEXTS))] + data[match.end() :]


def _reword(rng: Rng, data: bytes) -> bytes:
    if len(data) < 4:
        return data
    at = below(rng, min(len(data), 200) - 3) if rng.random() < 0.5 else below(rng, len(data) - 3)
    word = struct.pack(rng.choice(["<I", ">I"]), WORDS[below(rng, len(WORDS))])
    return data[:at] + word + data[at + 4 :]


def _refloat(rng: Rng, data: bytes) -> bytes:
    if len(data) < 8:
        return data
    at = below(rng, len(data) - 7)
    kind = str(rng.choice(["<f", "<d"]))
    with np.errstate(over="ignore"):
        value = number(rng)
        word = struct.pack(kind, float(np.float32(value)) if kind == "<f" else value)
    return data[:at] + word + data[at + len(word) :]


def _double(rng: Rng, data: bytes) -> bytes:
    start = below(rng, len(data))
    piece = data[start : start + 1 + below(rng, 200)]
    at = below(rng, len(data))
    return data[:at] + piece + data[at:]


def _drop(rng: Rng, data: bytes) -> bytes:
    start = below(rng, len(data))
    return data[:start] + data[start + 1 + below(rng, 60) :]


def _line(rng: Rng, data: bytes) -> bytes:
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data
    first, second = below(rng, min(len(lines), 30)), below(rng, len(lines))
    lines[first], lines[second] = lines[second], lines[first]
    return b"".join(lines)


_MUTATIONS = (_flip, _cut, _insert, _renumber, _renumber, _renumber, _reword, _refloat, _double, _drop, _line)
