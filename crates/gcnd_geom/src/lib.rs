//! Geometry core of gcnd, feature-preserving mesh denoising after *GCN-Denoiser* (Shen et al., ACM TOG 2022).
//!
//! Coordinates are `f64`, ids are `u32`, every loop over faces or vertices is parallel, and one thread and
//! many give bit-identical results. The crate knows no Python, reads no files and prints nothing.
//!
//! The pipeline, in the order in which a mesh passes through it:
//!
//! | step | module | paper |
//! |---|---|---|
//! | validate, weld | [`mesh`] | – |
//! | adjacency, once | [`topology`] | – |
//! | which faces to turn | [`orientation`] | – |
//! | which vertices to take off | [`spikes`] | – |
//! | normals, centroids, areas | [`face_geometry`] | Sec. 4 |
//! | aligned patch graphs | [`patch`] | Sec. 4, Eqs. 1–3 |
//! | the network's CPU kernels | [`kernels`] | Sec. 5.1, Eq. 4 |
//! | normal refinement | [`normals`] | Sec. 6.1, Eq. 5 |
//! | vertex updating | [`vertex_update`] | Sec. 6.2, Eq. 6 |
//! | vertices between both | [`vertex_fit`] | Eq. 6, other weights |
//! | detail under weak noise | [`keep_detail`] | – |
//! | E_a, E_v | [`metrics`] | Sec. 7.2, Eqs. 7–8 |
//!
//! The classical filters, which need no network, are in [`normals`] and [`smoothing`]; [`watch`] reports how far they
//! are and stops them.
//!
//! [`remesh`] makes training shapes: isotropic triangles with sharp edges kept.

pub(crate) mod cholesky;
pub mod csr;
pub(crate) mod edge_pairs;
pub mod error;
pub mod face_geometry;
#[doc(hidden)]
pub mod fixtures;
pub mod flatness;
pub mod keep_detail;
pub mod kernels;
pub mod mesh;
pub mod metrics;
pub mod normals;
pub mod orientation;
pub mod patch;
pub mod remesh;
pub(crate) mod rim;
pub mod smoothing;
pub mod spikes;
pub mod topology;
pub mod vertex_fit;
pub mod vertex_update;
pub mod watch;

pub use error::{GeomError, Result};
pub use glam::{DMat3, DVec3};
pub use mesh::Face;
pub use topology::Topology;
pub use watch::Watch;
