//! Parameters of patch extraction.

use super::roughness::ROUGHNESS_QUANTILES;
use crate::error::{GeomError, Result};

/// How a patch is fixed to `n_nodes` nodes.
///
/// Paper: Sec. 5 ("random shrinkage or extension"). Choice: docs/choices.md#patch-budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Budget {
    /// The nearest faces by (distance of centroids, face id); a small patch is repeated from its start.
    NearestFirst,
    /// The centre and a random subset; a small patch is extended by random repeats.
    Random {
        /// Together with the face id it fixes every draw, whatever the order or the batch.
        seed: u64,
    },
}

/// Which of the faces within the radius belong to a patch.
///
/// Paper: Sec. 4.1, Eq. 1. Choice: docs/choices.md#other-sheets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sheets {
    /// All (the text).
    All,
    /// All but what is not connected to the centre within the patch and faces the other way, as the other side of a
    /// thin wall does.
    One,
}

/// Which faces vote for the frame of a patch.
///
/// Paper: Sec. 4.2, Eq. 2. Choice: docs/choices.md#voting-region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VotingRegion {
    /// All faces of the patch, before it is fixed to `n_nodes` (the text).
    Patch,
    /// The centre and its 2-ring (the authors' program).
    TwoRing,
    /// Nobody: patches keep the axes of the mesh, "w/o any alignment" of the paper's Sec. 7.5.
    Nobody,
}

/// What a patch is and what its nodes carry.
///
/// Paper: Sec. 4. Choice: docs/choices.md#voting-sigma, docs/choices.md#features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchParams {
    /// The paper's k in r = k · sqrt(ā), without unit, 2 to 10.
    pub patch_scale: f64,
    /// Which of the faces within the radius belong to the patch.
    pub sheets: Sheets,
    /// Nodes of every patch, 16 to 512.
    pub n_nodes: usize,
    /// How a patch is fixed to `n_nodes`.
    pub budget: Budget,
    /// Which faces vote for the frame.
    pub voting_region: VotingRegion,
    /// σ of Eq. 2 in units of the patch radius, above zero.
    pub sigma_vote: f64,
    /// Whether nodes carry the offsets of their three vertices (9 more channels).
    pub vertex_offsets: bool,
    /// Whether nodes carry the normals of the mesh at three scales (9 more channels).
    pub scale_space: bool,
    /// Whether nodes carry the normals of the mesh before its first pass, as they are and at two scales (9 more
    /// channels).
    pub first_normals: bool,
    /// The roughness of the whole mesh in mesh units, of which every node carries the logarithm (4 more channels);
    /// see [`super::mesh_roughness`].
    pub roughness: Option<[f64; ROUGHNESS_QUANTILES.len()]>,
}

impl Default for PatchParams {
    /// The 64 nearest faces within 4 · sqrt(ā), voting by the whole patch with σ = r/3, vertex offsets on.
    fn default() -> Self {
        Self {
            patch_scale: 4.0,
            sheets: Sheets::All,
            n_nodes: 64,
            budget: Budget::NearestFirst,
            voting_region: VotingRegion::Patch,
            sigma_vote: 1.0 / 3.0,
            vertex_offsets: true,
            scale_space: false,
            first_normals: false,
            roughness: None,
        }
    }
}

impl PatchParams {
    /// Checks that every parameter is in its range.
    ///
    /// # Errors
    /// [`GeomError::InvalidParameter`] naming the first parameter that is not.
    ///
    /// ```
    /// use gcnd_geom::patch::PatchParams;
    /// assert!(PatchParams::default().validate().is_ok());
    /// assert!(PatchParams { n_nodes: 8, ..PatchParams::default() }.validate().is_err());
    /// ```
    pub fn validate(&self) -> Result<()> {
        let check = |ok: bool, name: &'static str, value: String, allowed: &'static str| {
            if ok { Ok(()) } else { Err(GeomError::InvalidParameter { name, value, allowed }) }
        };
        let Self { patch_scale, n_nodes, sigma_vote, roughness, .. } = *self;
        check((2.0..=10.0).contains(&patch_scale), "patch_scale", patch_scale.to_string(), "2 to 10")?;
        check((16..=512).contains(&n_nodes), "n_nodes", n_nodes.to_string(), "16 to 512")?;
        let sigma_ok = sigma_vote.is_finite() && sigma_vote > 0.0;
        check(sigma_ok, "sigma_vote", sigma_vote.to_string(), "a finite number above 0")?;
        let roughness_ok = roughness.iter().flatten().all(|value| value.is_finite() && *value >= 0.0);
        check(roughness_ok, "roughness", format!("{roughness:?}"), "finite numbers from 0 on")
    }

    /// Features of a node: 8, 9 each for vertex offsets, the scale space and the normals before the first pass, and 4
    /// for the roughness.
    pub fn n_channels(&self) -> usize {
        let n_mesh = if self.roughness.is_some() { ROUGHNESS_QUANTILES.len() } else { 0 };
        let nines = [self.vertex_offsets, self.scale_space, self.first_normals];
        8 + 9 * nines.into_iter().filter(|&has| has).count() + n_mesh
    }
}
