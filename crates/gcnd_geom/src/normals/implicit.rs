//! Bilateral normal filtering (Zheng, Fu, Au, Tai 2011), global implicit scheme: all normals at once.

use crate::error::{Result, check_parameter, check_positive};
use crate::face_geometry::FaceGeometry;
use crate::normals::bilateral::move_to_normals;
use crate::normals::kernel::{CHUNK, unit_or_zero};
use crate::topology::{RingScratch, Topology};
use crate::watch::{Run, Watch};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::matrix_free::conjugate_gradient::{CgParams, conjugate_gradient, conjugate_gradient_scratch};
use faer::matrix_free::{IdentityPrecond, LinOp};
use faer::{MatMut, MatRef, Par};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Parameters of [`bilateral_normal_implicit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImplicitNormalParams {
    /// σ_r, as a distance between unit normals (0 to 2); 0.35 suits synthetic noise, 0.45 scans.
    pub sigma_r: f64,
    /// σ_s, in mesh units; `None` takes [`FaceGeometry::mean_centroid_distance`].
    pub sigma_s: Option<f64>,
    /// λ: how much the given normals count against smoothness; 0.0001 ≤ λ ≤ 1.
    pub smoothness: f64,
    /// Passes of vertex updating.
    pub vertex_iterations: usize,
    /// Whether vertices on a boundary stay where they are.
    pub fix_boundary: bool,
}

impl Default for ImplicitNormalParams {
    fn default() -> Self {
        Self { sigma_r: 0.35, sigma_s: None, smoothness: 0.01, vertex_iterations: 20, fix_boundary: true }
    }
}

impl ImplicitNormalParams {
    /// Checks the ranges.
    ///
    /// # Errors
    /// [`crate::GeomError::InvalidParameter`] with the first value out of range.
    pub fn validate(&self) -> Result<()> {
        check_positive("sigma_r", self.sigma_r)?;
        check_parameter(
            "smoothness",
            self.smoothness,
            (1e-4..=1.0).contains(&self.smoothness),
            "0.0001 to 1",
        )?;
        self.sigma_s.map_or(Ok(()), |sigma_s| check_positive("sigma_s", sigma_s))
    }
}

/// Filters all normals of a mesh at once, then moves its vertices to fit them. The normals n' minimise
/// (1 − λ) Σ_i |n'_i − Σ_{j ∈ N_i} w_ij n'_j|² + λ Σ_i |n'_i − n_i|², with
/// w_ij = a_j · W_s(|c_j − c_i|) · W_r(|n_j − n_i|) over their sum for i, W(x) = exp(−x² / (2σ²)), and N_i the faces that
/// share a vertex with i; they are normalised, and [`crate::vertex_update::update_vertices`] follows.
///
/// - `topology`, `vertices` (V), in mesh units; they are not changed.
/// - `params`: see [`ImplicitNormalParams`].
/// - `watch`: hears of the three coordinates of the normals, then of every pass of vertex updating; within a coordinate it
///   is asked after every step of the solver.
///
/// Returns (V) new positions, in mesh units. A face without area takes its neighbours' mean and has no say in theirs.
///
/// Memory: about 300 bytes a face and 12 for each of its neighbours, about 150 more, but 12 · n² around a hub of n faces, of
/// which each is every other's neighbour; the system is solved by conjugate gradients, to 10⁻¹⁰ of the right-hand side.
///
/// # Errors
/// [`crate::GeomError::InvalidParameter`], [`crate::GeomError::LengthMismatch`], [`crate::GeomError::NonFiniteVertex`],
/// [`crate::GeomError::Diverged`], also when the system cannot be solved to that precision, [`crate::GeomError::OutOfMemory`]
/// where the neighbours do not fit into what [`Watch::allow_memory`] says, or [`crate::GeomError::Cancelled`].
///
/// Source: Zheng et al. 2011, Eqs. 7–10, with equal weights for all faces as in the program of Zhang et al. 2015.
///
/// ```
/// use gcnd_geom::normals::{ImplicitNormalParams, bilateral_normal_implicit};
/// use gcnd_geom::{Topology, Watch, fixtures};
/// let (mut vertices, faces) = fixtures::grid(6, 6);
/// vertices[24].z = 0.1;
/// let topology = Topology::new(faces, vertices.len())?;
/// let params = ImplicitNormalParams::default();
/// let denoised = bilateral_normal_implicit(&topology, &vertices, &params, &mut Watch::silent())?;
/// assert!(denoised[24].z < 0.02);
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
pub fn bilateral_normal_implicit(
    topology: &Topology,
    vertices: &[DVec3],
    params: &ImplicitNormalParams,
    watch: &mut Watch<'_>,
) -> Result<Vec<DVec3>> {
    params.validate()?;
    let (mut run, positions) =
        Run::start(topology, vertices, params.vertex_iterations.saturating_add(3), watch)?;
    let geometry = FaceGeometry::compute(&positions, topology.faces());
    let sigma_s = match params.sigma_s {
        Some(sigma_s) => sigma_s * run.scale,
        None => geometry.mean_centroid_distance(topology)?,
    };
    run.claim(most_pairs(topology) * PAIR_BYTES)?;
    let sigmas = (sigma_s, params.sigma_r);
    let energy = Energy::new(topology, &geometry, sigmas, params.smoothness, || run.ask())?;
    let mut solved = [const { Vec::new() }; 3];
    for (axis, solution) in solved.iter_mut().enumerate() {
        let given: Vec<f64> = geometry.normals.iter().map(|n| n[axis]).collect();
        *solution = energy.minimize(&given, || run.ask())?.ok_or_else(|| run.diverged())?;
        run.tick()?;
    }
    let [x, y, z] = solved;
    let normals: Vec<DVec3> = (0..topology.n_faces())
        .map(|i| match unit_or_zero(DVec3::new(x[i], y[i], z[i])) {
            DVec3::ZERO => geometry.normals[i],
            normal => normal,
        })
        .collect();
    drop(energy);
    move_to_normals(topology, run, positions, &normals, params.vertex_iterations, params.fix_boundary)
}

/// A neighbour of a face, as [`Energy`] keeps it: its id and its weight.
const PAIR_BYTES: u64 = (size_of::<u32>() + size_of::<f64>()) as u64;
/// So many neighbours are looked up without a word.
const SILENT_PAIRS: usize = 1 << 22;

/// How many neighbours all faces have together, at most: around a vertex each face is every other's.
fn most_pairs(topology: &Topology) -> u64 {
    (0..topology.n_vertices())
        .map(|vertex_id| topology.vertex_faces().row(vertex_id).len() as u64)
        .map(|n| n * n.saturating_sub(1))
        .sum()
}

/// The energy's operator (1 − λ) LᵀL + λ I, with L = I − W.
struct Energy {
    /// Face i's neighbours and W_s · W_r of each lie at starts[i]..starts[i + 1].
    starts: Vec<usize>,
    neighbors: Vec<u32>,
    kernels: Vec<f64>,
    areas: Vec<f64>,
    /// One over the sum of a_j · W_s · W_r; zero for a face that listens to nobody.
    per_sum: Vec<f64>,
    smoothness: f64,
    is_stopped: AtomicBool,
}

impl std::fmt::Debug for Energy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Energy").field("n_faces", &self.areas.len()).finish_non_exhaustive()
    }
}

impl Energy {
    fn new(
        topology: &Topology,
        geometry: &FaceGeometry,
        (sigma_s, sigma_r): (f64, f64),
        smoothness: f64,
        mut ask: impl FnMut() -> Result<()>,
    ) -> Result<Self> {
        let FaceGeometry { normals, centroids, areas } = geometry;
        let spatial = if sigma_s > 0.0 { (-0.5 / (sigma_s * sigma_s)).max(f64::MIN) } else { 0.0 };
        // Finite, so that equal normals weigh 1 however small σ_r is.
        let range = (-0.5 / (sigma_r * sigma_r)).max(f64::MIN);
        let kernel = |i: usize, j: usize| {
            // An unknown normal is as near to one as to another.
            let is_known = normals[i] != DVec3::ZERO && normals[j] != DVec3::ZERO;
            let across = if is_known { range * normals[i].distance_squared(normals[j]) } else { 0.0 };
            (spatial * centroids[i].distance_squared(centroids[j]) + across).exp()
        };
        let (starts, neighbors) = vertex_neighbors(topology, &mut ask)?;
        let row = |i: usize| starts[i]..starts[i + 1];
        let rows = (0..areas.len()).into_par_iter().with_min_len(CHUNK);
        let mut kernels = vec![0.0; neighbors.len()];
        let mut rest = kernels.as_mut_slice();
        let slots: Vec<&mut [f64]> =
            (0..areas.len()).filter_map(|i| rest.split_off_mut(..row(i).len())).collect();
        slots.into_par_iter().with_min_len(CHUNK).enumerate().for_each(|(i, slots)| {
            for (slot, &j) in slots.iter_mut().zip(&neighbors[row(i)]) {
                *slot = kernel(i, j as usize);
            }
        });
        let per_sum = rows
            .map(|i| {
                let sum: f64 = row(i).map(|slot| areas[neighbors[slot] as usize] * kernels[slot]).sum();
                // One over a subnormal number is infinite.
                if sum >= f64::MIN_POSITIVE { sum.recip() } else { 0.0 }
            })
            .collect();
        let (areas, is_stopped) = (areas.clone(), AtomicBool::new(false));
        Ok(Self { starts, neighbors, kernels, areas, per_sum, smoothness, is_stopped })
    }

    /// One coordinate of n' for one coordinate of n; `None` if that is beyond the solver. `ask` is called after each of
    /// the solver's steps, and its error ends it.
    fn minimize(&self, given: &[f64], mut ask: impl FnMut() -> Result<()>) -> Result<Option<Vec<f64>>> {
        let n = given.len();
        let right: Vec<f64> = given.iter().map(|x| self.smoothness * x).collect();
        let mut solution = given.to_vec();
        let precond = IdentityPrecond { dim: n };
        // One thread for the sums, so that they do not depend on how many there are.
        let mut memory = MemBuffer::new(conjugate_gradient_scratch(precond, self, 1, Par::Seq));
        let params = CgParams { rel_tolerance: 1e-10, max_iters: 10_000, ..CgParams::default() };
        let mut told = Ok(());
        let result = conjugate_gradient(
            MatMut::from_column_major_slice_mut(&mut solution, n, 1),
            precond,
            self,
            MatRef::from_column_major_slice(&right, n, 1),
            params,
            |_| {
                told = ask();
                self.is_stopped.store(told.is_err(), Ordering::Relaxed);
            },
            Par::Seq,
            MemStack::new(&mut memory),
        );
        told?;
        Ok((result.is_ok() && solution.iter().all(|x| x.is_finite())).then_some(solution))
    }

    fn sum(&self, i: usize, term: impl Fn(usize) -> f64) -> f64 {
        let row = self.starts[i]..self.starts[i + 1];
        let terms = self.neighbors[row.clone()].iter().zip(&self.kernels[row]);
        terms.map(|(&j, kernel)| kernel * term(j as usize)).sum()
    }

    /// (1 − λ) LᵀL x + λ x.
    fn apply_to(&self, x: &[f64]) -> Vec<f64> {
        let rows = (0..x.len()).into_par_iter().with_min_len(CHUNK);
        let rough: Vec<f64> =
            rows.clone().map(|i| x[i] - self.per_sum[i] * self.sum(i, |j| self.areas[j] * x[j])).collect();
        rows.map(|i| {
            let transposed = rough[i] - self.areas[i] * self.sum(i, |j| self.per_sum[j] * rough[j]);
            (1.0 - self.smoothness) * transposed + self.smoothness * x[i]
        })
        .collect()
    }
}

/// Where the neighbours of each face begin, and all of them. `ask` is called now and then, and its error ends it.
fn vertex_neighbors(
    topology: &Topology,
    mut ask: impl FnMut() -> Result<()>,
) -> Result<(Vec<usize>, Vec<u32>)> {
    let mut starts = vec![0];
    // All at once: a vector that grows by itself takes up to three times what it holds.
    let mut neighbors = Vec::with_capacity(most_pairs(topology) as usize);
    let mut scratch = RingScratch::new();
    let mut asked = 0;
    for face_id in 0..topology.n_faces() {
        neighbors.extend_from_slice(topology.vertex_neighbors(face_id, &mut scratch));
        starts.push(neighbors.len());
        if neighbors.len() - asked > SILENT_PAIRS {
            asked = neighbors.len();
            ask()?;
        }
    }
    neighbors.shrink_to_fit();
    Ok((starts, neighbors))
}

impl LinOp<f64> for Energy {
    fn apply_scratch(&self, _rhs_ncols: usize, _par: Par) -> StackReq {
        StackReq::EMPTY
    }

    fn nrows(&self) -> usize {
        self.areas.len()
    }

    fn ncols(&self) -> usize {
        self.areas.len()
    }

    fn apply(&self, mut out: MatMut<'_, f64>, rhs: MatRef<'_, f64>, _par: Par, _stack: &mut MemStack) {
        if self.is_stopped.load(Ordering::Relaxed) {
            // The solver cannot be told to stop, but it ends at once where the operator is not positive.
            out.fill(f64::NAN);
            return;
        }
        for column in 0..rhs.ncols() {
            let x: Vec<f64> = rhs.col(column).iter().copied().collect();
            for (i, value) in self.apply_to(&x).into_iter().enumerate() {
                out[(i, column)] = value;
            }
        }
    }

    fn conj_apply(&self, out: MatMut<'_, f64>, rhs: MatRef<'_, f64>, par: Par, stack: &mut MemStack) {
        self.apply(out, rhs, par, stack);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GeomError, fixtures};

    fn energy(mesh: &fixtures::MeshParts, smoothness: f64) -> (Energy, FaceGeometry) {
        let geometry = FaceGeometry::compute(&mesh.0, &mesh.1);
        let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid");
        let energy = Energy::new(&topology, &geometry, (0.3, 0.5), smoothness, || Ok(()));
        (energy.expect("not stopped"), geometry)
    }

    #[test]
    fn two_faces_by_hand() {
        // Each is the other's only neighbour, so W swaps them: L = [[1, −1], [−1, 1]], LᵀL = 2 L.
        let (energy, _) = energy(&fixtures::two_triangles(), 0.2);
        let applied = energy.apply_to(&[1.0, 3.0]);
        let expected = [0.8 * 2.0 * -2.0 + 0.2, 0.8 * 2.0 * 2.0 + 0.6];
        assert!(applied.iter().zip(expected).all(|(a, e)| (a - e).abs() < 1e-14), "{applied:?}");
    }

    #[test]
    fn the_minimum_satisfies_the_equations() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        fixtures::jitter(&mut vertices, 0.05, 2);
        let (energy, geometry) = energy(&(vertices, faces), 0.01);
        let given: Vec<f64> = geometry.normals.iter().map(|n| n.y).collect();
        let solution = energy.minimize(&given, || Ok(())).expect("not stopped").expect("solvable");
        for (left, given) in energy.apply_to(&solution).iter().zip(&given) {
            assert!((left - 0.01 * given).abs() < 1e-10);
        }
    }

    #[test]
    fn the_solver_ends_within_a_step_of_a_no() {
        let (mut vertices, faces) = fixtures::icosphere(2);
        fixtures::jitter(&mut vertices, 0.05, 2);
        let (energy, geometry) = energy(&(vertices, faces), 0.01);
        let given: Vec<f64> = geometry.normals.iter().map(|n| n.y).collect();
        for last in [1, 5] {
            let (mut n_asked, stop) = (0, GeomError::Cancelled { iteration: 0 });
            let ask = || {
                n_asked += 1;
                if n_asked < last { Ok(()) } else { Err(stop.clone()) }
            };
            assert_eq!(energy.minimize(&given, ask), Err(stop.clone()));
            assert_eq!(n_asked, last);
            energy.is_stopped.store(false, Ordering::Relaxed);
        }
    }

    #[test]
    fn the_operator_is_symmetric() {
        let (energy, geometry) = energy(&fixtures::moebius(), 0.01);
        let (x, y): (Vec<f64>, Vec<f64>) = geometry.centroids.iter().map(|c| (c.x + c.y, c.z)).unzip();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&energy.apply_to(&x), &y) - dot(&x, &energy.apply_to(&y))).abs() < 1e-13);
    }

    /// A cone of so many faces around one vertex.
    fn cone(n: u32) -> (Topology, Vec<DVec3>) {
        let angle = std::f64::consts::TAU / f64::from(n);
        let rim = (0..n).map(|i| DVec3::new((f64::from(i) * angle).cos(), (f64::from(i) * angle).sin(), 0.0));
        let vertices: Vec<_> = std::iter::once(DVec3::Z).chain(rim).collect();
        let faces = (0..n).map(|i| [0, 1 + i, 1 + (i + 1) % n]).collect();
        (Topology::new(faces, vertices.len()).expect("valid"), vertices)
    }

    #[test]
    fn neighbours_around_a_hub_are_counted_before_they_are_stored() {
        let (topology, vertices) = cone(300);
        // Beside the hub, each rim vertex has two faces.
        let needed = 12 * (300 * 299 + 300 * 2);
        let filtered = |free| {
            let watch = &mut Watch::silent();
            watch.allow_memory(Some(free));
            bilateral_normal_implicit(&topology, &vertices, &ImplicitNormalParams::default(), watch)
        };
        assert_eq!(filtered(needed - 1), Err(GeomError::OutOfMemory { needed, free: needed - 1 }));
        assert!(filtered(needed).is_ok());
        let (starts, neighbors) = vertex_neighbors(&topology, || Ok(())).expect("not stopped");
        assert_eq!((starts.len(), neighbors.len()), (301, 300 * 299));
    }

    #[test]
    fn looking_up_many_neighbours_can_be_stopped() {
        let (topology, _) = cone(2100);
        let stop = GeomError::Cancelled { iteration: 0 };
        assert_eq!(vertex_neighbors(&topology, || Err(stop.clone())), Err(stop.clone()));
    }
}
