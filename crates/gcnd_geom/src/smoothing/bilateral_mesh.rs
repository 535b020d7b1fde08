//! Bilateral mesh denoising (Fleishman, Drori, Cohen-Or 2003).

use crate::csr::Csr;
use crate::error::Result;
use crate::face_geometry::FaceGeometry;
use crate::normals::kernel::unit_or_zero;
use crate::smoothing::umbrella::{CHUNK, adjacent_vertices};
use crate::topology::{RingScratch, Topology};
use crate::watch::{Run, Watch};
use glam::DVec3;
use rayon::prelude::*;

/// Parameters of [`bilateral_mesh`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BilateralMeshParams {
    /// Passes over the vertices.
    pub iterations: usize,
}

impl Default for BilateralMeshParams {
    fn default() -> Self {
        Self { iterations: 5 }
    }
}

impl BilateralMeshParams {
    /// Checks nothing: every number of iterations is allowed.
    ///
    /// # Errors
    /// None.
    pub fn validate(&self) -> Result<()> {
        Ok(())
    }
}

/// Moves every vertex along its normal by the bilateral mean of its neighbours' heights, `iterations` times:
/// v_i ← v_i + n_i · Σ_j W_c(|v_j − v_i|) · W_s(h_j) · h_j / Σ_j W_c · W_s, with h_j = n_i · (v_j − v_i) and
/// W(x) = exp(−x² / (2σ²)).
///
/// Per vertex, σ_c is the length of its shortest edge, the neighbours are the vertices within 2 σ_c that are reached
/// over such vertices along edges, itself among them, σ_s is the standard deviation of |h_j| over them, and n_i the
/// mean of its faces' unit normals.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`BilateralMeshParams`].
/// - `watch`: hears of every iteration.
///
/// Returns (V) new positions, in mesh units. Edges without length do not count for σ_c; a vertex without faces, normal
/// or an edge of any length stays.
///
/// # Errors
/// [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`], [`crate::GeomError::Diverged`] or
/// [`crate::GeomError::Cancelled`].
///
/// Source: Fleishman et al. 2003, Sec. 3; σ_c, σ_s and the normal as in the program of Zhang et al. 2015.
///
/// ```
/// use gcnd_geom::smoothing::{BilateralMeshParams, bilateral_mesh};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// fixtures::jitter(&mut vertices, 0.1, 1);
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = BilateralMeshParams::default();
/// let denoised = bilateral_mesh(&topology, &vertices, &params, &mut Watch::silent())?;
/// let roughness = |vertices: &[gcnd_geom::DVec3]| vertices.iter().map(|v| v.z.abs()).sum::<f64>();
/// assert!(roughness(&denoised) < 0.8 * roughness(&vertices));
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn bilateral_mesh(
    topology: &Topology,
    vertices: &[DVec3],
    params: &BilateralMeshParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let (mut run, mut current) = Run::start(topology, vertices, params.iterations, watch)?;
    let adjacent = adjacent_vertices(topology);
    let mut next = current.clone();
    for _ in 0..params.iterations {
        let normals = FaceGeometry::compute(&current, topology.faces()).normals;
        next.par_chunks_mut(CHUNK).enumerate().for_each_init(Scratch::default, |scratch, (chunk, moved)| {
            for (offset, moved) in moved.iter_mut().enumerate() {
                let i = chunk * CHUNK + offset;
                let row = topology.vertex_faces().row(i);
                let normal = unit_or_zero(row.iter().map(|&f| normals[f as usize]).sum());
                *moved = current[i] + bilateral_height(&adjacent, &current, i, normal, scratch) * normal;
            }
        });
        std::mem::swap(&mut current, &mut next);
        run.tick_positions(&current)?;
    }
    Ok(run.finish(current))
}

/// Scratch memory of one thread.
#[derive(Default)]
struct Scratch {
    seen: RingScratch,
    /// Neighbours as (squared distance, height).
    near: Vec<(f64, f64)>,
    queue: Vec<u32>,
}

/// How far to move one vertex along its normal.
fn bilateral_height(
    adjacent: &Csr,
    positions: &[DVec3],
    i: usize,
    normal: DVec3,
    scratch: &mut Scratch,
) -> f64 {
    let squared_length = |&v: &u32| positions[v as usize].distance_squared(positions[i]);
    let lengths = adjacent.row(i).iter().map(squared_length).filter(|l| *l > 0.0);
    let sigma_c2 = lengths.fold(f64::INFINITY, f64::min);
    if normal == DVec3::ZERO || sigma_c2 == f64::INFINITY {
        return 0.0;
    }
    gather(adjacent, positions, i, normal, 4.0 * sigma_c2, scratch);
    let count = scratch.near.len() as f64;
    let mean = scratch.near.iter().map(|(_, h)| h.abs()).sum::<f64>() / count;
    let variance = scratch.near.iter().map(|(_, h)| (h.abs() - mean).powi(2)).sum::<f64>() / count;
    // A thousandth of a billionth of the mesh: where all heights are alike, their weights are too.
    let sigma_s2 = variance.max(1e-24);
    let (mut sum, mut total) = (0.0, 0.0);
    for &(distance2, height) in &scratch.near {
        let weight = (-0.5 * (distance2 / sigma_c2 + height * height / sigma_s2)).exp();
        sum += weight * height;
        total += weight;
    }
    sum / total
}

/// Finds the vertices within the radius, the vertex itself first.
fn gather(
    adjacent: &Csr,
    positions: &[DVec3],
    i: usize,
    normal: DVec3,
    squared_radius: f64,
    scratch: &mut Scratch,
) {
    let Scratch { seen, near, queue } = scratch;
    seen.begin(positions.len());
    seen.visit(i as u32);
    near.clear();
    near.push((0.0, 0.0));
    queue.clear();
    queue.push(i as u32);
    let mut slot = 0;
    while let Some(&reached) = queue.get(slot) {
        slot += 1;
        for &v in adjacent.row(reached as usize) {
            if seen.visit(v) {
                let way = positions[v as usize] - positions[i];
                if way.length_squared() <= squared_radius {
                    near.push((way.length_squared(), way.dot(normal)));
                    queue.push(v);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spike_on_a_fan_by_hand() {
        // Four neighbours at distance 1 around a vertex at height 0: two of them at height 0.5, two at 0.
        let s = 0.75f64.sqrt();
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(-s, 0.0, 0.5), DVec3::new(0.0, -s, 0.5)];
        let faces = vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]];
        let adjacent = adjacent_vertices(&Topology::new(faces, 5).expect("valid"));
        let height = bilateral_height(&adjacent, &positions, 0, DVec3::Z, &mut Scratch::default());
        // |h| = 0, 0, 0, 0.5, 0.5: mean 0.2, variance (3 · 0.04 + 2 · 0.09) / 5 = 0.06; σ_c = 1.
        let (near, far) = ((-0.5f64).exp(), (-0.5f64 - 0.5 * 0.25 / 0.06).exp());
        let expected = 2.0 * far * 0.5 / (1.0 + 2.0 * near + 2.0 * far);
        assert!((height - expected).abs() < 1e-15, "{height} {expected}");
    }

    #[test]
    fn vertices_without_a_length_or_a_normal_stay() {
        let positions = [DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, DVec3::ONE];
        let adjacent = adjacent_vertices(&Topology::new(vec![[0, 1, 2]], 4).expect("valid"));
        let height = |i, normal| bilateral_height(&adjacent, &positions, i, normal, &mut Scratch::default());
        assert_eq!((height(0, DVec3::Z), height(3, DVec3::Z), height(0, DVec3::ZERO)), (0.0, 0.0, 0.0));
    }
}
