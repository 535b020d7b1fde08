//! Spikes: single vertices that stand far off the surface, as scanners and broken exports leave them.

use crate::error::{Result, check_len};
use crate::face_geometry::normal_and_area;
use crate::mesh::check_vertices;
use crate::topology::Topology;
use glam::DVec3;
use rayon::prelude::*;

/// How many times as far off as its surroundings are wide a vertex has to be.
const LEAST_HEIGHT: f64 = 5.0;

/// The least cosine, averaged over their area, between the faces around a spike and the plane that it stands on.
const LEAST_COSINE: f64 = 0.5;

/// Vertices of one unit of parallel work.
const CHUNK: usize = 4096;

/// A vertex that stands off the surface alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spike {
    /// The vertex.
    pub vertex_id: u32,
    /// Where the surface is, in mesh units: the mean over its faces of their other corners.
    pub foot: DVec3,
    /// Whether the vertex is on a boundary, as the tip of a triangle that hangs on a rim is.
    pub is_on_rim: bool,
}

/// Finds the spikes of a mesh, by vertex id.
///
/// With the foot m of a vertex v, s the larger of the mean distance from m of its neighbours and the mean edge of the
/// faces around it (those that share a vertex with its own), a spike on a boundary is one with |v − m| > 5 s. Inside the
/// surface, with u the unit vector along Σ a_f n_f over the faces of v, which does not depend on v itself, it is one
/// with |(v − m) · u| > 5 s that stands on a surface and not on a tip or in a bottom: Σ a_g n_g · u > 0.5 Σ a_g over the
/// faces g around it.
///
/// - `topology`, `vertices` (V), in mesh units.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`].
///
/// Choice: docs/choices.md#spikes.
///
/// ```
/// use gcnd_geom::{fixtures, spikes::find_spikes, Topology};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 8.0;
/// let topology = Topology::new(faces, vertices.len())?;
/// let spikes = find_spikes(&topology, &vertices)?;
/// assert_eq!((spikes.len(), spikes[0].vertex_id, spikes[0].foot.z), (1, 24, 0.0));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn find_spikes(topology: &Topology, vertices: &[DVec3]) -> Result<Vec<Spike>> {
    check_len("vertices", topology.n_vertices(), vertices.len())?;
    check_vertices(vertices)?;
    let far_off: Vec<Candidate> = (0..vertices.len() as u32)
        .into_par_iter()
        .with_min_len(CHUNK)
        .filter_map(|vertex_id| Candidate::far_off(topology, vertices, vertex_id))
        .collect();
    if far_off.is_empty() {
        return Ok(Vec::new());
    }
    let is_rim = topology.boundary_vertices();
    let found = far_off.into_iter().filter_map(|candidate| {
        let is_on_rim = is_rim[candidate.vertex_id as usize];
        let stands_out = candidate.stands_out(topology, vertices, is_on_rim);
        stands_out.then_some(Spike { vertex_id: candidate.vertex_id, foot: candidate.foot, is_on_rim })
    });
    Ok(found.collect())
}

/// A vertex that is far from its own neighbours.
struct Candidate {
    vertex_id: u32,
    foot: DVec3,
    /// Mean distance of the neighbours from the foot.
    extent: f64,
}

impl Candidate {
    fn far_off(topology: &Topology, vertices: &[DVec3], vertex_id: u32) -> Option<Self> {
        let tip = vertices[vertex_id as usize];
        let corners = || corners_across(topology, vertex_id).map(|corner| vertices[corner as usize]);
        let n = corners().count() as f64;
        // Offsets from a corner keep their digits far away from the origin, and under a tip far away from both.
        let first = corners().next()?;
        let foot = first + corners().map(|corner| corner - first).sum::<DVec3>() / n;
        let extent = corners().map(|corner| corner.distance(foot)).sum::<f64>() / n;
        let distance = tip.distance(foot);
        let is_far = distance.is_finite() && distance > LEAST_HEIGHT * extent;
        is_far.then_some(Self { vertex_id, foot, extent })
    }

    fn stands_out(&self, topology: &Topology, vertices: &[DVec3], is_on_rim: bool) -> bool {
        let around = self.faces_around(topology);
        if around.is_empty() {
            return false;
        }
        // In units of the surroundings areas stay within the range of numbers.
        let from_foot = |v: u32| vertices[v as usize] - self.foot;
        let offset = from_foot(self.vertex_id);
        let corners = around.iter().flat_map(|&face_id| topology.faces()[face_id as usize]);
        let reach = corners.map(|v| from_foot(v).length()).fold(0.0, f64::max);
        let unit = if reach > 0.0 { reach } else { offset.length() };
        // The spike itself on its foot: around a vertex areas · normals have the same sum wherever it is, but no digits
        // of it are left where it is far off.
        let placed = |face_id: u32| {
            let place = |v| if v == self.vertex_id { DVec3::ZERO } else { from_foot(v) / unit };
            topology.faces()[face_id as usize].map(place)
        };
        let perimeter = |[a, b, c]: [DVec3; 3]| a.distance(b) + b.distance(c) + c.distance(a);
        let edges: f64 = around.iter().map(|&face_id| perimeter(placed(face_id))).sum();
        let least = LEAST_HEIGHT * (self.extent / unit).max(edges / (3 * around.len()) as f64);
        if is_on_rim {
            return (offset / unit).length() > least;
        }
        let area_normal = |face_id: u32| {
            let [a, b, c] = placed(face_id);
            let (normal, area) = normal_and_area(a, b, c);
            normal * area
        };
        let own = topology.vertex_faces().row(self.vertex_id as usize);
        let up = own.iter().map(|&face_id| area_normal(face_id)).sum::<DVec3>().normalize_or_zero();
        let (mut along, mut area) = (0.0, 0.0);
        for of_face in around.iter().map(|&face_id| area_normal(face_id)) {
            along += of_face.dot(up);
            area += of_face.length();
        }
        (offset / unit).dot(up).abs() > least && along > LEAST_COSINE * area
    }

    /// Faces that share a vertex with those of the candidate, without these, ascending.
    fn faces_around(&self, topology: &Topology) -> Vec<u32> {
        let stars = topology.vertex_faces();
        let own = stars.row(self.vertex_id as usize);
        let mut around: Vec<u32> = corners_across(topology, self.vertex_id)
            .flat_map(|corner| stars.row(corner as usize).iter().copied())
            .filter(|face_id| !own.contains(face_id))
            .collect();
        around.sort_unstable();
        around.dedup();
        around
    }
}

/// The other corners of a vertex's faces, once for each face.
fn corners_across(topology: &Topology, vertex_id: u32) -> impl Iterator<Item = u32> + '_ {
    let own = topology.vertex_faces().row(vertex_id as usize).iter();
    own.flat_map(|&face_id| topology.faces()[face_id as usize]).filter(move |&corner| corner != vertex_id)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Face, GeomError, fixtures};

    fn spikes(vertices: &[DVec3], faces: &[Face]) -> Vec<Spike> {
        let topology = Topology::new(faces.to_vec(), vertices.len()).expect("valid");
        find_spikes(&topology, vertices).expect("finite")
    }

    #[test]
    fn a_raised_vertex_is_a_spike_from_five_times_the_mean_edge_on() {
        // Six neighbours around an inner vertex: four at distance 1, two at √2; the faces around are halves of squares.
        let least = 5.0 * (2.0 + 2f64.sqrt()) / 3.0;
        for (height, is_spike) in [
            (0.999, false),
            (1.001, true),
            (-0.999, false),
            (-1.001, true),
            (1e6, true),
            (1e16, true),
            (-1e120, true),
        ] {
            let (mut vertices, faces) = fixtures::grid(8, 8);
            vertices[40].z = height * least;
            let found = spikes(&vertices, &faces);
            assert_eq!(found.len(), usize::from(is_spike), "height {height}");
            for spike in found {
                assert_eq!((spike.vertex_id, spike.is_on_rim), (40, false));
                assert!(spike.foot.distance(vertices[40] * DVec3::new(1.0, 1.0, 0.0)) < 1e-9);
            }
        }
    }

    #[test]
    fn the_tip_of_a_triangle_that_hangs_on_a_rim() {
        let (mut vertices, mut faces) = fixtures::grid(8, 8);
        let middle = (vertices[3] + vertices[4]) / 2.0;
        vertices.push(middle + DVec3::new(0.0, -1.0, 9.0));
        faces.push([4, 3, 81]);
        assert_eq!(spikes(&vertices, &faces), [Spike { vertex_id: 81, foot: middle, is_on_rim: true }]);
        vertices[81] = middle + DVec3::new(0.0, -1.0, 4.0);
        assert_eq!(spikes(&vertices, &faces), []);
    }

    #[test]
    fn a_triangle_in_flight_and_vertices_without_faces_are_none() {
        let (vertices, faces) = fixtures::two_triangles();
        let far = [vertices[0], vertices[1], 1e3 * DVec3::ONE, DVec3::splat(-1e5)];
        assert_eq!(spikes(&far, &faces[..1]), []);
    }

    /// A cone of `n` faces with a bottom of `n` more.
    fn cone(n: u32, height: f64) -> fixtures::MeshParts {
        let angle = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        let mut vertices: Vec<DVec3> =
            (0..n).map(|i| DVec3::new(angle(i).cos(), angle(i).sin(), 0.0)).collect();
        vertices.extend([DVec3::Z * height, DVec3::ZERO]);
        let faces = (0..n).flat_map(|i| [[i, (i + 1) % n, n], [(i + 1) % n, i, n + 1]]).collect();
        (vertices, faces)
    }

    /// A prism of square cross section with a pyramid at its end, as a pencil is.
    fn pencil(length: u32, height: f64) -> fixtures::MeshParts {
        let corners = [(-1., -1.), (1., -1.), (1., 1.), (-1., 1.)];
        let mut vertices: Vec<DVec3> = (0..=length)
            .flat_map(|z| corners.map(|(x, y)| DVec3::new(x, y, f64::from(z) - f64::from(length))))
            .collect();
        vertices.push(DVec3::Z * height);
        let tip = 4 * length + 4;
        let mut faces: Vec<Face> = vec![[0, 2, 1], [0, 3, 2]];
        for side in 0..4 {
            let next = (side + 1) % 4;
            faces.extend((0..length).flat_map(|z| {
                let [a, b, c, d] = [4 * z + side, 4 * z + next, 4 * z + 4 + next, 4 * z + 4 + side];
                [[a, b, c], [a, c, d]]
            }));
            faces.push([tip - 4 + side, tip - 4 + next, tip]);
        }
        (vertices, faces)
    }

    #[test]
    fn tips_of_bodies_are_none() {
        for height in [0.1, 1.0, 10.0, 100.0, 1e4] {
            for n in [3, 6, 32] {
                let (vertices, faces) = cone(n, height);
                assert_eq!(spikes(&vertices, &faces), [], "a cone of {n} sides and height {height}");
            }
            let (vertices, faces) = pencil(12, height);
            assert_eq!(spikes(&vertices, &faces), [], "a pencil with a tip of {height}");
        }
        let boxed = |size: DVec3| fixtures::cube().0.iter().map(|&v| v * size).collect::<Vec<_>>();
        for size in [DVec3::ONE, DVec3::new(1e3, 1.0, 1e-3)] {
            assert_eq!(spikes(&boxed(size), &fixtures::cube().1), []);
        }
    }

    #[test]
    fn noise_is_none() {
        let (clean, faces) = fixtures::icosphere(4);
        for seed in 0..20 {
            let mut vertices = clean.clone();
            // Mean edge 0.12: every coordinate by up to 0.8 of it.
            fixtures::jitter(&mut vertices, 0.1, seed);
            assert_eq!(spikes(&vertices, &faces), [], "seed {seed}");
        }
    }

    #[test]
    fn spikes_do_not_depend_on_position_or_scale() {
        let (mut vertices, faces) = fixtures::grid(20, 20);
        fixtures::jitter(&mut vertices, 0.1, 2);
        for vertex_id in [60, 200, 350] {
            vertices[vertex_id].z = 9.0;
        }
        let found: Vec<u32> = spikes(&vertices, &faces).iter().map(|spike| spike.vertex_id).collect();
        assert_eq!(found, [60, 200, 350]);
        for (scale, shift) in [(1e-100, DVec3::ZERO), (1e100, DVec3::ZERO), (3.0, DVec3::splat(1e6))] {
            let moved: Vec<DVec3> = vertices.iter().map(|&v| scale * v + shift).collect();
            let again: Vec<u32> = spikes(&moved, &faces).iter().map(|spike| spike.vertex_id).collect();
            assert_eq!(again, found, "scale {scale}");
        }
    }

    #[test]
    fn guards() {
        let (mut vertices, faces) = fixtures::grid(3, 3);
        let topology = Topology::new(faces, 16).expect("valid");
        let error = GeomError::LengthMismatch { what: "vertices", expected: 16, got: 15 };
        assert_eq!(find_spikes(&topology, &vertices[1..]), Err(error));
        vertices[5].y = f64::NAN;
        assert_eq!(find_spikes(&topology, &vertices), Err(GeomError::NonFiniteVertex { vertex_id: 5 }));
    }
}
