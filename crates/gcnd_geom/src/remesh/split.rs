//! Splitting long edges.

use super::dynamic::{DynamicMesh, LOCKED};
use super::flip::{Aim, flip_edges, try_flip};

/// Edges longer than this times the wanted length are split (Botsch & Kobbelt 2004).
pub(super) const SPLIT_RATIO: f64 = 4.0 / 3.0;

/// Splits every edge longer than 4/3 of its wanted length at its midpoint, longest first.
pub(super) fn split_long_edges(mesh: &mut DynamicMesh) {
    split_in_passes(mesh, |_, _| {});
}

/// Splits as [`split_long_edges`] does and flips edges inside flat parts after every split.
///
/// The surface stays exactly the same; without the flips, long slivers would be cut into very many short ones.
pub(super) fn split_flat_parts_evenly(mesh: &mut DynamicMesh) {
    flip_edges(mesh, Aim::FlatShape);
    split_in_passes(mesh, flip_around);
}

/// Flips the edges across from a new vertex, and those across from it after that, while it helps.
fn flip_around(mesh: &mut DynamicMesh, v: u32) {
    let mut faces = mesh.vertex_faces[v as usize].clone();
    while let Some(face_id) = faces.pop() {
        let Some(slot) = mesh.faces[face_id as usize].iter().position(|&w| w == v) else { continue };
        let face = mesh.faces[face_id as usize];
        let (a, b) = (face[(slot + 1) % 3], face[(slot + 2) % 3]);
        let (neighbors, _) = mesh.edge_faces(a, b);
        if try_flip(mesh, a, b, Aim::FlatShape) {
            faces.extend(neighbors);
        }
    }
}

fn split_in_passes(mesh: &mut DynamicMesh, mut after_split: impl FnMut(&mut DynamicMesh, u32)) {
    // Each pass at least halves the longest edges; 64 halvings leave nothing of any double.
    for _ in 0..64 {
        let mut long: Vec<(f64, u32, u32)> = mesh
            .edges()
            .into_iter()
            .map(|(a, b)| (mesh.edge_length(a, b) / mesh.wanted_length(a, b), a, b))
            .filter(|&(ratio, a, b)| ratio > SPLIT_RATIO && may_split(mesh, a, b))
            .collect();
        if long.is_empty() {
            return;
        }
        long.sort_by(|x, y| y.0.total_cmp(&x.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        // Only the longest half of the range, so that the next pass sees the new, shorter edges first.
        let cutoff = (0.5 * long[0].0).max(SPLIT_RATIO);
        for (_, a, b) in long.into_iter().take_while(|edge| edge.0 >= cutoff) {
            if mesh.is_edge(a, b) {
                let middle = 0.5 * (mesh.position(a) + mesh.position(b));
                let v = mesh.split_edge(a, b, middle);
                after_split(mesh, v);
            }
        }
    }
}

fn may_split(mesh: &DynamicMesh, a: u32, b: u32) -> bool {
    if is_unsplittable(mesh, a, b) {
        return false;
    }
    // Beside a longer edge that stays, every split would only leave another long edge: a fan without end.
    let length = mesh.edge_length(a, b);
    let (faces, count) = mesh.edge_faces(a, b);
    faces[..count.min(2)].iter().all(|&face_id| {
        let c = mesh.opposite(face_id, a, b);
        [a, b].iter().all(|&v| mesh.edge_length(v, c) < length || !is_unsplittable(mesh, v, c))
    })
}

/// Locked, or between two faces on the same three vertices, which would share both halves of a split.
fn is_unsplittable(mesh: &DynamicMesh, a: u32, b: u32) -> bool {
    if mesh.link(a, b).is_some_and(|link| link.chain == LOCKED) {
        return true;
    }
    let (faces, count) = mesh.edge_faces(a, b);
    count > 2 || count == 2 && mesh.opposite(faces[0], a, b) == mesh.opposite(faces[1], a, b)
}
