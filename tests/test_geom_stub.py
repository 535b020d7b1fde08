"""The stub of the binding against the module, and the one place where matrices change their layout."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.errors import ConfigError, GcndError, MeshError

STUB = ast.parse((Path(gcnd.__file__).parent / "_geom.pyi").read_text(encoding="utf-8"))


def defaults_as_text(arguments: ast.arguments) -> str:
    """The parameters of a stub's function as `inspect.signature` would print them, without annotations."""
    arguments = ast.parse(f"def f({ast.unparse(arguments)}): ...").body[0].args  # type: ignore[attr-defined]
    for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs):
        argument.annotation = None
    return ast.unparse(arguments).replace(" ", "")


def signature_text(function: Any) -> str:
    """The same of a compiled function; a default that is no literal is `...` in both."""
    text = str(inspect.signature(function)).removeprefix("(").removesuffix(")")
    return text.replace("self, /", "self").replace("Ellipsis", "...").replace(" ", "")


def stub_members(body: list[ast.stmt]) -> dict[str, str]:
    """Names of functions, properties and classes with their parameters."""
    members = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            members[node.name] = "class"
        elif isinstance(node, ast.FunctionDef):
            is_property = any(isinstance(d, ast.Name) and d.id == "property" for d in node.decorator_list)
            members[node.name] = "property" if is_property else defaults_as_text(node.args)
    return members


def module_members(owner: ModuleType | type) -> dict[str, str]:
    members = {}
    for name, value in vars(owner).items():
        if name.startswith("_"):
            continue
        if isinstance(value, type):
            members[name] = "class"
        elif inspect.isgetsetdescriptor(value):
            members[name] = "property"
        else:
            members[name] = signature_text(value)
    return members


def test_functions_and_classes_are_those_of_the_module() -> None:
    expected = stub_members(STUB.body)
    found = module_members(_geom)
    assert found == expected
    assert len(found) >= 20


@pytest.mark.parametrize("node", [n for n in STUB.body if isinstance(n, ast.ClassDef)], ids=lambda n: n.name)
def test_members_of_each_class_are_those_of_the_module(node: ast.ClassDef) -> None:
    expected = stub_members(node.body)
    found = module_members(getattr(_geom, node.name))
    found["__init__"] = ",".join(filter(None, ["self", signature_text(getattr(_geom, node.name))]))
    assert found == expected


# --- arrays ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def noisy() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    faces = mesh.faces.astype(np.uint32)
    return add_noise(np.array(mesh.vertices), faces, kind="isotropic", level=0.3, seed=2), faces


def test_columns_of_world_from_patch_are_the_axes(noisy: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = noisy
    extractor = _geom.PatchExtractor(_geom.Topology(faces, len(vertices)), vertices, n_nodes=32)
    centers = np.arange(0, 320, 16, dtype=np.uint32)
    n = len(centers)
    features, neighbors = np.empty((n, 32, 17), np.float32), np.empty((n, 32, 3), np.int32)
    face_ids, mask = np.empty((n, 32), np.uint32), np.empty((n, 32), np.uint8)
    world_from_patch, radii = np.empty((n, 3, 3)), np.empty(n)
    extractor.extract(centers, features, neighbors, face_ids, mask, world_from_patch, radii)
    normals, centroids, areas = _geom.face_geometry(vertices, faces)
    for p in range(n):
        rotation = world_from_patch[p]
        # None is near to its own transpose, so that the checks below tell rows from columns.
        assert np.abs(rotation - rotation.T).max() > 0.05
        assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-12
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        ids = face_ids[p]
        assert ids[0] == centers[p]
        for node, face_id in enumerate(ids):
            offset = (centroids[face_id] - centroids[ids[0]]) / radii[p]
            assert np.abs(features[p, node, 0:3] - rotation.T @ offset).max() < 1e-6
            assert np.abs(features[p, node, 3:6] - rotation.T @ normals[face_id]).max() < 1e-6
            corners = (vertices[faces[face_id]] - centroids[face_id]) / radii[p]
            first = np.argmin(np.linalg.norm(vertices[faces[face_id]] - centroids[ids[0]], axis=1))
            in_order = np.roll(corners, -first, axis=0) @ rotation
            assert np.abs(features[p, node, 8:17] - in_order.ravel()).max() < 1e-6
        # e₁ is where the normals of the patch point.
        assert (areas[ids] @ normals[ids]) @ rotation[:, 0] > 0


def test_predictions_are_turned_back_by_the_columns() -> None:
    angle = 0.4
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    frame = (turn @ np.eye(3)[[1, 2, 0]])[None]
    predicted = np.array([[0.6, 0.0, 0.8]], np.float32)
    expected = frame[0] @ [0.6, 0.0, 0.8]
    fallback = np.zeros((1, 3))
    centres = _geom.NormalAccumulator(1)
    centres.add_centers(np.array([0], np.uint32), frame, predicted)
    assert np.abs(centres.normals(fallback)[0] - expected).max() < 1e-7
    nodes = _geom.NormalAccumulator(1)
    features = np.zeros((1, 1, 8), np.float32)
    nodes.add_nodes(
        features, np.zeros((1, 1), np.uint32), np.ones((1, 1), np.uint8), frame, predicted[:, None]
    )
    assert np.abs(nodes.normals(fallback)[0] - expected).max() < 1e-7


def test_arrays_out_of_order_are_refused_and_not_misread(noisy: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = noisy
    fortran = np.asfortranarray(vertices)
    with pytest.raises(ConfigError, match="vertices must be a contiguous array in C order"):
        _geom.face_geometry(fortran, faces)
    with pytest.raises(ConfigError, match="faces must be a contiguous array in C order"):
        _geom.Topology(np.asfortranarray(faces), len(vertices))
    with pytest.raises(ConfigError, match="vertices must be a contiguous array in C order"):
        _geom.face_geometry(np.repeat(vertices, 2, axis=0)[::2], faces)
    values = np.asfortranarray(np.ones((2, 3, 4), np.float32))
    with pytest.raises(ConfigError, match="C order"):
        _geom.gather_max(values, np.zeros((2, 3, 1), np.int32), np.empty((2, 3, 4), np.float32))


def test_shapes_and_types_are_refused_by_name(noisy: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = noisy
    with pytest.raises(ConfigError, match=r"vertices has shape \[162, 2\], expected \(n, 3\)"):
        _geom.face_geometry(np.ascontiguousarray(vertices[:, :2]), faces)
    with pytest.raises(TypeError):
        _geom.face_geometry(vertices.astype(np.float32), faces)
    with pytest.raises(ConfigError, match="float64"):
        _geom.gather_max(np.ones((1, 2, 3)), np.zeros((1, 2, 1), np.int32), np.ones((1, 2, 3)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"patch_scale": 1.9}, "patch_scale is 1.9, allowed: 2 to 10"),
        ({"n_nodes": 8}, "n_nodes is 8, allowed: 16 to 512"),
        ({"sigma_vote": 0.0}, "sigma_vote is 0"),
        ({"budget": "few"}, "budget is few, allowed: nearest or random"),
        ({"sheets": "both"}, "sheets is both, allowed: all or one"),
        ({"voting_region": "ring"}, "voting_region is ring, allowed: patch, two_ring or nobody"),
    ],
)
def test_parameters_out_of_range_are_config_errors(
    noisy: tuple[np.ndarray, np.ndarray], options: dict[str, Any], message: str
) -> None:
    vertices, faces = noisy
    with pytest.raises(ConfigError, match=message):
        _geom.PatchExtractor(_geom.Topology(faces, len(vertices)), vertices, **options)


def test_errors_of_the_core_are_the_packages_own(noisy: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = noisy
    assert issubclass(MeshError, GcndError)
    broken, holed = faces.copy(), vertices.copy()
    broken[3, 1], holed[5, 2] = 162, np.inf
    with pytest.raises(MeshError, match=r"face 3 .*vertex 162"):
        _geom.Topology(broken, 162)
    with pytest.raises(MeshError, match="vertex 5"):
        _geom.validate(holed, faces)
    with pytest.raises(ConfigError, match="normals"):
        _geom.update_vertices(_geom.Topology(faces, 162), vertices, vertices, 1)
