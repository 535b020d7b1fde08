"""Meshes that earlier stages have denoised, kept on disk for the next stage to learn from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from train_cases import STAGE, clean, cube, sphere

from gcnd import _geom
from gcnd.errors import ConfigError
from gcnd.nn.networks import build_network
from gcnd.train.pool import _STREAM, DenoisedPool, run_stages
from gcnd.train.samples import CleanShape, FreshNoise, NoisyMesh


def test_a_pool_of_other_meshes_is_refused(tmp_path: Path) -> None:
    shapes = [clean(sphere()), clean(cube(4))]
    first = DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 3, 0)
    again = DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 3, 0)
    assert [member.shape for member in again.members] == [member.shape for member in first.members]
    other = [clean(cube(2)), *shapes]
    with pytest.raises(ConfigError, match="made from other meshes"):
        DenoisedPool(tmp_path, FreshNoise(other), other, [], 3, 0)


def cut(whole: bytes, left: int) -> bytes:
    return whole[:left]


def marked(whole: bytes, place: int) -> bytes:
    """An archive whose first entry has another byte at that place of its line in the directory."""
    at = whole.index(b"PK\x01\x02") + place
    return whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]


# Byte 8 says that an entry is encrypted, byte 10 how it is compressed.
@pytest.mark.parametrize(("damage", "place"), [(cut, 0), (cut, 100), (cut, 700), (marked, 8), (marked, 10)])
def test_a_damaged_mesh_is_denoised_again(
    tmp_path: Path, damage: Callable[[bytes, int], bytes], place: int
) -> None:
    shapes = [clean(sphere())]
    made = DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 2, 0)
    whole = (tmp_path / "0001.npz").read_bytes()
    (tmp_path / "0001.npz").write_bytes(damage(whole, place))
    said: list[tuple[int, int]] = []
    again = DenoisedPool(
        tmp_path, FreshNoise(shapes), shapes, [], 2, 0, progress=lambda *numbers: said.append(numbers)
    )
    assert said == [(1, 2), (2, 2)]
    assert all(
        np.array_equal(a.vertices, b.vertices) for a, b in zip(made.members, again.members, strict=True)
    )
    assert (tmp_path / "0001.npz").read_bytes()[:100] == whole[:100]
    DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 2, 0)


def test_a_pool_of_an_earlier_version_is_refused(tmp_path: Path) -> None:
    shapes = [clean(sphere())]
    DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 1, 0)
    with np.load(tmp_path / "0000.npz") as file:
        kept = {name: file[name] for name in file if name != "first"}
    np.savez(tmp_path / "0000.npz", **kept)
    with pytest.raises(ConfigError, match="by another version"):
        DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 1, 0)


def test_shapes_of_one_name_stay_apart_in_a_pool(tmp_path: Path) -> None:
    def named(shape: CleanShape) -> CleanShape:
        return replace(shape, name="part", kind="cad")

    shapes = [named(clean(sphere())), named(clean(cube(4)))]
    pool = DenoisedPool(tmp_path, FreshNoise(shapes), shapes, [], 12, 0)
    assert {member.shape for member in pool.members} == {0, 1}
    assert all(len(member.vertices) == len(shapes[member.shape].vertices) for member in pool.members)


def test_a_pool_keeps_what_its_meshes_were_before(tmp_path: Path) -> None:
    shapes = [clean(sphere())]
    torch.manual_seed(6)
    network = build_network(STAGE.network)
    # It moves vertices only if it is not the identity.
    torch.nn.init.normal_(network.out.weight, std=0.1)
    stages = [(STAGE, network.eval())]
    pool = DenoisedPool(tmp_path, FreshNoise(shapes), shapes, stages, 2, 0)
    rng = np.random.default_rng(0)
    drawn = {float(mesh.roughness[2]): mesh for mesh in (pool.draw(rng) for _ in range(20))}
    assert len(drawn) == 2
    for mesh in drawn.values():
        own = _geom.mesh_roughness(mesh.shape.topology, mesh.vertices)
        assert np.abs(mesh.roughness / own - 1).max() > 0.01
    noise = FreshNoise(shapes)
    originals = [noise.draw(np.random.default_rng([0, _STREAM, number])) for number in range(2)]
    assert sorted(drawn) == sorted(float(original.roughness[2]) for original in originals)
    for original in originals:
        first = drawn[float(original.roughness[2])].first
        np.testing.assert_array_equal(first, original.vertices.astype(np.float32))


def test_meshes_of_a_pool_have_further_passes_in_turn(tmp_path: Path) -> None:
    shapes = [clean(sphere())]
    torch.manual_seed(6)
    network = build_network(STAGE.network).eval()
    torch.nn.init.normal_(network.out.weight, std=0.1)
    noise, stage = FreshNoise(shapes), (STAGE, network)
    pool = DenoisedPool(tmp_path, noise, shapes, [], 8, 0, further=[stage] * 2)
    for number, n_passes in enumerate((0, 0, 1, 2, 0, 0, 1, 2)):
        mesh = NoisyMesh.untouched(
            shapes[0], noise.draw(np.random.default_rng([0, _STREAM, number])).vertices
        )
        expected = run_stages(mesh, [stage] * n_passes, number).vertices.astype(np.float32)
        np.testing.assert_array_equal(pool.members[number].vertices, expected)


def test_every_third_mesh_of_a_pool_has_a_further_pass(tmp_path: Path) -> None:
    shapes = [clean(sphere())]
    torch.manual_seed(6)
    first, further = build_network(STAGE.network).eval(), build_network(STAGE.network).eval()
    torch.nn.init.normal_(further.out.weight, std=0.1)
    noise = FreshNoise(shapes)
    once = DenoisedPool(tmp_path / "once", noise, shapes, [(STAGE, first)], 6, 0)
    pool = DenoisedPool(tmp_path / "more", noise, shapes, [(STAGE, first)], 6, 0, further=[(STAGE, further)])
    same = [np.array_equal(a.vertices, b.vertices) for a, b in zip(once.members, pool.members, strict=True)]
    assert same == [True, True, False, True, True, False]
    mesh = NoisyMesh.untouched(shapes[0], noise.draw(np.random.default_rng([0, _STREAM, 5])).vertices)
    twice = run_stages(mesh, [(STAGE, first), (STAGE, further)], 5)
    np.testing.assert_array_equal(pool.members[5].vertices, twice.vertices.astype(np.float32))
