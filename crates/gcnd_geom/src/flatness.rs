//! How much of a surface is flat: what tells a machine part from a body.

use crate::error::{Result, check_len};
use crate::face_geometry::FaceGeometry;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// Share of the faces' edges across which the surface goes on in one plane, to within `angle` in radians.
///
/// Every edge counts once from each of its faces; faces without area and boundaries do not. Zero where nothing counts.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`] when `topology` belongs to another mesh.
///
/// Choice: docs/choices.md#flat-meshes.
pub fn flat_share(topology: &Topology, vertices: &[DVec3], angle: f64) -> Result<f64> {
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    let normals = FaceGeometry::compute(vertices, topology.faces()).normals;
    let least_cosine = angle.cos();
    let (n_flat, n_all) = (0..normals.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|face_id| {
            let has_area = |n: &DVec3| *n != DVec3::ZERO;
            let own = normals[face_id];
            let others = topology.edge_neighbors(face_id).iter().map(|&other| normals[other as usize]);
            others.filter(|n| has_area(n) && has_area(&own)).fold((0_usize, 0_usize), |(flat, all), n| {
                (flat + usize::from(own.dot(n) >= least_cosine), all + 1)
            })
        })
        .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    Ok(if n_all == 0 { 0.0 } else { n_flat as f64 / n_all as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn share((vertices, faces): fixtures::MeshParts, degrees: f64) -> f64 {
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        flat_share(&topology, &vertices, degrees.to_radians()).expect("vertices of this mesh")
    }

    #[test]
    fn a_cube_of_twelve_faces_is_flat_across_its_diagonals() {
        // Each triangle has three neighbours, one of them in its own plane.
        assert_eq!(share(fixtures::cube(), 1.0), 1.0 / 3.0);
        assert_eq!(share(fixtures::cube(), 91.0), 1.0);
    }

    #[test]
    fn what_does_not_count_leaves_the_rest() {
        let (mut vertices, mut faces) = fixtures::cube();
        let n = vertices.len() as u32;
        vertices.extend([
            DVec3::splat(9.0),
            DVec3::splat(10.0),
            DVec3::splat(11.0),
            DVec3::new(9.0, 0.0, 0.0),
        ]);
        // Without area, beside one with area that has no other neighbour.
        faces.extend([[n, n + 1, n + 2], [n + 1, n, n + 3]]);
        assert_eq!(share((vertices, faces), 1.0), 1.0 / 3.0);
        let alone = (vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]);
        assert_eq!(share(alone, 1.0), 0.0);
    }

    #[test]
    fn vertices_of_another_mesh_are_named() {
        let (vertices, faces) = fixtures::cube();
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        assert!(flat_share(&topology, &vertices[1..], 0.1).is_err());
    }
}
