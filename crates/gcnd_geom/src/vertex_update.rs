//! Vertex updating: moves vertices until the faces are as perpendicular to given normals as they can be
//! (paper Sec. 6.2, Eq. 6).

use crate::error::{Result, check_len};
use crate::mesh::check_vertices;
use crate::normals::refine::unit_normals;
use crate::rim::Rim;
use crate::topology::Topology;
use crate::watch::{Ticks, Watch};
use glam::DVec3;
use rayon::prelude::*;

pub use crate::rim::Boundary;

/// Moves every vertex towards the planes of its faces, `iterations` times:
/// v_i ← v_i + 1 / (3 |F_i|) · Σ_{f ∈ F_i} Σ_{edges (v_i, v_j) of f} n_f · (n_f · (v_j − v_i)).
///
/// - `topology`, `vertices` (V), in mesh units.
/// - `normals` (F): the denoised face normals in the frame of `vertices`, of any length; a face whose normal
///   is zero pulls at nothing, but counts in |F_i|.
/// - `iterations`: the paper takes 15; 0 returns the vertices as they are.
///
/// - `boundary`: how vertices on a boundary move, see [`Boundary`].
/// - `watch`: hears of every iteration.
///
/// Returns (V) new positions, in mesh units. Faces, and the positions of vertices without faces, stay.
/// All vertices of an iteration move at once, from the positions of the one before. A closed mesh has the same
/// result, bit for bit, for every `boundary`.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`],
/// [`crate::GeomError::InvalidParameter`] for a normal that is NaN or infinite, or [`crate::GeomError::Cancelled`].
///
/// Paper: Sec. 6.2, Eq. 6 (Sun et al. 2007).
/// Choice: docs/choices.md#faces-without-normal, docs/choices.md#boundary-vertices.
///
/// ```
/// use gcnd_geom::{fixtures, vertex_update::{Boundary, update_vertices}, DVec3, Topology, Watch};
/// let (mut vertices, faces) = fixtures::grid(4, 4);
/// vertices[12].z = 0.5;
/// let normals = vec![DVec3::Z; faces.len()];
/// let topology = Topology::new(faces, vertices.len())?;
/// let updated = update_vertices(&topology, &vertices, &normals, 15, Boundary::Free, &mut Watch::silent())?;
/// assert!(updated[12].z < 0.1 && updated[12].truncate() == vertices[12].truncate());
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn update_vertices(
    topology: &Topology,
    vertices: &[DVec3],
    normals: &[DVec3],
    iterations: usize,
    boundary: Boundary,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    check_vertices(vertices)?;
    let normals = unit_normals(normals, topology.n_faces())?;
    let mut updater = VertexUpdater::new(topology, &normals, boundary);
    let mut current = vertices.to_vec();
    let mut ticks = Ticks::new(iterations, watch);
    for _ in 0..iterations {
        updater.step(&mut current);
        ticks.tick()?;
    }
    Ok(current)
}

/// Eq. 6 at work, iteration by iteration, for the filters that end with it.
pub(crate) struct VertexUpdater<'a> {
    topology: &'a Topology,
    planes: Vec<Plane>,
    next: Vec<DVec3>,
    rim: Rim,
    /// What a vertex's sum over its faces is divided by; `None` for their number.
    divisor: Option<f64>,
}

impl<'a> VertexUpdater<'a> {
    /// Takes unit or zero normals (F).
    pub fn new(topology: &'a Topology, normals: &[DVec3], boundary: Boundary) -> Self {
        let planes = normals.iter().map(|&normal| Plane { normal, offset: 0.0 }).collect();
        Self { topology, planes, next: Vec::new(), rim: Rim::new(topology, boundary), divisor: None }
    }

    /// Takes steps of 1/18 of the sum over faces and edges whatever |F_i| is, that is 6 in its place, the mean number of
    /// faces around a vertex of a closed mesh.
    pub fn with_fixed_step(mut self) -> Self {
        self.divisor = Some(6.0);
        self
    }

    /// Replaces the normals (F) by others.
    pub fn set_normals(&mut self, normals: &[DVec3]) {
        for (plane, &normal) in self.planes.iter_mut().zip(normals) {
            plane.normal = normal;
        }
    }

    /// One iteration.
    pub fn step(&mut self, current: &mut Vec<DVec3>) {
        place_planes(self.topology, current, &mut self.planes);
        self.rim.place(current);
        self.next.resize(current.len(), DVec3::ZERO);
        step(self.topology, current, &self.planes, &self.rim, self.divisor, &mut self.next);
        std::mem::swap(current, &mut self.next);
    }
}

/// The plane through a face's centroid across its given normal: n · x = offset.
#[derive(Clone, Copy)]
struct Plane {
    normal: DVec3,
    offset: f64,
}

/// Vertices or faces of one unit of parallel work.
const CHUNK: usize = 4096;

fn place_planes(topology: &Topology, vertices: &[DVec3], planes: &mut [Plane]) {
    planes.par_iter_mut().zip(topology.faces()).with_min_len(CHUNK).for_each(|(plane, face)| {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        plane.offset = plane.normal.dot(a + ((b - a) + (c - a)) / 3.0);
    });
}

/// One iteration of Eq. 6.
///
/// The two edges of a face at v_i add up to (v_a − v_i) + (v_b − v_i) = 3 (c − v_i), so the sum over them,
/// over 3, is n (n · c − n · v_i): the way to the face's plane, and one record is read per face.
fn step(
    topology: &Topology,
    current: &[DVec3],
    planes: &[Plane],
    rim: &Rim,
    divisor: Option<f64>,
    next: &mut [DVec3],
) {
    let vertex_faces = topology.vertex_faces();
    next.par_iter_mut().zip(current).enumerate().with_min_len(CHUNK).for_each(|(vertex_id, (moved, &v))| {
        let row = vertex_faces.row(vertex_id);
        let mut sum = DVec3::ZERO;
        for &face_id in row {
            let Plane { normal, offset } = planes[face_id as usize];
            sum += normal * (offset - normal.dot(v));
        }
        let normal = || row.iter().map(|&face_id| planes[face_id as usize].normal).sum();
        let divisor = divisor.unwrap_or(row.len() as f64);
        *moved = if row.is_empty() { v } else { v + rim.held(vertex_id, sum / divisor, normal) };
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GeomError;
    use crate::face_geometry::FaceGeometry;
    use crate::fixtures;

    fn updated(
        (vertices, faces): fixtures::MeshParts,
        normals: &[DVec3],
        iterations: usize,
    ) -> Result<Vec<DVec3>> {
        update_vertices(
            &Topology::new(faces, vertices.len())?,
            &vertices,
            normals,
            iterations,
            Boundary::Free,
            &mut Watch::silent(),
        )
    }

    /// Eq. 6 as it stands, edge by edge.
    fn step_by_edges(vertices: &[DVec3], faces: &[[u32; 3]], normals: &[DVec3]) -> Vec<DVec3> {
        let mut sums = vec![(DVec3::ZERO, 0.0); vertices.len()];
        for (face, &n) in faces.iter().zip(normals) {
            for (corner, &i) in face.iter().enumerate() {
                for other in [face[(corner + 1) % 3], face[(corner + 2) % 3]] {
                    sums[i as usize].0 += n * n.dot(vertices[other as usize] - vertices[i as usize]);
                }
                sums[i as usize].1 += 1.0;
            }
        }
        let moved = |(v, (sum, count)): (&DVec3, (DVec3, f64))| *v + sum / (3.0 * f64::max(count, 1.0));
        vertices.iter().zip(sums).map(moved).collect()
    }

    #[test]
    fn one_face_one_step_by_hand() {
        // n = z, heights 0, 0, 3: each vertex goes to the mean height in one step.
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, 3.0), DVec3::splat(7.0)];
        let moved = updated((vertices, vec![[0, 1, 2]]), &[DVec3::Z], 1).expect("valid");
        let expected =
            [DVec3::new(0., 0., 1.), DVec3::new(1., 0., 1.), DVec3::new(0., 1., 1.), DVec3::splat(7.0)];
        assert_eq!(moved, expected, "the vertex without faces stays");
    }

    #[test]
    fn equals_the_sum_over_edges() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        fixtures::jitter(&mut vertices, 0.1, 3);
        let normals: Vec<DVec3> = FaceGeometry::compute(&fixtures::icosphere(2).0, &faces).normals;
        let expected = step_by_edges(&vertices, &faces, &normals);
        let moved = updated((vertices, faces), &normals, 1).expect("valid");
        for (a, b) in moved.iter().zip(&expected) {
            assert!(a.distance(*b) < 1e-15, "{a} {b}");
        }
    }

    #[test]
    fn a_fixed_step_is_a_sixth_of_the_sum_over_faces() {
        // As above, with one face around each vertex: a sixth of the way.
        let (mut vertices, faces) = (vec![DVec3::ZERO, DVec3::X, DVec3::new(0.0, 1.0, 3.0)], vec![[0, 1, 2]]);
        let topology = Topology::new(faces, 3).expect("valid");
        VertexUpdater::new(&topology, &[DVec3::Z], Boundary::Free).with_fixed_step().step(&mut vertices);
        let heights: Vec<f64> = vertices.iter().map(|v| v.z).collect();
        assert_eq!(heights, [1.0 / 6.0, 1.0 / 6.0, 3.0 - 2.0 / 6.0]);
    }

    #[test]
    fn iterations_bring_a_spike_back_to_the_plane() {
        let (mut vertices, faces) = fixtures::grid(6, 6);
        vertices[24].z = 1.0;
        let normals = vec![DVec3::Z; faces.len()];
        let spread = |v: &[DVec3]| {
            let mean = v.iter().map(|v| v.z).sum::<f64>() / v.len() as f64;
            v.iter().map(|v| (v.z - mean).abs()).fold(0.0, f64::max)
        };
        let after = |iterations| {
            spread(&updated((vertices.clone(), faces.clone()), &normals, iterations).expect("valid"))
        };
        assert!(after(1) < 0.5 && after(15) < 0.1 && after(500) < 1e-3);
        assert_eq!(after(0), spread(&vertices));
    }

    #[test]
    fn a_zero_normal_pulls_at_nothing_but_counts() {
        let (mut vertices, faces) = fixtures::two_triangles();
        vertices[0].z = 3.0;
        let moved = updated((vertices.clone(), faces), &[DVec3::Z, DVec3::ZERO], 1).expect("valid");
        let heights: Vec<f64> = moved.iter().map(|v| v.z).collect();
        assert_eq!(heights, [1.0, 0.5, 0.5, 1.0], "vertices 1 and 2 have two faces, one of them silent");
    }

    #[test]
    fn the_length_of_a_normal_does_not_matter() {
        let (mut vertices, faces) = fixtures::grid(3, 3);
        fixtures::jitter(&mut vertices, 0.2, 1);
        let update = |n| updated((vertices.clone(), faces.clone()), &vec![n; faces.len()], 5).expect("valid");
        assert_eq!(update(DVec3::Z), update(DVec3::Z * 1e-200));
    }

    #[test]
    fn a_held_boundary_stays_and_the_inside_moves() {
        let (mut vertices, faces) = fixtures::grid(4, 4);
        fixtures::jitter(&mut vertices, 0.2, 1);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let mut moved = vertices.clone();
        VertexUpdater::new(&topology, &[DVec3::Z; 32], Boundary::Fixed).step(&mut moved);
        for (vertex_id, is_boundary) in topology.boundary_vertices().into_iter().enumerate() {
            assert_eq!(moved[vertex_id] == vertices[vertex_id], is_boundary, "vertex {vertex_id}");
        }
    }

    #[test]
    fn along_keeps_the_rim_of_a_flat_sheet_in_place_and_levels_it() {
        // Normals that lean this way and that push a free rim in and out.
        let (mut vertices, faces) = fixtures::grid(8, 8);
        fixtures::jitter(&mut vertices, 0.05, 5);
        let mut normals = vec![DVec3::Z; faces.len()];
        fixtures::jitter(&mut normals, 0.3, 6);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let after = |boundary| {
            update_vertices(&topology, &vertices, &normals, 1, boundary, &mut Watch::silent()).expect("valid")
        };
        let (free, along, fixed) = (after(Boundary::Free), after(Boundary::Along), after(Boundary::Fixed));
        let mut tangents = vec![DVec3::ZERO; vertices.len()];
        for [start, end] in topology.boundary_edges().map(|edge| edge.map(|v| v as usize)) {
            tangents[start] += vertices[end] - vertices[start];
            tangents[end] += vertices[end] - vertices[start];
        }
        let mut taken: f64 = 0.0;
        for (vertex_id, is_rim) in topology.boundary_vertices().into_iter().enumerate() {
            if !is_rim {
                assert_eq!((along[vertex_id], fixed[vertex_id]), (free[vertex_id], free[vertex_id]));
                continue;
            }
            let around = topology.vertex_faces().row(vertex_id).iter();
            let mean: DVec3 = around.map(|&face_id| normals[face_id as usize].normalize()).sum();
            let across = tangents[vertex_id].cross(mean).normalize();
            let [step, way] = [&free, &along].map(|moved| moved[vertex_id] - vertices[vertex_id]);
            assert!(way.dot(across).abs() < 1e-15, "vertex {vertex_id} went {way}");
            assert!((step - way).reject_from(across).length() < 1e-15, "nothing else is taken away");
            taken = taken.max((step - way).length());
            assert_eq!(fixed[vertex_id], vertices[vertex_id]);
        }
        assert!(taken > 1e-3, "the free rim leaves its outline: {taken}");
    }

    #[test]
    fn a_crease_that_ends_at_the_rim_stays_sharp() {
        // A roof open at both ends; the end of its ridge is off sideways, which only the crease's normals can mend.
        let mut vertices: Vec<DVec3> = (0..7)
            .flat_map(|y| {
                [(-1.0, -1.0), (0.0, 0.0), (1.0, -1.0)].map(|(x, z)| DVec3::new(x, f64::from(y), z))
            })
            .collect();
        let quads = (0..6u32).flat_map(|y| [0, 1].map(|x| 3 * y + x));
        let faces: Vec<_> = quads.flat_map(|a| [[a, a + 1, a + 4], [a, a + 4, a + 3]]).collect();
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        vertices[1] += DVec3::new(0.2, 0.0, 0.1);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let moved =
            update_vertices(&topology, &vertices, &normals, 200, Boundary::Along, &mut Watch::silent())
                .expect("valid");
        let ridge = moved[1] - moved[4];
        assert!(ridge.x.abs() < 0.02 && ridge.z.abs() < 0.02, "{ridge}");
        assert!(moved[1].y.abs() < 1e-3, "and the end of the roof where it was: {}", moved[1]);
    }

    #[test]
    fn a_closed_mesh_has_no_boundary_to_hold() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        let normals = FaceGeometry::compute(&vertices, &faces).normals;
        fixtures::jitter(&mut vertices, 0.1, 3);
        let topology = Topology::new(faces, vertices.len()).expect("valid");
        let after = |boundary| {
            update_vertices(&topology, &vertices, &normals, 9, boundary, &mut Watch::silent()).expect("valid")
        };
        assert_eq!(after(Boundary::Along), after(Boundary::Free));
        assert_eq!(after(Boundary::Fixed), after(Boundary::Free));
    }

    #[test]
    fn guards() {
        let (vertices, faces) = fixtures::tetrahedron();
        let error = updated((vertices.clone(), faces.clone()), &[DVec3::Z; 3], 1).unwrap_err();
        assert_eq!(error, GeomError::LengthMismatch { what: "normals", expected: 4, got: 3 });
        let error = updated((vertices.clone(), faces.clone()), &[DVec3::NAN; 4], 1).unwrap_err();
        assert!(matches!(error, GeomError::InvalidParameter { name: "normals", .. }), "{error}");
        let topology = Topology::new(faces.clone(), 4).expect("valid");
        let error = update_vertices(
            &topology,
            &vertices[..3],
            &[DVec3::Z; 4],
            1,
            Boundary::Free,
            &mut Watch::silent(),
        )
        .unwrap_err();
        assert_eq!(error, GeomError::LengthMismatch { what: "vertices", expected: 4, got: 3 });
        let mut broken = vertices;
        broken[2].y = f64::INFINITY;
        let error = updated((broken, faces), &[DVec3::Z; 4], 1).unwrap_err();
        assert_eq!(error, GeomError::NonFiniteVertex { vertex_id: 2 });
    }
}
