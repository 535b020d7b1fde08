//! The rounds of remeshing and their parameters.

use glam::DVec3;

use super::collapse::collapse_short_edges;
use super::dynamic::DynamicMesh;
use super::features;
use super::flip::{Aim, flip_edges};
use super::relax::{Reference, relax_vertices};
use super::split::{split_flat_parts_evenly, split_long_edges};
use super::surface::Surface;
use crate::error::{GeomError, Result, check_len};
use crate::mesh::{Face, validate};

/// More faces than this are not made; a wanted length that asks for them is taken for a mistake.
const MAX_FACES: f64 = 2e7;

/// How [`remesh`] works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RemeshParams {
    /// The wanted edge length, in mesh units; > 0.
    pub target_edge_length: f64,
    /// Edges whose faces' normals differ by more than this are kept, in degrees, 0 to 180.
    pub feature_angle_deg: f64,
    /// Rounds of split, collapse, flip, relax; 0 returns the input.
    pub iterations: usize,
}

impl Default for RemeshParams {
    fn default() -> Self {
        Self { target_edge_length: 1.0, feature_angle_deg: 30.0, iterations: 10 }
    }
}

/// Remeshes a surface with near-equilateral triangles of one size, keeping its sharp edges.
///
/// Each round splits edges longer than 4/3·L, collapses edges shorter than 4/5·L, flips edges where that
/// brings valences nearer to six, and moves every vertex v in its tangent plane,
/// v ← Π(v + 0.8·(I − n nᵀ)(g − v)), where g is the area-weighted mean of the centroids of the faces at v and Π
/// is the nearest point of the input surface.
///
/// # Arguments
/// * `vertices` – positions in mesh units; every one finite.
/// * `faces` – vertex ids, three a face; closed or with boundary.
/// * `params` – the length L, the angle that makes an edge sharp, and the rounds.
///
/// # Returns
/// New vertices and faces. Corners keep their exact position, feature curves and boundaries are resampled along
/// themselves, all other vertices lie on the input surface. No operation turns a face over or makes an edge
/// non-manifold. Edges that are non-manifold on input stay as they are. Vertices without a face are dropped, as
/// are faces that name a vertex twice.
///
/// # Errors
/// * [`GeomError::EmptyMesh`], [`GeomError::IndexOutOfRange`], [`GeomError::NonFiniteVertex`] – by [`validate`].
/// * [`GeomError::InvalidParameter`] – a length that is not positive, an angle outside 0 to 180.
/// * [`GeomError::TooLarge`] – the length asks for more than 20 million faces.
///
/// # Example
/// ```
/// use gcnd_geom::remesh::{RemeshParams, remesh};
///
/// let (vertices, faces) = gcnd_geom::fixtures::cube();
/// let params = RemeshParams { target_edge_length: 0.1, ..RemeshParams::default() };
/// let (new_vertices, new_faces) = remesh(&vertices, &faces, &params)?;
/// assert!(new_faces.len() > 100);
/// assert!(vertices.iter().all(|corner| new_vertices.contains(corner)));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn remesh(vertices: &[DVec3], faces: &[Face], params: &RemeshParams) -> Result<(Vec<DVec3>, Vec<Face>)> {
    remesh_with_sizes(vertices, faces, &vec![params.target_edge_length; vertices.len()], params)
}

/// Remeshes a surface as [`remesh`] does, with a wanted edge length at each input vertex.
///
/// The length wanted of an edge is the mean of its ends' lengths; a vertex put on an edge gets that mean. Relaxation
/// weights each face by its area over its wanted area.
///
/// # Arguments
/// * `sizes` – the wanted edge length at each vertex, in mesh units, each > 0; `params.target_edge_length` is not
///   used.
///
/// # Errors
/// As [`remesh`], and [`GeomError::LengthMismatch`] if there is not one size per vertex.
pub fn remesh_with_sizes(
    vertices: &[DVec3],
    faces: &[Face],
    sizes: &[f64],
    params: &RemeshParams,
) -> Result<(Vec<DVec3>, Vec<Face>)> {
    validate(vertices, faces)?;
    check_params(vertices, faces, sizes, params)?;
    if params.iterations == 0 {
        return Ok((vertices.to_vec(), faces.to_vec()));
    }
    let mut mesh = DynamicMesh::new(vertices.to_vec(), sizes.to_vec(), faces);
    features::mark(&mut mesh, params.feature_angle_deg);
    // Splitting stays on the input, and small pieces make nearest-point queries fast.
    split_flat_parts_evenly(&mut mesh);
    let reference = Reference {
        surface: Surface::from_triangles(
            mesh.faces.iter().zip(&mesh.regions).map(|(face, &id)| (face.map(|v| mesh.position(v)), id)),
        ),
        curves: Surface::from_segments(features::segments(&mesh).into_iter()),
    };
    for _ in 0..params.iterations {
        split_long_edges(&mut mesh);
        collapse_short_edges(&mut mesh);
        flip_edges(&mut mesh, Aim::Valence);
        relax_vertices(&mut mesh, &reference);
    }
    flip_edges(&mut mesh, Aim::Shape);
    relax_vertices(&mut mesh, &reference);
    Ok(mesh.compact())
}

fn check_params(vertices: &[DVec3], faces: &[Face], sizes: &[f64], params: &RemeshParams) -> Result<()> {
    check_len("sizes", vertices.len(), sizes.len())?;
    if let Some(size) = sizes.iter().find(|size| !(size.is_finite() && **size > 0.0)) {
        return Err(GeomError::InvalidParameter {
            name: "target_edge_length",
            value: size.to_string(),
            allowed: "a finite number > 0",
        });
    }
    if !(0.0..=180.0).contains(&params.feature_angle_deg) {
        return Err(GeomError::InvalidParameter {
            name: "feature_angle_deg",
            value: params.feature_angle_deg.to_string(),
            allowed: "0 to 180",
        });
    }
    let n_faces: f64 = faces.iter().map(|face| wanted_faces(face, vertices, sizes)).sum();
    if n_faces.is_nan() || n_faces > MAX_FACES {
        let count = n_faces.min(usize::MAX as f64) as usize;
        return Err(GeomError::TooLarge { what: "faces", count, limit: MAX_FACES as usize });
    }
    Ok(())
}

/// How many triangles of the wanted size cover a face, no fewer than its longest edge alone asks for.
fn wanted_faces(face: &Face, vertices: &[DVec3], sizes: &[f64]) -> f64 {
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    let size = face.map(|v| sizes[v as usize]).into_iter().fold(f64::INFINITY, f64::min);
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let equilateral = 0.25 * 3f64.sqrt() * size * size;
    (0.5 * (b - a).cross(c - a).length() / equilateral).max(longest / size)
}
