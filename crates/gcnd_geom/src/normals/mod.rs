//! Filters on face normals: refinement of given normals, and classical filters that end in vertex updating.
//!
//! | filter | function | source |
//! |---|---|---|
//! | normal refinement | [`refine_normals`] | paper Sec. 6.1, Eq. 5 |
//! | the same where predictions allow it | [`refine_consistent`] | ours |
//! | bilateral normal filtering | [`bilateral_normal`] | Zheng et al. 2011 |
//! | the same, all normals at once | [`bilateral_normal_implicit`] | Zheng et al. 2011 |
//! | guided normal filtering | [`guided_normal`] | Zhang et al. 2015 |
//! | fast and effective denoising | [`fast_effective`] | Sun et al. 2007 |
//! | total generalised variation | [`tgv`] | Liu et al. 2022 |
//! | non-local low-rank filtering | [`low_rank()`] | Li et al. 2018 |

pub mod adaptive;
pub mod bilateral;
pub mod fast_effective;
pub(crate) mod guidance;
pub mod guided;
pub mod implicit;
pub(crate) mod kernel;
pub mod low_rank;
pub mod neighborhood;
pub mod refine;
pub mod tgv;

pub use adaptive::{AdaptiveParams, refine_consistent};
pub use bilateral::{BilateralNormalParams, bilateral_normal};
pub use fast_effective::{FastEffectiveParams, fast_effective};
pub use guided::{GuidedNormalParams, guided_normal};
pub use implicit::{ImplicitNormalParams, bilateral_normal_implicit};
pub use low_rank::{LowRankParams, low_rank};
pub use neighborhood::Neighborhood;
pub use refine::{RefineParams, refine_normals};
pub use tgv::{TgvParams, tgv};
