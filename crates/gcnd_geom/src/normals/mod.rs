//! Filters on face normals; positions stay as they are.
//!
//! | filter | function | source |
//! |---|---|---|
//! | normal refinement | [`refine_normals`] | paper Sec. 6.1, Eq. 5 |
//! | the same where predictions allow it | [`refine_consistent`] | ours |

pub mod adaptive;
pub mod refine;

pub use adaptive::{AdaptiveParams, refine_consistent};
pub use refine::{Neighborhood, RefineParams, refine_normals};
