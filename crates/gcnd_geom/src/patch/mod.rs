//! Patches: the local, aligned graphs that the network reads (paper Sec. 4).
//!
//! | step | file | paper |
//! |---|---|---|
//! | which faces | `select` | Eq. 1 |
//! | and not a thin wall's other side | `sheets` | – |
//! | which frame | `voting` | Eqs. 2–3 |
//! | how many nodes | `budget` | Sec. 5 |
//! | features and static neighbours | `graph` | Sec. 4.3 |
//! | normals at several scales | `scale_space` | – |
//! | how rough the whole mesh is | `roughness` | – |
//! | flat, edge, corner, transitional | [`classes`] | Sec. 5.2 |
//! | overlapping patches | [`cover`] | – |
//! | the average of what they predict | [`accumulator`] | – |
//!
//! A [`PatchExtractor`] is built once per mesh and then fills caller-owned arrays for any list of faces, so
//! that the patches of a mesh are streamed and never held all at once.

pub mod accumulator;
mod budget;
pub mod classes;
pub mod cover;
mod graph;
mod id_slots;
mod params;
mod roughness;
mod scale_space;
mod select;
mod sheets;
pub(crate) mod symmetric_eigen;
mod voting;

pub use accumulator::NormalAccumulator;
pub use classes::{FaceClass, classify_faces};
pub use cover::Cover;
pub use params::{Budget, PatchParams, Sheets, VotingRegion};
pub(crate) use roughness::quantile;
pub use roughness::{ROUGHNESS_QUANTILES, mesh_roughness};

use crate::error::{GeomError, Result, check_len};
use crate::face_geometry::FaceGeometry;
use crate::mesh::check_vertices;
use crate::topology::Topology;
use crate::watch::{Ticks, Watch};
use glam::{DMat3, DVec3};
use graph::{PatchRow, PatchView, write_graph};
use rayon::prelude::*;
use scale_space::{FIRST_SCALES, SCALES, ScaleNormals, scale_space_normals};
use select::{PatchScale, SelectScratch, VertexTree};
use symmetric_eigen::Symmetric3;
use voting::LocalFace;

/// Extracts aligned patch graphs from one mesh.
///
/// ```
/// use gcnd_geom::{fixtures, patch::{PatchBuffers, PatchExtractor, PatchParams}, Topology};
/// let (vertices, faces) = fixtures::icosphere(3);
/// let topology = Topology::new(faces, vertices.len())?;
/// let extractor = PatchExtractor::new(&topology, &vertices, PatchParams::default())?;
/// let (n_patches, n_nodes, n_channels) = (2, 64, extractor.n_channels());
/// let mut features = vec![0.0; n_patches * n_nodes * n_channels];
/// let mut neighbors = vec![0; n_patches * n_nodes * 3];
/// let (mut face_ids, mut mask) = (vec![0; n_patches * n_nodes], vec![0; n_patches * n_nodes]);
/// let (mut world_from_patch, mut radii) = (vec![0.0; n_patches * 9], vec![0.0; n_patches]);
/// extractor.extract(&[7, 12], PatchBuffers {
///     features: &mut features,
///     neighbors: &mut neighbors,
///     face_ids: &mut face_ids,
///     mask: &mut mask,
///     world_from_patch: &mut world_from_patch,
///     radii: &mut radii,
/// })?;
/// assert_eq!((face_ids[0], face_ids[n_nodes]), (7, 12), "node 0 is the centre");
/// # Ok::<(), gcnd_geom::GeomError>(())
/// ```
#[derive(Debug)]
pub struct PatchExtractor<'a> {
    topology: &'a Topology,
    vertices: &'a [DVec3],
    geometry: FaceGeometry,
    tree: VertexTree,
    /// Normals of every face at several scales; empty without them.
    scale_space: Vec<ScaleNormals>,
    /// The same of the mesh before its first pass.
    first_normals: Vec<ScaleNormals>,
    params: PatchParams,
}

/// Caller-owned arrays for `P` patches of `N` nodes with `C` channels, each in row-major order.
#[derive(Debug)]
pub struct PatchBuffers<'a> {
    /// (P, N, C) without unit, in the patch frame. Channels: 0–2 centroid (c_j − c_i)/r; 3–5 normal n_j;
    /// 6 area a_j/ā, ā the mean over the centre and its 2-ring; 7 degree, edge neighbours/3; and with vertex
    /// offsets 8–16, (v − c_j)/r of the three vertices in the face's order, first the one nearest to c_i; with a
    /// scale space 9 more, the face's normals once the mesh is smoothed by 1, 4 and 16 iterations; with first normals 9
    /// more, the face's normals before the first pass, as they are and smoothed by 1 and 4; with a roughness 4 more, the
    /// same on every node of a patch: its log₁₀ in units of √ā, within −4 to 1.
    pub features: &'a mut [f32],
    /// (P, N, 3) nodes of the patch across the edges of each node's face; the node itself where there is none.
    pub neighbors: &'a mut [i32],
    /// (P, N) face of each node; node 0 is the centre.
    pub face_ids: &'a mut [u32],
    /// (P, N) 1 for a node of its own, 0 for a repeat that fills the patch up.
    pub mask: &'a mut [u8],
    /// (P, 3, 3) rotation of each patch: element `[p][r][c]` is coordinate r of the axis e_{c+1} in the axes of
    /// the mesh, so that `world_from_patch @ v_patch = v_world`.
    pub world_from_patch: &'a mut [f64],
    /// (P) patch radius r in mesh units; 1 where the areas give none.
    pub radii: &'a mut [f64],
}

/// Memory of one thread; every buffer keeps its capacity from patch to patch.
struct PatchScratch {
    select: SelectScratch,
    locals: Vec<LocalFace>,
    picks: Vec<u32>,
}

impl PatchScratch {
    fn new() -> Self {
        Self { select: SelectScratch::new(), locals: Vec::new(), picks: Vec::new() }
    }
}

impl<'a> PatchExtractor<'a> {
    /// Prepares a mesh: computes normals, centroids and areas and arranges its vertices for Eq. 1.
    ///
    /// `vertices` (V) are positions in mesh units; `topology` holds the faces.
    ///
    /// # Errors
    /// [`GeomError::EmptyMesh`], [`GeomError::LengthMismatch`] when `topology` counts other vertices,
    /// [`GeomError::NonFiniteVertex`], [`GeomError::InvalidParameter`].
    pub fn new(topology: &'a Topology, vertices: &'a [DVec3], params: PatchParams) -> Result<Self> {
        Self::watched(topology, vertices, vertices, params, &mut Watch::silent())
    }

    /// [`PatchExtractor::new`] of a mesh that `first` (V) are the positions of before its first pass, watched: `watch`
    /// hears of the geometry, the tree and every iteration of the scale space.
    ///
    /// # Errors
    /// Those of [`PatchExtractor::new`], also for `first`, and [`GeomError::Cancelled`].
    pub fn watched(
        topology: &'a Topology,
        vertices: &'a [DVec3],
        first: &[DVec3],
        params: PatchParams,
        watch: &mut Watch<'_>,
    ) -> Result<Self> {
        params.validate()?;
        check_len("vertices", topology.n_vertices(), vertices.len())?;
        if topology.n_faces() == 0 {
            return Err(GeomError::EmptyMesh);
        }
        check_len("first", topology.n_vertices(), first.len())?;
        check_vertices(vertices)?;
        check_vertices(first)?;
        let fields = [(params.scale_space, vertices, SCALES), (params.first_normals, first, FIRST_SCALES)];
        let iterations: usize = fields.iter().map(|(asked, _, scales)| usize::from(*asked) * scales[2]).sum();
        let mut ticks = Ticks::new(2 + iterations, watch);
        let geometry = FaceGeometry::compute(vertices, topology.faces());
        ticks.tick()?;
        let tree = VertexTree::new(topology, vertices);
        ticks.tick()?;
        let mut at_scales = |(asked, vertices, scales)| {
            if asked { scale_space_normals(topology, vertices, scales, &mut ticks) } else { Ok(Vec::new()) }
        };
        let [scale_space, first_normals] = [at_scales(fields[0])?, at_scales(fields[1])?];
        Ok(Self { topology, vertices, geometry, tree, scale_space, first_normals, params })
    }

    /// Normals, centroids and areas of the mesh.
    pub fn geometry(&self) -> &FaceGeometry {
        &self.geometry
    }

    /// The parameters given to [`PatchExtractor::new`].
    pub fn params(&self) -> &PatchParams {
        &self.params
    }

    /// Channels of [`PatchBuffers::features`]; see [`PatchParams::n_channels`].
    pub fn n_channels(&self) -> usize {
        self.params.n_channels()
    }

    /// Selects the faces of one patch: f_j with a vertex v_k such that ‖v_k − c_i‖ < r,
    /// r = patch_scale · sqrt(ā), ā the mean area of the centre and its 2-ring; with [`Sheets::One`] without the other
    /// side of a thin wall.
    ///
    /// Returns the centre, then the others by (distance of centroids, face id), before the patch is fixed to
    /// `n_nodes`; and r in mesh units, 1 where the areas give none (then the centre is alone).
    ///
    /// # Errors
    /// [`GeomError::InvalidParameter`] when there is no such face.
    ///
    /// Paper: Sec. 4.1, Eq. 1. Choice: docs/choices.md#patch-radius, docs/choices.md#other-sheets.
    pub fn select(&self, face_id: u32) -> Result<(Vec<u32>, f64)> {
        self.check_face_ids(&[face_id])?;
        let mut scratch = PatchScratch::new();
        let scale = self.select_into(face_id, &mut scratch);
        let selected = scratch.select.candidates.iter().map(|candidate| candidate.face_id).collect();
        Ok((selected, scale.radius.unwrap_or(1.0)))
    }

    /// Extracts the patches of `face_ids` (P) into `out`, in parallel and with the same bits for any number of
    /// threads, any order and any batch.
    ///
    /// # Errors
    /// [`GeomError::LengthMismatch`] naming the array, [`GeomError::InvalidParameter`] naming a face id that
    /// does not exist; `out` is then untouched.
    ///
    /// Paper: Sec. 4. Choice: docs/choices.md#frame-signs, docs/choices.md#features,
    /// docs/choices.md#patch-budget, docs/choices.md#rim-neighbors.
    pub fn extract(&self, face_ids: &[u32], out: PatchBuffers<'_>) -> Result<()> {
        let (n_patches, n_nodes, n_channels) = (face_ids.len(), self.params.n_nodes, self.n_channels());
        check_len("features", n_patches * n_nodes * n_channels, out.features.len())?;
        check_len("neighbors", n_patches * n_nodes * 3, out.neighbors.len())?;
        check_len("face_ids", n_patches * n_nodes, out.face_ids.len())?;
        check_len("mask", n_patches * n_nodes, out.mask.len())?;
        check_len("world_from_patch", n_patches * 9, out.world_from_patch.len())?;
        check_len("radii", n_patches, out.radii.len())?;
        self.check_face_ids(face_ids)?;
        face_ids
            .par_iter()
            .zip(out.features.par_chunks_exact_mut(n_nodes * n_channels))
            .zip(out.neighbors.par_chunks_exact_mut(n_nodes * 3))
            .zip(out.face_ids.par_chunks_exact_mut(n_nodes))
            .zip(out.mask.par_chunks_exact_mut(n_nodes))
            .zip(out.world_from_patch.par_chunks_exact_mut(9))
            .zip(out.radii.par_iter_mut())
            .with_min_len(16)
            .for_each_init(PatchScratch::new, |scratch, item| {
                let ((((((&face_id, features), neighbors), face_ids), mask), frame), radius) = item;
                let row = PatchRow { features, neighbors, face_ids, mask };
                let (world_from_patch, patch_radius) = self.extract_one(face_id, row, scratch);
                // glam stores columns, numpy rows.
                frame.copy_from_slice(&world_from_patch.transpose().to_cols_array());
                *radius = patch_radius;
            });
        Ok(())
    }

    /// One patch: select, align, fix to the budget, write.
    fn extract_one(&self, face_id: u32, row: PatchRow<'_>, scratch: &mut PatchScratch) -> (DMat3, f64) {
        let scale = self.select_into(face_id, scratch);
        let world_from_patch = self.frame(&scale, scratch);
        let PatchScratch { select, locals, picks } = scratch;
        let n_real = budget::fix_to_budget(
            select.candidates.len(),
            self.params.n_nodes,
            self.params.budget,
            face_id,
            picks,
        );
        let view = PatchView {
            topology: self.topology,
            vertices: self.vertices,
            centroids: &self.geometry.centroids,
            scale_space: &self.scale_space,
            first_normals: &self.first_normals,
            roughness: self.params.roughness.as_ref().map_or(&[], |roughness| roughness),
            mean_area: scale.mean_area,
            candidates: &select.candidates,
            locals,
            picks,
            n_real,
            center: self.geometry.centroids[face_id as usize],
            length_scale: scale.length_scale(),
            world_from_patch,
        };
        write_graph(&view, &mut select.seen_faces, row);
        (world_from_patch, scale.radius.unwrap_or(1.0))
    }

    /// Fills `scratch` with the patch of a face, in mesh ids and in the units of the patch.
    fn select_into(&self, face_id: u32, scratch: &mut PatchScratch) -> PatchScale {
        let PatchScratch { select, locals, .. } = scratch;
        let Self { topology, vertices, geometry, tree, params, .. } = self;
        let scale = select::patch_scale_of(topology, geometry, face_id, params.patch_scale, select);
        select::select_patch(topology, geometry, vertices, tree, face_id, scale.radius, select);
        if params.sheets == Sheets::One {
            sheets::leave_other_sheets(topology, geometry, &scale, select);
        }
        let to_local = self.to_local(face_id, &scale);
        locals.clear();
        locals.extend(select.candidates.iter().map(|candidate| to_local(candidate.face_id)));
        scale
    }

    /// Eqs. 2 and 3: the frame of the patch in `scratch`; the axes of the mesh where nobody votes.
    fn frame(&self, scale: &PatchScale, scratch: &PatchScratch) -> DMat3 {
        if self.params.voting_region == VotingRegion::Nobody {
            return DMat3::IDENTITY;
        }
        let (tensor, _) = self.voting_tensor(scale, scratch);
        voting::patch_frame(&tensor, scale.area_normal, &scratch.locals)
    }

    /// Eq. 2's tensor and Σ μ of the patch in `scratch`.
    fn voting_tensor(&self, scale: &PatchScale, scratch: &PatchScratch) -> (Symmetric3, f64) {
        let sigma_vote = self.params.sigma_vote;
        match self.params.voting_region {
            VotingRegion::Nobody => (Symmetric3::default(), 0.0),
            VotingRegion::Patch => voting::voting_tensor(scratch.locals.iter().copied(), sigma_vote),
            VotingRegion::TwoRing => {
                let ring = &scratch.select.two_ring;
                let to_local = self.to_local(ring[0], scale);
                voting::voting_tensor(ring.iter().map(|&face_id| to_local(face_id)), sigma_vote)
            }
        }
    }

    /// Maps mesh faces to the units of the patch around `center_id`.
    fn to_local(&self, center_id: u32, scale: &PatchScale) -> impl Fn(u32) -> LocalFace + Clone + '_ {
        let center = self.geometry.centroids[center_id as usize];
        let length_scale = scale.length_scale();
        let area_scale = if scale.radius.is_some() { scale.mean_area.recip() } else { 0.0 };
        move |face_id| {
            let face_id = face_id as usize;
            LocalFace {
                offset: (self.geometry.centroids[face_id] - center) * length_scale,
                normal: self.geometry.normals[face_id],
                area: self.geometry.areas[face_id] * area_scale,
            }
        }
    }

    fn check_face_ids(&self, face_ids: &[u32]) -> Result<()> {
        match face_ids.iter().find(|&&face_id| face_id as usize >= self.topology.n_faces()) {
            Some(face_id) => Err(GeomError::InvalidParameter {
                name: "face_ids",
                value: face_id.to_string(),
                allowed: "ids below the number of faces",
            }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    /// Eqs. 1–3 on two triangles folded by 90 degrees, every number worked out on paper.
    #[test]
    fn two_triangles_by_hand() {
        let (vertices, faces) = fixtures::two_triangles();
        let topology = Topology::new(faces, 4).expect("valid mesh");
        let sqrt3 = 3f64.sqrt();
        // Face 0: c = (1, 1, 0)/3, n = (0, 0, 1), a = 1/2. Face 1: c = (2, 2, 1)/3, n = (−1, −1, 1)/√3, a = √3/2.
        // ā = (1 + √3)/4; d = (1, 1, 1)/3, ‖d‖ = 1/√3.
        let radius = 4.0 * ((1.0 + sqrt3) / 4.0).sqrt();
        // d·n = −1/(3√3), d·d = 1/3, so n' = n + (2/√3) d = (−1, −1, 5)/(3√3).
        // μ = 1/√3 for the centre and exp(−‖d‖/(r/3)) for the other.
        let (mu_center, mu) = (sqrt3.recip(), (-3.0 / (sqrt3 * radius)).exp());
        let expected = Symmetric3 {
            diagonal: DVec3::new(mu / 27.0, mu / 27.0, mu_center + 25.0 * mu / 27.0),
            off_diagonal: DVec3::new(-5.0 * mu / 27.0, -5.0 * mu / 27.0, mu / 27.0),
        };
        for voting_region in [VotingRegion::Patch, VotingRegion::TwoRing] {
            let params = PatchParams { voting_region, ..PatchParams::default() };
            let extractor = PatchExtractor::new(&topology, &vertices, params).expect("valid mesh");
            let mut scratch = PatchScratch::new();
            let scale = extractor.select_into(0, &mut scratch);
            let (tensor, weight_sum) = extractor.voting_tensor(&scale, &scratch);
            assert!((scale.radius.expect("has area") - radius).abs() < 1e-15);
            assert!((weight_sum - (mu_center + mu)).abs() < 1e-15);
            assert!((tensor.diagonal - expected.diagonal).length() < 1e-15);
            assert!((tensor.off_diagonal - expected.off_diagonal).length() < 1e-15);
            // T lives in the plane of z and (1, 1, 0); e1 leans towards the mean normal, which leans to −x −y.
            let frame = extractor.frame(&scale, &scratch);
            assert!(frame.x_axis.z > 0.9 && frame.x_axis.x < 0.0);
            // The other face lies along +e2; e3 has no votes at all.
            assert!((frame.x_axis.x - frame.x_axis.y).abs() < 1e-15);
            assert!(frame.y_axis.x > 0.6 && frame.y_axis.z > 0.0);
            assert!((frame.z_axis - DVec3::new(-1.0, 1.0, 0.0).normalize()).length() < 1e-12);
        }
    }
}
