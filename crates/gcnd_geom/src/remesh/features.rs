//! Which edges are features, which vertices are corners, and the smooth regions in between.

use std::collections::HashMap;

use glam::DVec3;

use super::dynamic::{DynamicMesh, LOCKED, Link};
use crate::mesh::Face;

/// A feature curve that turns by more than this at a vertex has a corner there: cos 45°.
const MIN_CURVE_COS: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Marks feature edges, corners and regions on a fresh mesh.
///
/// A feature edge is sharper than `feature_angle_deg`, or on a boundary. An edge of more than two faces, or of
/// two faces that disagree about its direction, is locked with both its vertices.
pub(super) fn mark(mesh: &mut DynamicMesh, feature_angle_deg: f64) {
    mark_edges(mesh, feature_angle_deg);
    mark_corners(mesh);
    number_chains(mesh);
    number_regions(mesh);
}

/// The feature edges of the mesh as segments with their chain ids.
pub(super) fn segments(mesh: &DynamicMesh) -> Vec<([DVec3; 2], u32)> {
    let mut found = Vec::new();
    for (v, links) in mesh.links.iter().enumerate() {
        for link in links.iter().filter(|link| (v as u32) < link.to && link.chain != LOCKED) {
            found.push(([mesh.positions[v], mesh.position(link.to)], link.chain));
        }
    }
    found
}

fn mark_edges(mesh: &mut DynamicMesh, feature_angle_deg: f64) {
    let min_cos = feature_angle_deg.clamp(0.0, 180.0).to_radians().cos();
    let normals: Vec<DVec3> =
        (0..mesh.faces.len() as u32).map(|f| mesh.cross(f).normalize_or_zero()).collect();
    for (a, b) in mesh.edges() {
        let (faces, count) = mesh.edge_faces(a, b);
        let chain = match count {
            1 => 0,
            2 if !opposite_directions(mesh.faces[faces[0] as usize], mesh.faces[faces[1] as usize], a, b) => {
                LOCKED
            }
            2 => {
                let [n, m] = faces.map(|f| normals[f as usize]);
                // A face without area says nothing about the angle; its other edges do.
                if n == DVec3::ZERO || m == DVec3::ZERO || n.dot(m) >= min_cos {
                    continue;
                }
                0
            }
            _ => LOCKED,
        };
        mesh.links[a as usize].push(Link { to: b, chain });
        mesh.links[b as usize].push(Link { to: a, chain });
        if chain == LOCKED {
            mesh.fixed[a as usize] = true;
            mesh.fixed[b as usize] = true;
        }
    }
}

fn opposite_directions(first: Face, second: Face, a: u32, b: u32) -> bool {
    let forward = |face: Face| (0..3).any(|i| face[i] == a && face[(i + 1) % 3] == b);
    forward(first) != forward(second)
}

fn mark_corners(mesh: &mut DynamicMesh) {
    for v in 0..mesh.positions.len() {
        let links = &mesh.links[v];
        let corner = match links.len() {
            0 => false,
            2 => {
                let here = mesh.positions[v];
                let before = (here - mesh.position(links[0].to)).normalize_or_zero();
                let after = (mesh.position(links[1].to) - here).normalize_or_zero();
                before.dot(after) < MIN_CURVE_COS
            }
            _ => true,
        };
        if corner || n_fans(mesh, v as u32) > 1 {
            mesh.fixed[v] = true;
        }
    }
}

/// How many fans of edge-connected faces meet at a vertex; two or more pinch the surface.
fn n_fans(mesh: &DynamicMesh, v: u32) -> usize {
    let faces = &mesh.vertex_faces[v as usize];
    let mut fan: Vec<usize> = (0..faces.len()).collect();
    let mut n_fans = faces.len();
    for i in 0..faces.len() {
        for j in 0..i {
            let second = mesh.faces[faces[j] as usize];
            let shared = mesh.faces[faces[i] as usize].iter().filter(|w| second.contains(w)).count();
            let (from, to) = (fan[i], fan[j]);
            if shared >= 2 && from != to {
                fan.iter_mut().filter(|id| **id == from).for_each(|id| *id = to);
                n_fans -= 1;
            }
        }
    }
    n_fans
}

/// Numbers the feature curves: runs of feature edges between corners, or closed loops without one.
fn number_chains(mesh: &mut DynamicMesh) {
    let mut done: HashMap<(u32, u32), u32> = HashMap::new();
    let mut next = 0;
    for start in 0..mesh.positions.len() as u32 {
        for i in 0..mesh.links[start as usize].len() {
            let link = mesh.links[start as usize][i];
            if link.chain == LOCKED || done.contains_key(&key(start, link.to)) {
                continue;
            }
            for (from, to) in [(start, link.to), (link.to, start)] {
                walk(mesh, from, to, next, &mut done);
            }
            next += 1;
        }
    }
    for v in 0..mesh.positions.len() as u32 {
        for link in mesh.links[v as usize].iter_mut().filter(|link| link.chain != LOCKED) {
            link.chain = done.get(&key(v, link.to)).copied().unwrap_or(LOCKED);
        }
    }
}

/// Follows a feature curve from an edge until a corner or an edge already numbered.
fn walk(mesh: &DynamicMesh, mut from: u32, mut to: u32, chain: u32, done: &mut HashMap<(u32, u32), u32>) {
    loop {
        done.insert(key(from, to), chain);
        if mesh.fixed[to as usize] {
            return;
        }
        let onward = mesh.links[to as usize].iter().find(|link| link.to != from);
        match onward {
            Some(link) if !done.contains_key(&key(to, link.to)) => (from, to) = (to, link.to),
            _ => return,
        }
    }
}

fn key(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

fn number_regions(mesh: &mut DynamicMesh) {
    let mut region = vec![u32::MAX; mesh.faces.len()];
    let mut stack = Vec::new();
    let mut next = 0;
    for seed in 0..mesh.faces.len() {
        if region[seed] != u32::MAX {
            continue;
        }
        region[seed] = next;
        stack.push(seed as u32);
        while let Some(face_id) = stack.pop() {
            let face = mesh.faces[face_id as usize];
            for i in 0..3 {
                let (a, b) = (face[i], face[(i + 1) % 3]);
                if mesh.link(a, b).is_some() {
                    continue;
                }
                let (faces, count) = mesh.edge_faces(a, b);
                for &other in &faces[..count.min(2)] {
                    if region[other as usize] == u32::MAX {
                        region[other as usize] = next;
                        stack.push(other);
                    }
                }
            }
        }
        next += 1;
    }
    mesh.regions = region;
}
