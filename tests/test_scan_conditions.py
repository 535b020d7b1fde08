"""What real scans bring along: dirt, rims, holes, islands, uneven triangles, odd edges, thin walls. Lengths in edges.

Each with two presets. `scan` has wide patches and leaves more of this noise, which has no width: a mean of 1.3° on the
sheet without anything else, where `fast` leaves 0.4°. So the two have bounds of their own.
"""

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


@pytest.fixture(scope="module", params=["fast", "scan"])
def shipped(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def undisturbed(shipped: str) -> np.ndarray:
    """Errors of the sheet without anything else, by face."""
    return angles(cleaned(NOISY, FACES, preset=shipped), TRUTH, FACES)


def test_flying_triangles_leave_what_is_below_alone(shipped: str, undisturbed: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    spots = TRUTH[rng.choice(N, 12, replace=False)] + [0.0, 0.0, 1.0]
    flying = (spots[:, None] + 0.8 * rng.normal(size=(12, 3, 3))).reshape(-1, 3)
    faces = np.concatenate([FACES, N + np.arange(36).reshape(-1, 3)]).astype(np.uint32)
    result = cleaned(np.concatenate([NOISY, flying]), faces, preset=shipped)
    near = distance_to(spots, TRUTH, FACES) < 3.0
    found = angles(result[:N], TRUTH, FACES)
    assert angles(NOISY, TRUTH, FACES)[near].mean() > 15.0
    share, mean = {"fast": (1.2, 1.0), "scan": (1.0, 2.0)}[shipped]
    assert found[near].mean() < share * undisturbed[near].mean() < mean
    assert found[near].max() < {"fast": 3.0, "scan": 1.3 * undisturbed[near].max()}[shipped]


def test_triangles_that_hang_on_the_rim_leave_it_alone(shipped: str, undisturbed: np.ndarray) -> None:
    """Each has two vertices of the sheet and a point nine edges off, which stays off."""
    starts = np.arange(3, SIDE - 3, 6)
    edges = np.column_stack([(starts + 1) * (SIDE + 1), starts * (SIDE + 1)])
    middles = TRUTH[edges].mean(axis=1)
    faces = np.concatenate([FACES, np.column_stack([edges, N + np.arange(len(edges))])]).astype(np.uint32)
    tips = middles + np.array([0.0, -1.0, 9.0])
    result = cleaned(np.concatenate([NOISY, tips]), faces, preset=shipped)
    found, distance = angles(result[:N], TRUTH, FACES), distance_to(middles, TRUTH, FACES)
    for part in (distance >= 3.0, distance < 3.0):
        assert found[part].mean() < 1.1 * undisturbed[part].mean()
    assert np.linalg.norm(result[N:] - tips, axis=1).max() < 0.5
    held = cleaned(np.concatenate([NOISY, tips]), faces, boundary="fixed", preset=shipped)
    assert (held[N:] == tips).all()


@pytest.mark.parametrize("height", [-8.0, 6.5, 8.0, 1000.0])
def test_spikes_of_one_vertex_leave_no_trace(height: float, shipped: str, undisturbed: np.ndarray) -> None:
    spikes = np.array([7, 14, 21])[:, None] * (SIDE + 1) + np.array([8, 15, 22])
    noisy = NOISY.copy()
    noisy[spikes, 2] += height
    result = cleaned(noisy, FACES, preset=shipped)
    found, distance = angles(result, TRUTH, FACES), distance_to(TRUTH[spikes].reshape(-1, 3), TRUTH, FACES)
    assert angles(noisy, TRUTH, FACES)[np.isin(FACES, spikes).any(axis=1)].mean() > 75.0
    for part in (distance < 2.0, (distance >= 2.0) & (distance < 4.0), distance >= 4.0):
        assert found[part].mean() < 1.2 * undisturbed[part].mean()
    assert abs(result[spikes, 2]).max() < {"fast": 0.1, "scan": 0.14}[shipped]


def test_slivers_leave_their_neighbours_alone(shipped: str, undisturbed: np.ndarray) -> None:
    split = np.random.default_rng(4).choice(len(FACES), 40, replace=False)
    weights = np.array([0.4995, 0.4995, 0.001])
    truth, noisy = (
        np.concatenate([v, np.einsum("k,fkx->fx", weights, v[FACES[split]])]) for v in (TRUTH, NOISY)
    )
    a, b, c = FACES[split].T
    new = N + np.arange(len(split))
    parts = [np.column_stack(part) for part in ((a, b, new), (b, c, new), (c, a, new))]
    faces = np.concatenate([np.delete(FACES, split, axis=0), *parts]).astype(np.uint32)
    result = cleaned(noisy, faces, preset=shipped)
    found, distance = angles(result, truth, faces), distance_to(truth[new], truth, faces)
    is_sliver = np.isin(np.arange(len(faces)), len(FACES) - len(split) + np.arange(len(split)))
    near = (distance < 1.5) & ~is_sliver
    share, same_place, way = {"fast": (1.2, 1.35, 0.15), "scan": (1.5, 1.1, 0.012)}[shipped]
    assert found[near].mean() < share * found[(distance >= 1.5) & ~is_sliver].mean()
    assert found[near].mean() < 1.2 * undisturbed.mean()
    assert found[near].mean() < same_place * undisturbed[distance_to(truth[new], TRUTH, FACES) < 1.5].mean()
    # And the vertices that make them stay between those that they stood between.
    assert np.linalg.norm(result[new] - result[[a, b]].mean(axis=0), axis=1).max() < way


def test_a_ragged_rim_stays_and_all_is_clean_up_to_it(shipped: str) -> None:
    radii = 11.0 + 1.2 * np.random.default_rng(8).normal(size=len(FACES))
    faces = FACES[np.linalg.norm(TRUTH[FACES].mean(axis=1)[:, :2] - SIDE / 2, axis=1) < radii]
    result = cleaned(NOISY, faces, preset=shipped)
    rim = np.unique(np.concatenate(rim_loops(faces)))
    at_rim = np.isin(faces, rim).any(axis=1)
    assert at_rim.sum() > 250
    in_plane, height, share_at_rim, share_inside = {
        "fast": (0.08, 0.55, 0.10, 0.04),
        "scan": (0.05, 0.75, 0.13, 0.06),
    }[shipped]
    way, noise = (result - TRUTH)[rim], (NOISY - TRUTH)[rim, 2]
    assert np.sqrt((way[:, :2] ** 2).sum(axis=1).mean()) < in_plane
    assert np.sqrt((way[:, 2] ** 2).mean()) < height * np.sqrt((noise**2).mean())
    found, before = angles(result, TRUTH, faces), angles(NOISY, TRUTH, faces)
    assert found[at_rim].mean() < share_at_rim * before[at_rim].mean()
    assert found[~at_rim].mean() < share_inside * before[~at_rim].mean()


def test_holes_stay_holes(shipped: str) -> None:
    middles = TRUTH[FACES].mean(axis=1)
    centres = np.array([[7.0, 7.0], [20.0, 8.0], [13.0, 20.0]])
    is_hole = (np.linalg.norm(middles[:, None, :2] - centres, axis=2) < [2.0, 3.0, 4.5]).any(axis=1)
    faces = FACES[~is_hole]
    result, unbroken = (cleaned(NOISY, f, preset=shipped) for f in (faces, FACES))
    loops = rim_loops(faces)
    assert len(loops) == 4
    in_height, length_share = {"fast": (0.5, 0.01), "scan": (0.75, 0.003)}[shipped]
    for loop in loops:
        is_outline = 0 in loop
        way = (result - TRUTH)[loop]
        # In the plane no vertex leaves the outline, and in height most of the noise goes.
        in_plane = {"fast": 0.06, "scan": 0.13 if is_outline else 0.025}[shipped]
        assert np.linalg.norm(way[:, :2], axis=1).max() < in_plane
        # But the straight outline `scan` bends towards the back, corners by 0.4 edges, with holes as without.
        start, share = (unbroken, 1.2) if shipped == "scan" and is_outline else (NOISY, in_height)
        assert np.sqrt((way[:, 2] ** 2).mean()) < share * np.sqrt(((start - TRUTH)[loop, 2] ** 2).mean())
        length, true_length = (
            np.linalg.norm(v[loop] - np.roll(v[loop], -1, axis=0), axis=1).sum() for v in (result, TRUTH)
        )
        assert length == pytest.approx(true_length, rel=length_share)


def test_small_islands_stay_put(shipped: str) -> None:
    truths, noisy, faces = [TRUTH], [NOISY], [FACES]
    for number in range(5):
        island, ids = even_sheet(2)
        island = island + np.array([5.0 * number, 3.0 * number, 6.0])
        faces.append(ids + N + 9 * number)
        truths.append(island)
        noisy.append(with_noise(island, 10 + number))
    before, all_faces = np.concatenate(noisy), np.concatenate(faces)
    result = cleaned(before, all_faces, preset=shipped)
    ways = (result - before)[N:].reshape(5, 9, 3)
    way, share = {"fast": (0.1, 0.6), "scan": (0.05, 0.45)}[shipped]
    assert np.linalg.norm(ways.mean(axis=1), axis=1).max() < way
    found, noise = (angles(v, np.concatenate(truths), all_faces)[len(FACES) :] for v in (result, before))
    assert found.mean() < share * noise.mean()


def test_triangles_of_a_thousandth_of_the_area(shipped: str) -> None:
    places = np.concatenate([[0.0], np.cumsum(np.geomspace(0.05, 1.6, 40))])
    truth, faces = sheet(places, places)
    spacing = np.gradient(places)
    noisy = with_noise(truth, 2, 0.2 * np.minimum(spacing[:, None], spacing).ravel())
    a, b, c = (truth[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    assert areas.max() / areas.min() > 1000.0
    result = cleaned(noisy, faces, preset=shipped)
    found, before = angles(result, truth, faces), angles(noisy, truth, faces)
    for quarter in np.array_split(np.argsort(areas), 4):
        assert found[quarter].mean() < {"fast": 0.15, "scan": 0.08}[shipped] * before[quarter].mean()


def test_three_sheets_on_one_edge_and_two_at_one_point(shipped: str) -> None:
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
    result = cleaned(truth + noise, faces, preset=shipped)
    found, before = angles(result, truth, faces), angles(truth + noise, truth, faces)
    at_edge = np.isin(faces, line).any(axis=1)
    at_point = np.isin(faces, N - 1).any(axis=1)
    assert at_edge.sum() == 6 * SIDE
    assert at_point.sum() >= 2
    shares = {"fast": (0.25, 0.5, 0.15), "scan": (0.21, 0.15, 0.15)}[shipped]
    for part, share in zip((at_edge, at_point, ~at_edge & ~at_point), shares, strict=True):
        assert found[part].mean() < share * before[part].mean()


def thin_wall(gap: float, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Two sheets back to back, with noise that lets the closest cross; the back's vertices and faces come last."""
    front, back = with_noise(TRUTH + np.array([0.0, 0.0, gap]), 5, level), with_noise(TRUTH, 6, level)
    return np.concatenate([front, back]), np.concatenate([FACES, FACES[:, ::-1] + N]).astype(np.uint32)


@pytest.mark.parametrize("gap", [0.15, 0.5, 1.0])
@pytest.mark.parametrize("level", [0.03, 0.1, 0.2])
def test_the_sheets_of_a_thin_wall_are_as_good_as_alone(gap: float, level: float, shipped: str) -> None:
    noisy, faces = thin_wall(gap, level)
    both = cleaned(noisy, faces, preset=shipped)
    # Of noise of 0.03 edges `scan` leaves a quarter, on a sheet alone as well.
    little = 0.33 if level == 0.03 else 0.11
    share, of_noise, apart = {"fast": (1.1, 0.1, 0.02), "scan": (1.5, little, 0.035)}[shipped]
    for part, ids in ((slice(None, N), FACES), (slice(N, None), FACES[:, ::-1])):
        single = cleaned(noisy[part], ids, preset=shipped)
        found, wanted = (angles(v, TRUTH, ids).mean() for v in (both[part], single))
        assert found < share * wanted + 0.02
        assert found < of_noise * angles(noisy[part], TRUTH, ids).mean()
        assert np.sqrt(((both[part] - single) ** 2).sum(axis=1).mean()) < apart


def test_the_sheets_of_a_thin_wall_do_not_see_each_other(shipped: str) -> None:
    """Sheets that almost touch go where those a hundred edges apart go."""
    (thin, faces), (wide, _) = thin_wall(0.15, 0.2), thin_wall(100.0, 0.2)
    ways = [cleaned(noisy, faces, preset=shipped) - noisy for noisy in (thin, wide)]
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-9)
