//! The normals of a mesh at several scales: what a face looks like once its surroundings are averaged.

use crate::error::Result;
use crate::face_geometry::normal_and_area;
use crate::topology::Topology;
use crate::watch::Ticks;
use glam::DVec3;
use rayon::prelude::*;

/// How many scales a face's normals are taken at.
pub(crate) const N_SCALES: usize = 3;

/// Iterations after which normals are taken, in rising order.
pub(crate) type Scales = [usize; N_SCALES];

/// A face's normals, one a scale.
pub(crate) type ScaleNormals = [DVec3; N_SCALES];

/// Of the mesh as it is.
pub(crate) const SCALES: Scales = [1, 4, 16];

/// The same for the mesh before its first pass, its normals as they are among them.
pub(crate) const FIRST_SCALES: Scales = [0, 1, 4];

/// A smoothed face with a smaller part of its area than this has shrunk to rounding errors.
const SMALLEST_AREA: f64 = 1e-12;

/// Faces or vertices of one unit of parallel work.
const CHUNK: usize = 4096;

/// Unit normals of every face (F), after each of `scales` iterations, in rising order, of the mesh smoothed by
/// v_i ← 1 / |F_i| · Σ_{f ∈ F_i} c_f, with F_i the faces of v_i and c_f their centroids.
///
/// Where triangles are small against the noise their own normals say little, and these say more. A face that has no
/// area when smoothed, or 10⁻¹² of what it had, as on a small component that shrinks to a point, has a zero normal
/// there; vertices without faces stay. `ticks` counts the iterations, as many as the last of `scales`.
///
/// Choice: docs/choices.md#features.
pub(crate) fn scale_space_normals(
    topology: &Topology,
    vertices: &[DVec3],
    scales: Scales,
    ticks: &mut Ticks<'_, '_>,
) -> Result<Vec<ScaleNormals>> {
    let mut normals = vec![[DVec3::ZERO; N_SCALES]; topology.n_faces()];
    let mut centroids = vec![DVec3::ZERO; topology.n_faces()];
    let mut current = vertices.to_vec();
    let mut next = current.clone();
    let mut done = 0;
    for (scale, &iterations) in scales.iter().enumerate() {
        for _ in done..iterations {
            place_centroids(topology, &current, &mut centroids);
            average(topology, &current, &centroids, &mut next);
            std::mem::swap(&mut current, &mut next);
            ticks.tick()?;
        }
        done = iterations;
        normals.par_iter_mut().zip(topology.faces()).with_min_len(CHUNK).for_each(|(normals, face)| {
            let area_of = |from: &[DVec3]| {
                let [a, b, c] = face.map(|v| from[v as usize]);
                normal_and_area(a, b, c)
            };
            let (normal, area) = area_of(&current);
            let kept = area > SMALLEST_AREA * area_of(vertices).1;
            normals[scale] = if kept { normal } else { DVec3::ZERO };
        });
    }
    Ok(normals)
}

pub(super) fn place_centroids(topology: &Topology, vertices: &[DVec3], centroids: &mut [DVec3]) {
    centroids.par_iter_mut().zip(topology.faces()).with_min_len(CHUNK).for_each(|(centroid, face)| {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        *centroid = a + ((b - a) + (c - a)) / 3.0;
    });
}

pub(super) fn average(topology: &Topology, current: &[DVec3], centroids: &[DVec3], next: &mut [DVec3]) {
    next.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(vertex_id, moved)| {
        let faces = topology.vertex_faces().row(vertex_id);
        let start = current[vertex_id];
        // Offsets from the vertex keep their digits far away from the origin.
        let sum: DVec3 = faces.iter().map(|&face_id| centroids[face_id as usize] - start).sum();
        *moved = if faces.is_empty() { start } else { start + sum / faces.len() as f64 };
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use crate::watch::Watch;

    fn normals_at_scales(topology: &Topology, vertices: &[DVec3]) -> Vec<[DVec3; 3]> {
        scale_space_normals(topology, vertices, SCALES, &mut Ticks::new(16, &mut Watch::silent()))
            .expect("goes on")
    }

    #[test]
    fn a_tetrahedron_shrinks_to_a_point_by_hand() {
        // Three centroids at a vertex v have the mean m + (v − m) / 9, m the middle of all: after 1 and 4 iterations the
        // faces have their normals still, after 16 they have 9⁻³² of their area.
        let (vertices, faces) = fixtures::tetrahedron();
        let topology = Topology::new(faces.clone(), 4).expect("valid");
        for (scale, shift) in [(1.0, DVec3::ZERO), (1.37, DVec3::new(3.0, -2.0, 5.0)), (1e-6, DVec3::X)] {
            let placed: Vec<DVec3> = vertices.iter().map(|&v| scale * v + shift).collect();
            let normals = normals_at_scales(&topology, &placed);
            for (face, at_scales) in faces.iter().zip(&normals) {
                let [a, b, c] = face.map(|v| placed[v as usize]);
                let own = normal_and_area(a, b, c).0;
                assert!(at_scales[0].distance(own) < 1e-8, "{at_scales:?}");
                assert!(at_scales[1].distance(own) < 1e-5, "{at_scales:?}");
                assert_eq!(at_scales[2], DVec3::ZERO);
            }
        }
    }

    #[test]
    fn a_spike_fades_with_the_scale() {
        let (mut vertices, faces) = fixtures::grid(20, 20);
        let spike = 21 * 10 + 10;
        vertices[spike].z = 1.0;
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let normals = normals_at_scales(&topology, &vertices);
        let face_id = topology.vertex_faces().row(spike)[0] as usize;
        let tilt = normals[face_id].map(|normal| normal.angle_between(DVec3::Z).to_degrees());
        assert!(tilt[0] > 10.0 && tilt[0] < 45.0, "{tilt:?}");
        assert!(tilt[1] < 0.6 * tilt[0] && tilt[2] < 0.6 * tilt[1], "{tilt:?}");
        // Ten faces away, the spike has arrived after 16 iterations only.
        let far = &normals[0][..2];
        assert!(far.iter().all(|normal| normal.distance(DVec3::Z) < 1e-12), "{far:?}");
    }

    #[test]
    fn faces_without_area_and_vertices_without_faces_give_no_nan() {
        let vertices = vec![DVec3::ZERO, DVec3::X, 2.0 * DVec3::X, DVec3::splat(7.0)];
        let topology = Topology::new(vec![[0, 1, 2]], 4).expect("valid");
        assert_eq!(normals_at_scales(&topology, &vertices), [[DVec3::ZERO; 3]]);
    }
}
