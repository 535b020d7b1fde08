"""Spikes: what is taken for one, what is not, and what becomes of it."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gcnd import _geom
from gcnd.data.noise import NoiseKind, add_noise
from gcnd.data.shapes import ShapeKind, make_shape
from gcnd.spikes import Spikes
from sheet_cases import even_sheet, sheet


def found(vertices: np.ndarray, faces: np.ndarray) -> list[int]:
    faces = np.ascontiguousarray(faces, dtype=np.uint32)
    positions = np.ascontiguousarray(vertices, dtype=np.float64)
    return _geom.find_spikes(_geom.Topology(faces, len(positions)), positions)[0].tolist()


@pytest.mark.parametrize("kind", ["cad", "smooth", "feature"])
def test_no_vertex_of_a_generated_shape_is_a_spike(kind: ShapeKind) -> None:
    """Clean or with any noise that we train on; but one vertex drawn out is."""
    shape = make_shape(3000000, kind)
    assert found(shape.vertices, shape.faces) == []
    noises: tuple[NoiseKind, ...] = ("gaussian", "impulsive", "isotropic", "varying")
    for seed, noise in enumerate(noises):
        noisy = add_noise(shape.vertices, shape.faces, kind=noise, level=0.7, seed=seed)
        assert found(noisy, shape.faces) == []
    drawn_out = shape.vertices.copy()
    outwards = trimesh.Trimesh(shape.vertices, shape.faces, process=False).vertex_normals
    drawn_out[99] += 0.5 * np.ptp(shape.vertices, axis=0).max() * outwards[99]
    assert found(drawn_out, shape.faces) == [99]


def test_no_vertex_between_uneven_triangles_is_a_spike() -> None:
    """Areas from 1 to 1000; impulses in mean edges are many edges high among the small ones."""
    places = np.concatenate([[0.0], np.cumsum(np.geomspace(0.05, 1.6, 40))])
    vertices, faces = sheet(places, places)
    assert found(vertices, faces) == []
    spacing = np.gradient(places)
    local = np.minimum(spacing[:, None], spacing).ravel()
    rng = np.random.default_rng(0)
    for level in (0.2, 0.7):
        noisy = vertices.copy()
        noisy[:, 2] += level * local * rng.normal(size=len(vertices))
        assert found(noisy, faces) == []
        assert found(add_noise(vertices, faces, level=level), faces) == []


@pytest.mark.parametrize("sections", [4, 8, 32])
@pytest.mark.parametrize("height", [1.0, 5.0, 50.0])
def test_the_tip_of_a_cone_is_no_spike(height: float, sections: int) -> None:
    cone = trimesh.creation.cone(1.0, height, sections=sections)
    assert found(cone.vertices, cone.faces) == []


def test_where_spikes_go() -> None:
    """One inside comes down for good; one on a boundary comes back, moved as its foot was."""
    vertices, faces = even_sheet(8)
    tip, inside = len(vertices), 40
    vertices = np.concatenate([vertices, [[-1.0, 3.5, 9.0]]])
    vertices[inside, 2] = -7.0
    faces = np.concatenate([faces, [[4, 3, tip]]]).astype(np.uint32)
    spikes = Spikes(_geom.Topology(faces, len(vertices)), vertices)
    assert spikes.ids.tolist() == [inside, tip]
    lowered = spikes.taken_off(vertices)
    np.testing.assert_allclose(lowered[[inside, tip]], [[4.0, 4.0, 0.0], [0.0, 3.5, 0.0]], atol=1e-12)
    same = np.delete(np.arange(len(vertices)), [inside, tip])
    assert (lowered[same] == vertices[same]).all()
    moved = lowered + np.array([0.1, 0.0, 0.2])
    back = spikes.tips_put_back(moved)
    np.testing.assert_allclose(back[tip], [-0.9, 3.5, 9.2], atol=1e-12)
    assert (back[:tip] == moved[:tip]).all()


def test_without_spikes_nothing_is_copied() -> None:
    vertices, faces = even_sheet(8)
    spikes = Spikes(_geom.Topology(faces, len(vertices)), vertices)
    assert spikes.taken_off(vertices) is vertices
    assert spikes.tips_put_back(vertices) is vertices
