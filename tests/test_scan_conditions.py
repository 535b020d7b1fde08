"""What real scans bring along: dirt, holes, islands, uneven triangles, odd edges, thin walls. Lengths are in edges."""

from __future__ import annotations

import numpy as np
import pytest

from sheet_cases import (
    SIDE,
    angles,
    cleaned,
    distance_to,
    even_sheet,
    rim_loops,
    sheet,
    with_noise,
)

TRUTH, FACES = even_sheet()
NOISY = with_noise(TRUTH, 1)
N = len(TRUTH)


@pytest.fixture(scope="module")
def undisturbed() -> np.ndarray:
    """Errors of the sheet without anything else, by face."""
    return angles(cleaned(NOISY, FACES), TRUTH, FACES)


def test_flying_triangles_leave_what_is_below_alone(undisturbed: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    spots = TRUTH[rng.choice(N, 12, replace=False)] + [0.0, 0.0, 1.0]
    flying = (spots[:, None] + 0.8 * rng.normal(size=(12, 3, 3))).reshape(-1, 3)
    faces = np.concatenate([FACES, N + np.arange(36).reshape(-1, 3)]).astype(np.uint32)
    result = cleaned(np.concatenate([NOISY, flying]), faces)
    near = distance_to(spots, TRUTH, FACES) < 3.0
    found = angles(result[:N], TRUTH, FACES)
    assert angles(NOISY, TRUTH, FACES)[near].mean() > 15.0
    assert found[near].mean() < 1.2 * undisturbed[near].mean() < 1.0
    assert found[near].max() < 3.0


def test_triangles_that_hang_on_the_rim_leave_it_alone(undisturbed: np.ndarray) -> None:
    """Each has two vertices of the sheet and a point nine edges off, which stays off."""
    starts = np.arange(3, SIDE - 3, 6)
    edges = np.column_stack([(starts + 1) * (SIDE + 1), starts * (SIDE + 1)])
    middles = TRUTH[edges].mean(axis=1)
    faces = np.concatenate([FACES, np.column_stack([edges, N + np.arange(len(edges))])]).astype(np.uint32)
    tips = middles + np.array([0.0, -1.0, 9.0])
    result = cleaned(np.concatenate([NOISY, tips]), faces)
    found, distance = angles(result[:N], TRUTH, FACES), distance_to(middles, TRUTH, FACES)
    for part in (distance >= 3.0, distance < 3.0):
        assert found[part].mean() < 1.1 * undisturbed[part].mean()
    assert np.linalg.norm(result[N:] - tips, axis=1).max() < 0.5
    held = cleaned(np.concatenate([NOISY, tips]), faces, boundary="fixed")
    assert (held[N:] == tips).all()


@pytest.mark.parametrize("height", [-8.0, 6.5, 8.0, 1000.0])
def test_spikes_of_one_vertex_leave_no_trace(height: float, undisturbed: np.ndarray) -> None:
    spikes = np.array([7, 14, 21])[:, None] * (SIDE + 1) + np.array([8, 15, 22])
    noisy = NOISY.copy()
    noisy[spikes, 2] += height
    result = cleaned(noisy, FACES)
    found, distance = angles(result, TRUTH, FACES), distance_to(TRUTH[spikes].reshape(-1, 3), TRUTH, FACES)
    assert angles(noisy, TRUTH, FACES)[np.isin(FACES, spikes).any(axis=1)].mean() > 75.0
    for part in (distance < 2.0, (distance >= 2.0) & (distance < 4.0), distance >= 4.0):
        assert found[part].mean() < 1.2 * undisturbed[part].mean()
    assert abs(result[spikes, 2]).max() < 0.1


def test_slivers_leave_their_neighbours_alone(undisturbed: np.ndarray) -> None:
    split = np.random.default_rng(4).choice(len(FACES), 40, replace=False)
    weights = np.array([0.4995, 0.4995, 0.001])
    truth, noisy = (
        np.concatenate([v, np.einsum("k,fkx->fx", weights, v[FACES[split]])]) for v in (TRUTH, NOISY)
    )
    a, b, c = FACES[split].T
    new = N + np.arange(len(split))
    parts = [np.column_stack(part) for part in ((a, b, new), (b, c, new), (c, a, new))]
    faces = np.concatenate([np.delete(FACES, split, axis=0), *parts]).astype(np.uint32)
    result = cleaned(noisy, faces)
    found, distance = angles(result, truth, faces), distance_to(truth[new], truth, faces)
    is_sliver = np.isin(np.arange(len(faces)), len(FACES) - len(split) + np.arange(len(split)))
    near = (distance < 1.5) & ~is_sliver
    assert found[near].mean() < 1.2 * found[(distance >= 1.5) & ~is_sliver].mean()
    assert found[near].mean() < 1.2 * undisturbed.mean()
    # And the vertices that make them stay between those that they stood between.
    assert np.linalg.norm(result[new] - result[[a, b]].mean(axis=0), axis=1).max() < 0.15


def test_holes_stay_holes() -> None:
    middles = TRUTH[FACES].mean(axis=1)
    centres = np.array([[7.0, 7.0], [20.0, 8.0], [13.0, 20.0]])
    is_hole = (np.linalg.norm(middles[:, None, :2] - centres, axis=2) < [2.0, 3.0, 4.5]).any(axis=1)
    faces = FACES[~is_hole]
    result = cleaned(NOISY, faces)
    loops = rim_loops(faces)
    assert len(loops) == 4
    for loop in loops:
        way = (result - TRUTH)[loop]
        # In the plane no vertex leaves the outline, and in height most of the noise goes.
        assert np.linalg.norm(way[:, :2], axis=1).max() < 0.06
        assert np.sqrt((way[:, 2] ** 2).mean()) < 0.5 * np.sqrt(((NOISY - TRUTH)[loop, 2] ** 2).mean())
        length, true_length = (
            np.linalg.norm(v[loop] - np.roll(v[loop], -1, axis=0), axis=1).sum() for v in (result, TRUTH)
        )
        assert length == pytest.approx(true_length, rel=0.01)


def test_small_islands_stay_put() -> None:
    truths, noisy, faces = [TRUTH], [NOISY], [FACES]
    for number in range(5):
        island, ids = even_sheet(2)
        island = island + np.array([5.0 * number, 3.0 * number, 6.0])
        faces.append(ids + N + 9 * number)
        truths.append(island)
        noisy.append(with_noise(island, 10 + number))
    before, all_faces = np.concatenate(noisy), np.concatenate(faces)
    result = cleaned(before, all_faces)
    ways = (result - before)[N:].reshape(5, 9, 3)
    assert np.linalg.norm(ways.mean(axis=1), axis=1).max() < 0.1
    found, noise = (angles(v, np.concatenate(truths), all_faces)[len(FACES) :] for v in (result, before))
    assert found.mean() < 0.6 * noise.mean()


def test_triangles_of_a_thousandth_of_the_area() -> None:
    places = np.concatenate([[0.0], np.cumsum(np.geomspace(0.05, 1.6, 40))])
    truth, faces = sheet(places, places)
    spacing = np.gradient(places)
    noisy = with_noise(truth, 2, 0.2 * np.minimum(spacing[:, None], spacing).ravel())
    a, b, c = (truth[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    assert areas.max() / areas.min() > 1000.0
    found, before = angles(cleaned(noisy, faces), truth, faces), angles(noisy, truth, faces)
    for quarter in np.array_split(np.argsort(areas), 4):
        assert found[quarter].mean() < 0.15 * before[quarter].mean()


def test_three_sheets_on_one_edge_and_two_at_one_point() -> None:
    """A wall stands on the middle of the sheet; a second sheet touches a corner of the first."""
    line = np.arange(SIDE + 1) * (SIDE + 1) + SIDE // 2
    wall, wall_faces = sheet(np.arange(SIDE + 1.0), np.arange(8.0))
    ids = np.concatenate([line[:, None], N + np.arange(7 * (SIDE + 1)).reshape(-1, 7)], axis=1).ravel()
    upright = wall[:, [0, 2, 1]] + [0.0, SIDE // 2, 0.0]
    is_new = np.tile(np.arange(8) > 0, SIDE + 1)
    far, far_faces = even_sheet(10)
    far_ids = np.concatenate([[N - 1], N + 7 * (SIDE + 1) + np.arange(len(far) - 1)])
    truth = np.concatenate([TRUTH, upright[is_new], (far + np.array([SIDE, SIDE, 0.0]))[1:]])
    faces = np.concatenate([FACES, ids[wall_faces][:, ::-1], far_ids[far_faces]]).astype(np.uint32)
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(ends, axis=0, return_counts=True)[1].max() == 3
    noise = 0.2 * np.random.default_rng(6).normal(size=truth.shape)
    result = cleaned(truth + noise, faces)
    found, before = angles(result, truth, faces), angles(truth + noise, truth, faces)
    at_edge = np.isin(faces, line).any(axis=1)
    at_point = np.isin(faces, N - 1).any(axis=1)
    assert at_edge.sum() == 6 * SIDE
    assert at_point.sum() >= 2
    assert found[at_edge].mean() < 0.25 * before[at_edge].mean()
    assert found[at_point].mean() < 0.5 * before[at_point].mean()
    assert found[~at_edge & ~at_point].mean() < 0.15 * before[~at_edge & ~at_point].mean()


@pytest.mark.parametrize("gap", [0.15, 0.5, 1.0])
@pytest.mark.parametrize("level", [0.03, 0.1, 0.2])
def test_the_sheets_of_a_thin_wall_are_as_good_as_alone(gap: float, level: float) -> None:
    """Back to back, with noise that lets the closest cross."""
    backs = np.ascontiguousarray(FACES[:, ::-1])
    front, back = with_noise(TRUTH + np.array([0.0, 0.0, gap]), 5, level), with_noise(TRUTH, 6, level)
    both = cleaned(np.concatenate([front, back]), np.concatenate([FACES, backs + N]).astype(np.uint32))
    for result, alone, ids in ((both[:N], front, FACES), (both[N:], back, backs)):
        single = cleaned(alone, ids)
        found, wanted = angles(result, TRUTH, ids).mean(), angles(single, TRUTH, ids).mean()
        assert found < 1.1 * wanted + 0.02
        assert found < 0.1 * angles(alone, TRUTH, ids).mean()
        assert np.sqrt(((result - single) ** 2).sum(axis=1).mean()) < 0.02
