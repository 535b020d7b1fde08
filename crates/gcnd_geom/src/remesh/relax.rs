//! Tangential smoothing on the input surface and along its feature curves.

use glam::DVec3;

use super::collapse::{may_move, region_normal};
use super::dynamic::{DynamicMesh, LOCKED};
use super::surface::Surface;

/// Relaxation may not turn a face by more than this: cos 60°.
const MIN_TURN_COS: f64 = 0.5;

/// The input, to which moved vertices return.
#[derive(Debug, Clone, Default)]
pub(super) struct Reference {
    /// Triangles by region.
    pub surface: Surface,
    /// Feature edges by chain.
    pub curves: Surface,
}

/// Moves every vertex once, in id order, towards the centre of its neighbourhood and back onto the input.
pub(super) fn relax_vertices(mesh: &mut DynamicMesh, reference: &Reference) {
    for v in 0..mesh.positions.len() as u32 {
        if mesh.fixed[v as usize] || mesh.vertex_faces[v as usize].is_empty() {
            continue;
        }
        if mesh.links[v as usize].is_empty() {
            relax_inside(mesh, reference, v);
        } else {
            relax_along_curve(mesh, reference, v);
        }
    }
}

fn relax_inside(mesh: &mut DynamicMesh, reference: &Reference, v: u32) {
    let here = mesh.position(v);
    let region = mesh.regions[mesh.vertex_faces[v as usize][0] as usize];
    let normal = region_normal(mesh, v, region).normalize_or_zero();
    if normal == DVec3::ZERO {
        return;
    }
    let step = centre(mesh, v) - here;
    let step = step - normal * step.dot(normal);
    try_positions(mesh, v, |share| reference.surface.nearest(here + step * share, region, normal));
}

fn relax_along_curve(mesh: &mut DynamicMesh, reference: &Reference, v: u32) {
    let &[first, second] = mesh.links[v as usize].as_slice() else { return };
    if first.chain == LOCKED || first.chain != second.chain {
        return;
    }
    let here = mesh.position(v);
    let (before, after) = (mesh.position(first.to), mesh.position(second.to));
    // Segment lengths in proportion to the wanted ones.
    let (w1, w2) = (1.0 / mesh.wanted_length(v, first.to), 1.0 / mesh.wanted_length(v, second.to));
    let tangent = (after - before).normalize_or_zero();
    let step = ((before * w1 + after * w2) / (w1 + w2) - here).dot(tangent) * tangent;
    try_positions(mesh, v, |share| reference.curves.nearest(here + step * share, first.chain, DVec3::ZERO));
}

/// Moves `v` to the first of the full, half and quarter step that spoils no face.
fn try_positions(mesh: &mut DynamicMesh, v: u32, target: impl Fn(f64) -> Option<DVec3>) {
    for share in [0.8, 0.4, 0.2] {
        let Some(position) = target(share) else { return };
        if may_move(mesh, v, position, None, MIN_TURN_COS) {
            mesh.positions[v as usize] = position;
            return;
        }
    }
}

/// Mean of the centroids of the faces at `v`, weighted by area in units of the wanted area.
fn centre(mesh: &DynamicMesh, v: u32) -> DVec3 {
    let mut sum = DVec3::ZERO;
    let mut total = 0.0;
    for &face_id in &mesh.vertex_faces[v as usize] {
        let face = mesh.faces[face_id as usize];
        let size: f64 = face.iter().map(|&w| mesh.sizes[w as usize]).sum();
        let weight = mesh.cross(face_id).length() / (size * size);
        sum += weight * face.iter().map(|&w| mesh.position(w)).sum::<DVec3>() / 3.0;
        total += weight;
    }
    if total > 0.0 { sum / total } else { mesh.position(v) }
}
