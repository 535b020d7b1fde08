//! Normals, centroids and areas of faces.

use crate::error::{Result, check_len};
use crate::mesh::Face;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// Normal, centroid and area of every face (paper Sec. 4: n_i, c_i, a_i).
#[derive(Debug, Clone, PartialEq)]
pub struct FaceGeometry {
    /// Unit normals (F), by the right-hand rule; zero for a face without area.
    pub normals: Vec<DVec3>,
    /// Centroids (F), in mesh units.
    pub centroids: Vec<DVec3>,
    /// Areas (F), in mesh units squared.
    pub areas: Vec<f64>,
}

impl FaceGeometry {
    /// Computes normals, centroids and areas:
    /// n = (v1 − v0) × (v2 − v0) / |…|, c = (v0 + v1 + v2) / 3, a = |(v1 − v0) × (v2 − v0)| / 2.
    ///
    /// A face is without area when its cross product is not larger than rounding leaves of a collapsed
    /// triangle (2⁻⁴⁸ times the product of its two edges); its normal is then exactly zero.
    ///
    /// # Panics
    /// If a face names a vertex that does not exist; see [`crate::mesh::validate`].
    pub fn compute(vertices: &[DVec3], faces: &[Face]) -> Self {
        let n_faces = faces.len();
        let mut normals = vec![DVec3::ZERO; n_faces];
        let mut centroids = vec![DVec3::ZERO; n_faces];
        let mut areas = vec![0.0; n_faces];
        normals
            .par_iter_mut()
            .zip(centroids.par_iter_mut())
            .zip(areas.par_iter_mut())
            .zip(faces.par_iter())
            .with_min_len(4096)
            .for_each(|(((normal, centroid), area), face)| {
                let [v0, v1, v2] = face.map(|v| vertices[v as usize]);
                *centroid = v0 + ((v1 - v0) + (v2 - v0)) / 3.0;
                (*normal, *area) = normal_and_area(v0, v1, v2);
            });
        Self { normals, centroids, areas }
    }

    /// Average distance between the centroids of faces that share an edge (paper Sec. 6.1: l̄_e), in mesh
    /// units; zero for a mesh without shared edges.
    ///
    /// # Errors
    /// [`crate::GeomError::LengthMismatch`] when `topology` belongs to another mesh.
    pub fn mean_centroid_distance(&self, topology: &Topology) -> Result<f64> {
        check_len("centroids", topology.n_faces(), self.centroids.len())?;
        let (mut sum, mut count) = (0.0, 0usize);
        for (face_id, &centroid) in self.centroids.iter().enumerate() {
            for &neighbor in topology.edge_neighbors(face_id) {
                if neighbor as usize > face_id {
                    sum += centroid.distance(self.centroids[neighbor as usize]);
                    count += 1;
                }
            }
        }
        Ok(if count == 0 { 0.0 } else { sum / count as f64 })
    }
}

/// Unit normal and area of a triangle; normal zero when the triangle has no area.
#[inline]
pub fn normal_and_area(v0: DVec3, v1: DVec3, v2: DVec3) -> (DVec3, f64) {
    const COLLAPSED: f64 = 1.0 / (1u64 << 48) as f64;
    let (edge1, edge2) = (v1 - v0, v2 - v0);
    // Edges are scaled to unit length first, so that tiny and huge meshes neither underflow nor overflow.
    let (length1, length2) = (edge1.length(), edge2.length());
    if length1 == 0.0 || length2 == 0.0 {
        return (DVec3::ZERO, 0.0);
    }
    let cross = (edge1 / length1).cross(edge2 / length2);
    let sine = cross.length();
    if sine > COLLAPSED { (cross / sine, 0.5 * sine * length1 * length2) } else { (DVec3::ZERO, 0.0) }
}

/// Mean length of the unique edges of a mesh (the unit of noise levels), in mesh units; zero for a mesh without one.
///
/// An edge from a vertex to itself, in a face that uses it twice, is none.
pub fn mean_edge_length(vertices: &[DVec3], faces: &[Face]) -> f64 {
    let mut edges: Vec<[u32; 2]> = faces
        .iter()
        .flat_map(|&[a, b, c]| [[a.min(b), a.max(b)], [b.min(c), b.max(c)], [c.min(a), c.max(a)]])
        .filter(|[a, b]| a != b)
        .collect();
    edges.par_sort_unstable();
    edges.dedup();
    let sum: f64 = edges.iter().map(|&[a, b]| vertices[a as usize].distance(vertices[b as usize])).sum();
    if edges.is_empty() { 0.0 } else { sum / edges.len() as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn unit_right_triangle() {
        let v = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let g = FaceGeometry::compute(&v, &[[0, 1, 2], [0, 2, 1], [0, 1, 1]]);
        assert_eq!(g.normals, [DVec3::Z, -DVec3::Z, DVec3::ZERO]);
        assert_eq!(g.areas, [0.5, 0.5, 0.0]);
        assert!((g.centroids[0] - DVec3::new(1.0, 1.0, 0.0) / 3.0).length() < 1e-15);
    }

    #[test]
    fn edges_count_once_and_those_from_a_vertex_to_itself_not_at_all() {
        let v = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 2.0, 0.0)];
        assert_eq!(mean_edge_length(&v, &[[0, 0, 1], [1, 2, 1]]), 1.5);
        assert_eq!(mean_edge_length(&v, &[[1, 1, 1]]), 0.0);
    }

    #[test]
    fn scale_does_not_lose_normals() {
        for scale in [1e-160, 1e-6, 1e6, 1e150] {
            let v = [DVec3::ZERO, DVec3::X * scale, DVec3::Y * scale];
            let g = FaceGeometry::compute(&v, &[[0, 1, 2]]);
            assert!((g.normals[0] - DVec3::Z).length() < 1e-15, "scale {scale}");
        }
    }

    #[test]
    fn collinear_face_has_no_normal() {
        let v = [DVec3::ZERO, DVec3::splat(0.1), DVec3::splat(0.3)];
        assert_eq!(FaceGeometry::compute(&v, &[[0, 1, 2]]).normals[0], DVec3::ZERO);
    }

    #[test]
    fn cube_edges_and_centroid_distance() {
        let (v, f) = fixtures::cube();
        let expected = (12.0 + 6.0 * 2f64.sqrt()) / 18.0;
        assert!((mean_edge_length(&v, &f) - expected).abs() < 1e-12);
        let t = Topology::new(f.clone(), v.len()).expect("valid");
        let d = FaceGeometry::compute(&v, &f).mean_centroid_distance(&t).expect("same mesh");
        assert!(d > 0.3 && d < 0.8, "{d}");
    }
}
