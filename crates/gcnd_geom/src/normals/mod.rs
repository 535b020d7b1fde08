//! Filters on face normals; positions stay as they are.
//!
//! | filter | function | source |
//! |---|---|---|
//! | normal refinement | [`refine_normals`] | paper Sec. 6.1, Eq. 5 |

pub mod refine;

pub use refine::{Neighborhood, RefineParams, refine_normals};
