//! What the tests of patches share: the arrays of an extraction and a mesh without symmetry.

use gcnd_geom::patch::{PatchBuffers, PatchExtractor, PatchParams};
use gcnd_geom::{DMat3, DVec3, Face, Topology, fixtures};

pub type Mesh = (Vec<DVec3>, Vec<Face>);

/// The arrays of some patches.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    pub n_nodes: usize,
    pub n_channels: usize,
    pub features: Vec<f32>,
    pub neighbors: Vec<i32>,
    pub face_ids: Vec<u32>,
    pub mask: Vec<u8>,
    pub world_from_patch: Vec<f64>,
    pub radii: Vec<f64>,
}

impl Patches {
    pub fn empty(n_patches: usize, params: &PatchParams) -> Self {
        let (n_nodes, n_channels) = (params.n_nodes, params.n_channels());
        let n = n_patches * n_nodes;
        Self {
            n_nodes,
            n_channels,
            // Values that a forgotten write would leave behind.
            features: vec![f32::NAN; n * n_channels],
            neighbors: vec![-1; n * 3],
            face_ids: vec![u32::MAX; n],
            mask: vec![7; n],
            world_from_patch: vec![f64::NAN; n_patches * 9],
            radii: vec![f64::NAN; n_patches],
        }
    }

    pub fn buffers(&mut self) -> PatchBuffers<'_> {
        PatchBuffers {
            features: &mut self.features,
            neighbors: &mut self.neighbors,
            face_ids: &mut self.face_ids,
            mask: &mut self.mask,
            world_from_patch: &mut self.world_from_patch,
            radii: &mut self.radii,
        }
    }

    pub fn face_ids(&self, patch: usize) -> &[u32] {
        &self.face_ids[patch * self.n_nodes..(patch + 1) * self.n_nodes]
    }

    pub fn mask(&self, patch: usize) -> &[u8] {
        &self.mask[patch * self.n_nodes..(patch + 1) * self.n_nodes]
    }

    pub fn neighbors(&self, patch: usize, node: usize) -> &[i32] {
        let start = (patch * self.n_nodes + node) * 3;
        &self.neighbors[start..start + 3]
    }

    pub fn features(&self, patch: usize, node: usize) -> &[f32] {
        let start = (patch * self.n_nodes + node) * self.n_channels;
        &self.features[start..start + self.n_channels]
    }

    pub fn frame(&self, patch: usize) -> DMat3 {
        DMat3::from_cols_slice(&self.world_from_patch[patch * 9..patch * 9 + 9]).transpose()
    }

    pub fn is_finite(&self) -> bool {
        self.features.iter().all(|x| x.is_finite())
            && self.world_from_patch.iter().chain(&self.radii).all(|x| x.is_finite())
    }
}

pub fn extract(mesh: &Mesh, face_ids: &[u32], params: PatchParams) -> Patches {
    let topology = Topology::new(mesh.1.clone(), mesh.0.len()).expect("valid mesh");
    let extractor = PatchExtractor::new(&topology, &mesh.0, params).expect("valid mesh");
    let mut patches = Patches::empty(face_ids.len(), &params);
    extractor.extract(face_ids, patches.buffers()).expect("valid face ids");
    patches
}

pub fn extract_all(mesh: &Mesh, params: PatchParams) -> Patches {
    extract(mesh, &(0..mesh.1.len() as u32).collect::<Vec<_>>(), params)
}

/// A closed surface without symmetry, 512 faces.
pub fn bumpy_sphere(seed: u64) -> Mesh {
    let (mut vertices, faces) = fixtures::icosphere(3);
    fixtures::jitter(&mut vertices, 0.03, seed);
    for v in &mut vertices {
        *v *= 1.0 + 0.1 * (3.0 * v.x + 1.0).sin() + 0.07 * (4.0 * v.y - 2.0 * v.z + seed as f64).cos();
    }
    (vertices, faces)
}
