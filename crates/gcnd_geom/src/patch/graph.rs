//! The graph of a patch (paper Sec. 4.3): node features and static neighbours.

use super::id_slots::{IdSlots, NO_SLOT};
use super::roughness::roughness_channel;
use super::scale_space::{N_SCALES, ScaleNormals};
use super::select::Candidate;
use super::voting::LocalFace;
use crate::topology::Topology;
use glam::{DMat3, DVec3};

/// The slices of one patch in the output arrays; see [`super::PatchBuffers`].
pub(crate) struct PatchRow<'a> {
    pub(crate) features: &'a mut [f32],
    pub(crate) neighbors: &'a mut [i32],
    pub(crate) face_ids: &'a mut [u32],
    pub(crate) mask: &'a mut [u8],
}

/// What the nodes of one patch are computed from.
pub(crate) struct PatchView<'a> {
    pub(crate) topology: &'a Topology,
    pub(crate) vertices: &'a [DVec3],
    pub(crate) centroids: &'a [DVec3],
    /// Normals at several scales, empty where nodes do not carry them.
    pub(crate) scale_space: &'a [ScaleNormals],
    /// The same of the mesh before its first pass.
    pub(crate) first_normals: &'a [ScaleNormals],
    /// Of the whole mesh in mesh units, empty where nodes do not carry it.
    pub(crate) roughness: &'a [f64],
    /// ā in mesh units.
    pub(crate) mean_area: f64,
    /// The faces of the patch, the centre first, and the same faces in the units of the patch.
    pub(crate) candidates: &'a [Candidate],
    pub(crate) locals: &'a [LocalFace],
    /// Indices into `candidates`, one per node; the first `n_real` are distinct.
    pub(crate) picks: &'a [u32],
    pub(crate) n_real: usize,
    /// c_i in mesh units.
    pub(crate) center: DVec3,
    /// 1/r, zero for a patch without a radius.
    pub(crate) length_scale: f64,
    pub(crate) world_from_patch: DMat3,
}

/// Writes features, neighbours, face ids and mask of every node, repeats included.
///
/// `node_of_face` must hold the faces of the patch; their slots are set here.
pub(crate) fn write_graph(view: &PatchView<'_>, node_of_face: &mut IdSlots, row: PatchRow<'_>) {
    let (n_real, n_channels) = (view.n_real, row.features.len() / view.picks.len());
    for (node, &pick) in view.picks[..n_real].iter().enumerate() {
        let face_id = view.candidates[pick as usize].face_id;
        node_of_face.set_slot(face_id, node as u32);
        row.face_ids[node] = face_id;
    }
    for node in 0..n_real {
        let features = &mut row.features[node * n_channels..(node + 1) * n_channels];
        write_features(view, row.face_ids[node], &view.locals[view.picks[node] as usize], features);
        let neighbors = &mut row.neighbors[node * 3..node * 3 + 3];
        neighbors.fill(node as i32);
        let adjacent = view.topology.edge_neighbors(row.face_ids[node] as usize);
        let slots = adjacent.iter().map(|&face_id| node_of_face.slot(face_id));
        let present = slots.filter(|&slot| slot != NO_SLOT);
        neighbors.iter_mut().zip(present).for_each(|(neighbor, slot)| *neighbor = slot as i32);
    }
    // A sliver's feature beyond the range of f32 becomes the largest finite number, and 0 where the differences of
    // coordinates near the end of f64 have overflowed into nothing.
    for feature in &mut row.features[..n_real * n_channels] {
        *feature = if feature.is_nan() { 0.0 } else { feature.clamp(f32::MIN, f32::MAX) };
    }
    for (node, &repeated) in view.picks.iter().enumerate().skip(n_real) {
        let repeated = repeated as usize;
        row.features.copy_within(repeated * n_channels..(repeated + 1) * n_channels, node * n_channels);
        row.neighbors.copy_within(repeated * 3..repeated * 3 + 3, node * 3);
        row.face_ids[node] = row.face_ids[repeated];
    }
    row.mask[..n_real].fill(1);
    row.mask[n_real..].fill(0);
}

/// Channels: centroid (3), normal (3), area (1), degree (1), three vertex offsets (9) where there is room, and the
/// normals of the scale space (9), those before the first pass (9) and the roughness of the mesh (4) where there are.
#[inline]
fn write_features(view: &PatchView<'_>, face_id: u32, local: &LocalFace, features: &mut [f32]) {
    let axes = &view.world_from_patch;
    write_rotated(axes, local.offset, &mut features[0..3]);
    write_rotated(axes, local.normal, &mut features[3..6]);
    features[6] = local.area as f32;
    features[7] = view.topology.edge_neighbors(face_id as usize).len() as f32 / 3.0;
    let n_own = features.len() - view.roughness.len();
    let (rest, of_mesh) = features[8..].split_at_mut(n_own - 8);
    for (channel, &value) in of_mesh.iter_mut().zip(view.roughness) {
        *channel = roughness_channel(value, view.mean_area);
    }
    let at_scales = [view.scale_space, view.first_normals].map(|normals| normals.get(face_id as usize));
    let n_scaled = 3 * N_SCALES * at_scales.iter().flatten().count();
    let (offsets, normals) = rest.split_at_mut(rest.len() - n_scaled);
    if !offsets.is_empty() {
        for (offset, out) in vertex_offsets(view, face_id).into_iter().zip(offsets.chunks_exact_mut(3)) {
            write_rotated(axes, offset, out);
        }
    }
    for (normal, out) in at_scales.into_iter().flatten().flatten().zip(normals.chunks_exact_mut(3)) {
        write_rotated(axes, *normal, out);
    }
}

/// Writes a vector's coordinates along the axes of the patch.
#[inline(always)]
fn write_rotated(world_from_patch: &DMat3, v: DVec3, out: &mut [f32]) {
    out[0] = v.dot(world_from_patch.x_axis) as f32;
    out[1] = v.dot(world_from_patch.y_axis) as f32;
    out[2] = v.dot(world_from_patch.z_axis) as f32;
}

/// (v − c_j) / r of the three vertices in the face's own order, started at the vertex nearest to the patch
/// centre, so that it does not matter which vertex the file names first.
#[inline]
fn vertex_offsets(view: &PatchView<'_>, face_id: u32) -> [DVec3; 3] {
    let [u, v, w] =
        view.topology.faces()[face_id as usize].map(|vertex_id| view.vertices[vertex_id as usize]);
    let centroid = view.centroids[face_id as usize];
    let [to_u, to_v, to_w] = [u, v, w].map(|corner| corner.distance_squared(view.center));
    let corners = if to_u <= to_v && to_u <= to_w {
        [u, v, w]
    } else if to_v <= to_w {
        [v, w, u]
    } else {
        [w, u, v]
    };
    corners.map(|corner| (corner - centroid) * view.length_scale)
}
