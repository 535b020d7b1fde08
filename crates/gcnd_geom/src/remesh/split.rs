//! Splitting long edges.

use super::dynamic::{DynamicMesh, LOCKED};

/// Edges longer than this times the wanted length are split (Botsch & Kobbelt 2004).
pub(super) const SPLIT_RATIO: f64 = 4.0 / 3.0;

/// Splits every edge longer than 4/3 of its wanted length at its midpoint, longest first.
pub(super) fn split_long_edges(mesh: &mut DynamicMesh) {
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
            let middle = 0.5 * (mesh.position(a) + mesh.position(b));
            mesh.split_edge(a, b, middle);
        }
    }
}

fn may_split(mesh: &DynamicMesh, a: u32, b: u32) -> bool {
    mesh.edge_faces(a, b).1 <= 2 && mesh.link(a, b).is_none_or(|link| link.chain != LOCKED)
}
