//! Filters on vertex positions.
//!
//! | filter | function | source |
//! |---|---|---|
//! | bilateral mesh denoising | [`bilateral_mesh`] | Fleishman et al. 2003 |
//! | L0 minimisation | [`l0`](l0()) | He, Schaefer 2013 |
//! | Laplacian smoothing | [`laplacian`] | folklore; Taubin 1995, Sec. 2 |
//! | Taubin smoothing | [`taubin`] | Taubin 1995 |
//! | HC-Laplacian smoothing | [`hc_laplacian`] | Vollmer et al. 1999 |

pub mod bilateral_mesh;
pub mod hc_laplacian;
pub mod l0;
pub mod laplacian;
pub mod taubin;
pub(crate) mod umbrella;

pub use bilateral_mesh::{BilateralMeshParams, bilateral_mesh};
pub use hc_laplacian::{HcLaplacianParams, hc_laplacian};
pub use l0::{L0Params, l0};
pub use laplacian::{LaplacianParams, laplacian};
pub use taubin::{TaubinParams, taubin};
