//! `gcnd._geom`: checks arrays, releases the GIL, calls one core function. No loop over faces here.
#![allow(missing_docs, reason = "the Python stub `_geom.pyi` documents this module")]

mod arrays;
mod classical;
mod errors;
mod filters;
mod kernels;
mod mesh;
mod patches;
mod watched;

use pyo3::prelude::*;

#[pymodule]
mod _geom {
    #[pymodule_export]
    use super::classical::{
        bilateral_mesh, bilateral_normal, bilateral_normal_implicit, fast_effective, guided_normal,
        hc_laplacian, l0, laplacian, low_rank, taubin, tgv,
    };
    #[pymodule_export]
    use super::filters::{
        fit_vertices, keep_detail, mean_edge_length, normal_angles, refine_consistent, refine_normals,
        remesh, update_vertices, vertex_error,
    };
    #[pymodule_export]
    use super::kernels::{
        edge_max_leaky, gather_max, gather_max_argmax, gather_max_backward, gather_sum, gather_sum_backward,
        knn, pool_nodes, pool_nodes_backward,
    };
    #[pymodule_export]
    use super::mesh::{PyTopology, face_geometry, find_spikes, orient, validate, weld};
    #[pymodule_export]
    use super::patches::{
        PyCover, PyNormalAccumulator, PyPatchExtractor, classify_faces, flat_share, mesh_roughness,
    };
}
