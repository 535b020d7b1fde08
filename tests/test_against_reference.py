"""The Rust core against the slow numpy reference, stage by stage, on a noisy cube and a noisy open sphere."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gcnd import _geom
from gcnd.errors import GcndError
from reference import bilateral_normal, filters, meshes
from reference.patches import PatchReference, face_class

CLASS_NAMES = ["flat", "edge", "corner", "transitional"]
N_CENTERS = 40


class Case(NamedTuple):
    vertices: np.ndarray
    clean: np.ndarray
    faces: np.ndarray
    topology: _geom.Topology

    def centers(self) -> np.ndarray:
        """Some faces, the first and last among them."""
        return np.unique(np.linspace(0, len(self.faces) - 1, N_CENTERS).astype(np.uint32))


def make_case(clean: np.ndarray, faces: np.ndarray, amplitude: float) -> Case:
    vertices = meshes.jittered(clean, amplitude, seed=3)
    return Case(vertices, clean, faces, _geom.Topology(faces.astype(np.uint32), len(vertices)))


@pytest.fixture(scope="module", params=["cube", "open_sphere"])
def case(request: pytest.FixtureRequest) -> Case:
    if request.param == "cube":
        return make_case(*meshes.cube(3), amplitude=0.02)
    return make_case(*meshes.open_sphere(3), amplitude=0.02)


def extract(case: Case, n_nodes: int, **options: Any) -> dict[str, Any]:
    centers = case.centers()
    extractor = _geom.PatchExtractor(case.topology, case.vertices, n_nodes=n_nodes, **options)
    shape = (len(centers), n_nodes)
    arrays: dict[str, Any] = {
        "features": np.zeros((*shape, extractor.n_channels), np.float32),
        "neighbors": np.zeros((*shape, 3), np.int32),
        "face_ids": np.zeros(shape, np.uint32),
        "mask": np.zeros(shape, np.uint8),
        "world_from_patch": np.zeros((len(centers), 3, 3)),
        "radii": np.zeros(len(centers)),
    }
    extractor.extract(centers, *arrays.values())
    return arrays


def own_normals(case: Case) -> np.ndarray:
    return _geom.face_geometry(case.vertices, case.faces.astype(np.uint32))[0]


def test_face_geometry(case: Case) -> None:
    expected = meshes.face_geometry(case.vertices, case.faces)
    for got, want in zip(
        _geom.face_geometry(case.vertices, case.faces.astype(np.uint32)), expected, strict=True
    ):
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-14)


def test_edge_neighbors(case: Case) -> None:
    offsets, values = case.topology.edge_neighbors()
    rows = [set(values[a:b].tolist()) for a, b in pairwise(offsets)]
    assert rows == meshes.edge_neighbors(case.faces)


@pytest.mark.parametrize("patch_scale", [2.0, 4.0])
def test_selection(case: Case, patch_scale: float) -> None:
    reference = PatchReference(case.vertices, case.faces, patch_scale=patch_scale)
    got = extract(case, 512, patch_scale=patch_scale)
    for p, i in enumerate(case.centers()):
        want = reference.select(int(i))
        assert len(want) < 512
        assert got["radii"][p] == pytest.approx(reference.radius(int(i)), rel=1e-13)
        assert got["face_ids"][p][got["mask"][p] == 1].tolist() == want


@pytest.mark.parametrize("region", ["patch", "two_ring"])
def test_frames(case: Case, region: str) -> None:
    reference = PatchReference(case.vertices, case.faces)
    got = extract(case, 64, voting_region=region)["world_from_patch"]
    compared = 0
    for frame, i in zip(got, case.centers(), strict=True):
        want = reference.align(int(i), region)
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1, abs=1e-12)
        # Whatever the sign rules, the frame must bring the tensor into descending diagonal form.
        diagonal = np.diag(want.eigenvalues)
        np.testing.assert_allclose(frame.T @ want.tensor @ frame, diagonal, atol=1e-12)
        gap = min(-np.diff(want.eigenvalues))
        if gap > 1e-4 and want.third_moment > 1e-6:
            np.testing.assert_allclose(frame, want.world_from_patch, atol=1e-9)
            compared += 1
    assert compared > 0.9 * N_CENTERS


def test_patches_that_nobody_aligns_keep_the_axes_of_the_mesh(case: Case) -> None:
    got = extract(case, 64, voting_region="nobody")
    assert (got["world_from_patch"] == np.eye(3)).all()
    aligned = extract(case, 64)
    turned = np.einsum("prc,pnc->pnr", aligned["world_from_patch"], aligned["features"][..., 3:6])
    np.testing.assert_allclose(got["features"][..., 3:6], turned, atol=1e-6)


@pytest.mark.parametrize("n_nodes", [16, 64, 200])
def test_graphs(case: Case, n_nodes: int) -> None:
    reference = PatchReference(case.vertices, case.faces)
    got = extract(case, n_nodes)
    for p, i in enumerate(case.centers()):
        want = reference.graph(int(i), got["world_from_patch"][p], n_nodes)
        assert got["face_ids"][p].tolist() == want.face_ids.tolist()
        assert got["mask"][p].tolist() == want.mask.tolist()
        np.testing.assert_allclose(got["features"][p], want.features, rtol=0, atol=2e-6)
        np.testing.assert_array_equal(np.sort(got["neighbors"][p]), np.sort(want.neighbors))


def test_eight_channels_are_the_first_eight(case: Case) -> None:
    features = extract(case, 64, vertex_offsets=False)["features"]
    np.testing.assert_array_equal(features, extract(case, 64)["features"][..., :8])


def test_scale_space_follows_the_other_channels(case: Case) -> None:
    got = extract(case, 64, scale_space=True)
    np.testing.assert_array_equal(got["features"][..., :17], extract(case, 64)["features"])
    world = np.einsum(
        "prc,pnkc->pnkr", got["world_from_patch"], got["features"][..., 17:].reshape(-1, 64, 3, 3)
    )
    smoothed = case.vertices
    for iteration in range(1, 17):
        smoothed = filters.average_of_centroids(smoothed, case.faces)
        if iteration in (1, 4, 16):
            want = meshes.face_geometry(smoothed, case.faces)[0][got["face_ids"]]
            np.testing.assert_allclose(world[:, :, (1, 4, 16).index(iteration)], want, rtol=0, atol=2e-6)


def test_first_normals_are_those_of_the_mesh_before_its_first_pass(case: Case) -> None:
    rng = np.random.default_rng(8)
    first = case.vertices + rng.normal(0, 0.01, case.vertices.shape)
    roughness = np.array([0.0, 1e-3, 0.02, 0.7])
    got = extract(case, 64, scale_space=True, first=first, roughness=roughness)
    others = extract(case, 64, scale_space=True, roughness=roughness)["features"]
    np.testing.assert_array_equal(np.delete(got["features"], np.s_[26:35], axis=-1), others)
    channels = got["features"][..., 26:35].reshape(-1, 64, 3, 3)
    world = np.einsum("prc,pnkc->pnkr", got["world_from_patch"], channels)
    smoothed = first
    for iteration in range(5):
        if iteration in (0, 1, 4):
            want = meshes.face_geometry(smoothed, case.faces)[0][got["face_ids"]]
            np.testing.assert_allclose(world[:, :, (0, 1, 4).index(iteration)], want, rtol=0, atol=2e-6)
        smoothed = filters.average_of_centroids(smoothed, case.faces)


def test_a_first_mesh_that_cannot_be_is_refused(case: Case) -> None:
    with pytest.raises(GcndError, match="first"):
        _geom.PatchExtractor(case.topology, case.vertices, first=np.zeros((3, 3)))
    broken = case.vertices.copy()
    broken[7, 1] = np.nan
    with pytest.raises(GcndError, match="vertex 7"):
        _geom.PatchExtractor(case.topology, case.vertices, first=broken)


def test_roughness(case: Case) -> None:
    got = _geom.mesh_roughness(case.topology, case.vertices)
    np.testing.assert_allclose(got, filters.mesh_roughness(case.vertices, case.faces), rtol=1e-9)
    assert 1e-4 < got[0] < got[1] < got[2] < got[3] < 0.1


def test_roughness_comes_last_and_in_units_of_the_patch(case: Case) -> None:
    roughness = np.array([0.0, 1e-3, 0.02, 0.7])
    for options in ({}, {"scale_space": True}, {"vertex_offsets": False}):
        got = extract(case, 64, roughness=roughness, **options)
        plain = extract(case, 64, **options)["features"]
        np.testing.assert_array_equal(got["features"][..., :-4], plain)
        # r = 4 √ā by default.
        relative = np.clip(4 * roughness / got["radii"][:, None], 1e-4, 10)
        want = np.broadcast_to(np.log10(relative)[:, None], (*plain.shape[:2], 4))
        np.testing.assert_allclose(got["features"][..., -4:], want, rtol=0, atol=1e-6)
        assert got["features"][0, 0, -1] > 0


@pytest.mark.parametrize("n_nodes", [16, 200])
def test_random_budget_draws_from_the_patch(case: Case, n_nodes: int) -> None:
    reference = PatchReference(case.vertices, case.faces)
    got = extract(case, n_nodes, budget="random", seed=5)
    nearest = extract(case, n_nodes)
    for p, i in enumerate(case.centers()):
        patch, ids = reference.select(int(i)), got["face_ids"][p]
        real = ids[got["mask"][p] == 1]
        assert ids[0] == i
        assert len(set(real.tolist())) == len(real) == min(n_nodes, len(patch))
        assert set(ids.tolist()) <= set(patch)
    assert (got["face_ids"] != nearest["face_ids"]).any()


def test_face_classes() -> None:
    case = make_case(*meshes.cube(3), amplitude=0.0)
    reference = PatchReference(case.vertices, case.faces)
    got = _geom.classify_faces(case.topology, case.vertices)
    seen = set()
    for i in case.centers():
        eigenvalues = reference.align(int(i)).eigenvalues
        distance = np.abs(np.subtract.outer(eigenvalues[1:], [0.01, 0.001, 0.1])).min()
        if distance > 1e-9:
            assert CLASS_NAMES[got[i]] == face_class(eigenvalues)
            seen.add(CLASS_NAMES[got[i]])
    assert {"flat", "edge"} <= seen


@pytest.mark.parametrize("neighborhood", ["shared_vertex", "shared_edge", "radius"])
def test_refinement(case: Case, neighborhood: str) -> None:
    normals = own_normals(case)
    normals[7] = 0
    options: dict[str, Any] = {"iterations": 3, "neighborhood": neighborhood, "radius": 1.7}
    got = _geom.refine_normals(case.topology, case.vertices, normals, **options)
    want = filters.refine_normals(case.vertices, case.faces, normals, **options)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)
    assert np.abs(got - normals).max() > 0.01


def test_refinement_with_other_sigmas(case: Case) -> None:
    normals = own_normals(case)
    options: dict[str, Any] = {"iterations": 1, "sigma_r": 0.7, "sigma_s": 0.11}
    got = _geom.refine_normals(case.topology, case.vertices, normals, **options)
    want = filters.refine_normals(case.vertices, case.faces, normals, **options)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-13)


@pytest.mark.parametrize("iterations", [1, 15])
def test_vertex_updating(case: Case, iterations: int) -> None:
    normals = _geom.face_geometry(case.clean, case.faces.astype(np.uint32))[0]
    normals[3] = 0
    got = _geom.update_vertices(case.topology, case.vertices, normals, iterations)
    want = filters.update_vertices(case.vertices, case.faces, normals, iterations)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-13)
    assert np.abs(got - case.vertices).max() > 0.01


def test_fitting_vertices(case: Case) -> None:
    normals = _geom.face_geometry(case.clean, case.faces.astype(np.uint32))[0]
    normals[3] = 0
    start = _geom.update_vertices(case.topology, case.vertices, normals, 15)
    got = _geom.fit_vertices(case.topology, start, normals, case.vertices)
    want, matrix = filters.fit_vertices(start, case.faces, normals, case.vertices)
    assert np.abs(want - start).max() > 0.001

    def above_the_least(positions: np.ndarray) -> float:
        way = (positions - want).ravel()
        return float(way @ matrix @ way)

    # The solver takes thirty steps, not as many as there are unknowns.
    assert above_the_least(got) < 0.005 * above_the_least(start)


def test_fitting_as_few_vertices_as_the_solver_takes_steps() -> None:
    case = make_case(*meshes.cube(0), amplitude=0.05)
    normals = _geom.face_geometry(case.clean, case.faces.astype(np.uint32))[0]
    start = _geom.update_vertices(case.topology, case.vertices, normals, 15)
    got = _geom.fit_vertices(case.topology, start, normals, case.vertices)
    want, _ = filters.fit_vertices(start, case.faces, normals, case.vertices)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-8)
    assert np.abs(got - start).max() > 0.01


def test_keeping_detail(case: Case) -> None:
    rng = np.random.default_rng(5)
    steps = rng.normal(size=(len(case.vertices), 3)) * 0.002
    bump = np.exp(-20 * np.square(case.clean - case.clean[7]).sum(axis=1))
    moved = case.vertices + steps + 0.05 * bump[:, None]
    got = _geom.keep_detail(case.topology, case.vertices, moved)
    want = filters.keep_detail(case.vertices, case.faces, moved)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)
    assert np.abs(got - moved).max() > 0.01
    assert np.abs(got - case.vertices).max() > 0.001


def test_angles(case: Case) -> None:
    truth = _geom.face_geometry(case.clean, case.faces.astype(np.uint32))[0]
    angles = _geom.normal_angles(own_normals(case), truth)
    assert angles.mean() == pytest.approx(filters.normal_error(own_normals(case), truth), rel=1e-9)


def test_vertex_error(case: Case) -> None:
    """Monte Carlo against Monte Carlo, with other random numbers."""
    rng, n, faces = np.random.default_rng(0), 20_000, case.faces
    clouds = []
    for vertices in (case.vertices, case.clean):
        _, _, areas = meshes.face_geometry(vertices, faces)
        a, b, c = np.moveaxis(vertices[faces[rng.choice(len(faces), n, p=areas / areas.sum())]], 1, 0)
        s, t = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
        clouds.append((1 - s) * a + s * (1 - t) * b + s * t * c)
    diagonal = np.linalg.norm(case.clean[faces].max((0, 1)) - case.clean[faces].min((0, 1)))
    want = np.mean(cKDTree(clouds[1]).query(clouds[0])[0]) / diagonal
    ids = faces.astype(np.uint32)
    got = _geom.vertex_error(case.vertices, ids, case.clean, ids, n, 0)
    assert got == pytest.approx(want, rel=0.03)


def test_bilateral_baseline_is_the_same_filter(case: Case) -> None:
    """With the face itself and boundary vertices taking part, the baseline is Eqs. 5 and 6."""
    want = bilateral_normal.filter_normals(
        case.vertices, case.faces, sigma_r=0.35, iterations=5, include_center=True
    )
    got = _geom.refine_normals(case.topology, case.vertices, own_normals(case), iterations=5, sigma_r=0.35)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-11)
    moved = bilateral_normal.move_vertices(case.vertices, case.faces, want, iterations=10, fix_boundary=False)
    np.testing.assert_allclose(
        _geom.update_vertices(case.topology, case.vertices, got, 10), moved, rtol=0, atol=1e-11
    )


def test_bilateral_baseline_denoises_and_keeps_the_boundary(case: Case) -> None:
    ids = case.faces.astype(np.uint32)
    result = bilateral_normal.denoise(case.vertices, case.faces, sigma_r=0.45)
    truth = _geom.face_geometry(case.clean, ids)[0]
    error = _geom.normal_angles(_geom.face_geometry(result, ids)[0], truth).mean()
    assert error < 0.7 * _geom.normal_angles(own_normals(case), truth).mean()
    edges = np.sort(case.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(unique[count == 1])
    np.testing.assert_array_equal(result[rim], case.vertices[rim])
