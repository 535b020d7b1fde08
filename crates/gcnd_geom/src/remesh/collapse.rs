//! Collapsing short edges.

use glam::DVec3;

use super::dynamic::{DynamicMesh, LOCKED, quality};
use super::split::SPLIT_RATIO;
use super::surface::nearest_on_segment;

/// Edges shorter than this times the wanted length are collapsed (Botsch & Kobbelt 2004).
const COLLAPSE_RATIO: f64 = 4.0 / 5.0;

/// A collapse may not turn a face by more than this: cos 45°.
const MIN_TURN_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A vertex of a feature curve may only go if it lies this close to the new edge, in lengths of that edge.
const MAX_CURVE_DEVIATION: f64 = 0.1;

/// Below this quality a triangle is a sliver and may only get better.
const SLIVER_QUALITY: f64 = 0.1;

/// Below this quality a triangle's normal means little, and the normal of its surroundings is used instead.
const MEANINGLESS_QUALITY: f64 = 0.02;

/// No face is made with less quality than this.
const MIN_QUALITY: f64 = 1e-4;

/// Collapses edges shorter than 4/5 of their wanted length, shortest first.
pub(super) fn collapse_short_edges(mesh: &mut DynamicMesh) {
    let mut short: Vec<(f64, u32, u32)> = mesh
        .edges()
        .into_iter()
        .map(|(a, b)| (mesh.edge_length(a, b) / mesh.wanted_length(a, b), a, b))
        .filter(|edge| edge.0 < COLLAPSE_RATIO)
        .collect();
    short.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    let mut scratch = [Vec::new(), Vec::new()];
    for (_, a, b) in short {
        let still_short = mesh.edge_length(a, b) < COLLAPSE_RATIO * mesh.wanted_length(a, b);
        if still_short && mesh.is_edge(a, b) {
            // The curve decides which end stays; between equals try both.
            let _ = try_collapse(mesh, a, b, &mut scratch) || try_collapse(mesh, b, a, &mut scratch);
        }
    }
}

/// Merges `removed` into `kept` if nothing is lost by it; says whether it did.
fn try_collapse(mesh: &mut DynamicMesh, removed: u32, kept: u32, scratch: &mut [Vec<u32>; 2]) -> bool {
    if !features_allow(mesh, removed, kept) || !link_condition(mesh, removed, kept, scratch) {
        return false;
    }
    let both_smooth = mesh.is_smooth(removed) && mesh.is_smooth(kept);
    let target =
        if both_smooth { 0.5 * (mesh.position(removed) + mesh.position(kept)) } else { mesh.position(kept) };
    let too_long = |v: u32, other: u32| {
        v != other && mesh.position(v).distance(target) > SPLIT_RATIO * mesh.wanted_length(v, other)
    };
    let [around_removed, around_kept] = scratch;
    if around_removed.iter().any(|&v| v != kept && too_long(v, kept))
        || (both_smooth && around_kept.iter().any(|&v| v != removed && too_long(v, kept)))
        || !may_move(mesh, removed, target, Some(kept), MIN_TURN_COS)
        || (both_smooth && !may_move(mesh, kept, target, Some(removed), MIN_TURN_COS))
    {
        return false;
    }
    mesh.collapse_edge(removed, kept);
    mesh.positions[kept as usize] = target;
    true
}

/// A corner stays; a vertex of a feature curve goes only along the curve, where the curve is straight enough.
fn features_allow(mesh: &DynamicMesh, removed: u32, kept: u32) -> bool {
    if mesh.fixed[removed as usize] {
        return false;
    }
    let links = &mesh.links[removed as usize];
    if links.is_empty() {
        return true;
    }
    let Some(other) = links.iter().find(|link| link.to != kept) else { return false };
    if links.len() != 2 || links.iter().any(|link| link.chain == LOCKED) || mesh.link(removed, kept).is_none()
    {
        return false;
    }
    // The curve must not fold onto an edge that is there already.
    if mesh.is_edge(other.to, kept) {
        return false;
    }
    let (from, to) = (mesh.position(other.to), mesh.position(kept));
    let here = mesh.position(removed);
    nearest_on_segment(here, from, to).distance(here) <= MAX_CURVE_DEVIATION * from.distance(to)
}

/// The two ends share exactly the vertices opposite their edge, so that merging keeps the surface a surface.
fn link_condition(mesh: &DynamicMesh, a: u32, b: u32, [around_a, around_b]: &mut [Vec<u32>; 2]) -> bool {
    let (faces, count) = mesh.edge_faces(a, b);
    if count == 0 || count > 2 {
        return false;
    }
    mesh.neighbors(a, around_a);
    mesh.neighbors(b, around_b);
    if around_a.iter().filter(|v| around_b.contains(v)).count() != count {
        return false;
    }
    // An opposite vertex of three faces would be left with two, back to back.
    faces[..count].iter().all(|&face_id| {
        let opposite = mesh.opposite(face_id, a, b);
        mesh.vertex_faces[opposite as usize].len() > 3 || on_boundary(mesh, opposite)
    }) && around_a.len() + around_b.len() - 2 - count >= 3
}

/// One of the edges at `v` has a single face.
pub(super) fn on_boundary(mesh: &DynamicMesh, v: u32) -> bool {
    mesh.links[v as usize].iter().any(|link| mesh.edge_faces(v, link.to).1 == 1)
}

/// Whether the faces at `v`, except those that also hold `except`, survive moving `v` to `target`.
///
/// They survive if each turns by less than `min_cos` says, and none becomes a worse sliver than the worst face that
/// was there before, `except`'s faces included.
pub(super) fn may_move(mesh: &DynamicMesh, v: u32, target: DVec3, except: Option<u32>, min_cos: f64) -> bool {
    let mut old_worst = f64::INFINITY;
    let mut new_worst = f64::INFINITY;
    for &face_id in &mesh.vertex_faces[v as usize] {
        let face = mesh.faces[face_id as usize];
        let [a, b, c] = face.map(|w| mesh.position(w));
        let old_quality = quality(a, b, c);
        old_worst = old_worst.min(old_quality);
        if except.is_some_and(|other| face.contains(&other)) {
            continue;
        }
        let [a, b, c] = face.map(|w| if w == v { target } else { mesh.position(w) });
        new_worst = new_worst.min(quality(a, b, c));
        let new = (b - a).cross(c - a);
        let old = if old_quality > MEANINGLESS_QUALITY {
            mesh.cross(face_id)
        } else {
            region_normal(mesh, v, mesh.regions[face_id as usize])
        };
        let turned = new.dot(old) < min_cos * new.length() * old.length();
        if turned || new_worst <= MIN_QUALITY {
            return false;
        }
    }
    new_worst >= SLIVER_QUALITY || new_worst > old_worst
}

/// Area-weighted sum of the normals at `v` within one region: the side of a crease that the region is on.
pub(super) fn region_normal(mesh: &DynamicMesh, v: u32, region: u32) -> DVec3 {
    let faces = mesh.vertex_faces[v as usize].iter();
    faces.filter(|&&f| mesh.regions[f as usize] == region).map(|&f| mesh.cross(f)).sum()
}
