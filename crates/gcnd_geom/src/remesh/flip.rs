//! Flipping edges towards valence six and better angles.

use super::collapse::on_boundary;
use super::dynamic::{DynamicMesh, quality};

/// Flipped faces may not turn by more than this: cos 45°.
const MIN_TURN_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A flip may make the fold over its edge sharper by at most this much in the cosine.
const MAX_FOLD_GAIN: f64 = 0.02;

/// Faces count as lying in one plane up to rounding.
const MIN_FLAT_COS: f64 = 1.0 - 1e-12;

/// What a flip is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// Valence six inside, four on a boundary (Botsch & Kobbelt 2004).
    Valence,
    /// The better of the two worse triangles.
    Shape,
    /// As `Shape`, only where the two faces lie in one plane, so that the surface stays the same.
    FlatShape,
}

/// Flips every edge, in id order, whose flip serves the aim and loses no geometry.
pub(super) fn flip_edges(mesh: &mut DynamicMesh, aim: Aim) {
    for (a, b) in mesh.edges() {
        try_flip(mesh, a, b, aim);
    }
}

/// Flips one edge if its flip serves the aim and loses no geometry; says whether it did.
pub(super) fn try_flip(mesh: &mut DynamicMesh, a: u32, b: u32, aim: Aim) -> bool {
    let (mut faces, count) = mesh.edge_faces(a, b);
    if count != 2 || mesh.link(a, b).is_some() {
        return false;
    }
    let first = mesh.faces[faces[0] as usize];
    if !(0..3).any(|i| first[i] == a && first[(i + 1) % 3] == b) {
        faces.swap(0, 1);
    }
    let [c, d] = faces.map(|face_id| mesh.opposite(face_id, a, b));
    let leaves_two_faces = [a, b].iter().any(|&v| mesh.vertex_faces[v as usize].len() <= 3);
    if c == d || leaves_two_faces || mesh.is_edge(c, d) {
        return false;
    }
    let [pa, pb, pc, pd] = [a, b, c, d].map(|v| mesh.position(v));
    let old_worst = quality(pa, pb, pc).min(quality(pb, pa, pd));
    let new_worst = quality(pa, pd, pc).min(quality(pd, pb, pc));
    let wanted = match aim {
        Aim::Shape | Aim::FlatShape => new_worst > old_worst + 1e-3,
        // Valence counts for little where a triangle is already bad.
        Aim::Valence if old_worst < 0.3 => new_worst > old_worst,
        Aim::Valence => new_worst > 0.3 && valence_gain(mesh, [a, b], [c, d]) > 0,
    };
    if !wanted {
        return false;
    }
    let old = faces.map(|face_id| mesh.cross(face_id));
    let new = [(pd - pa).cross(pc - pa), (pb - pd).cross(pc - pd)];
    let sum = (old[0] + old[1]).normalize_or_zero();
    let keeps_side = new.iter().all(|n| n.dot(sum) > MIN_TURN_COS * n.length());
    let fold = |pair: [glam::DVec3; 2]| pair[0].normalize_or_zero().dot(pair[1].normalize_or_zero());
    let keeps_fold = match aim {
        Aim::FlatShape => old_worst > 1e-6 && fold(old).min(fold(new)) > MIN_FLAT_COS,
        _ => old_worst < 1e-4 || fold(new) >= fold(old) - MAX_FOLD_GAIN,
    };
    if keeps_side && keeps_fold {
        mesh.flip_edge([a, b], [c, d], faces);
        return true;
    }
    false
}

/// By how much the flip brings the four vertices nearer to their ideal valence.
fn valence_gain(mesh: &DynamicMesh, losing: [u32; 2], gaining: [u32; 2]) -> i64 {
    let excess = |v: u32| -> i64 {
        let n_faces = mesh.vertex_faces[v as usize].len() as i64;
        if mesh.links[v as usize].is_empty() {
            n_faces - 6
        } else if on_boundary(mesh, v) {
            n_faces - 3
        } else {
            n_faces - 6
        }
    };
    let gain = |v: u32, step: i64| {
        if mesh.fixed[v as usize] { 0 } else { excess(v).abs() - (excess(v) + step).abs() }
    };
    losing.iter().map(|&v| gain(v, -1)).sum::<i64>() + gaining.iter().map(|&v| gain(v, 1)).sum::<i64>()
}
