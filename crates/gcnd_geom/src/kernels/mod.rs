//! The network's CPU kernels: gather-max with its backward pass, the fused EdgeConv stage, k-nearest-neighbours
//! and pooling inside a patch, on plain row-major slices.
//!
//! EdgeConv with one linear layer, `max_j leaky(W · [F_i, F_j − F_i])`, is `leaky(a_i + max_j b_j)` with
//! `a = (W₁ − W₂) F` and `b = W₂ F`: the linear layer runs once per node, and what is left per edge is a gather
//! and a max. The kernels here are that rest, and the neighbour search of the dynamic variant.
//!
//! | kernel | computes | used in |
//! |---|---|---|
//! | [`gather_max`] | `out[p,i,c] = max_k values[p, neighbors[p,i,k], c]` and its argmax | training, forward |
//! | [`gather_max_backward`] | the scatter of `grad_out` to the nodes that won | training, backward |
//! | [`gather_max_values`] | the same maximum without the argmax | inference |
//! | [`gather_sum`], [`gather_sum_backward`] | the sum over neighbours and its transpose | training |
//! | [`edge_max_leaky`] | `leaky(a_i + s · max_j b_j)` in one pass | inference |
//! | [`knn`] | the k nearest nodes of each node, itself first | both |
//! | [`pool_nodes`], [`pool_nodes_backward`] | mean and maximum over the nodes of a patch | both |
//!
//! Every kernel is parallel over patches and treats a patch in one fixed order, so one thread and many give
//! bit-identical results. AVX2 and AVX-512 are used where the processor has them.
//!
//! Paper: Sec. 5.1, Eq. 4.

mod edge_max;
mod element;
mod gather_max;
mod gather_sum;
mod knn;
mod pool;
mod shape;
mod simd;

pub use edge_max::edge_max_leaky;
pub use element::{Bf16, Element};
pub use gather_max::{gather_max, gather_max_backward, gather_max_values};
pub use gather_sum::{gather_sum, gather_sum_backward};
pub use knn::knn;
pub use pool::{pool_nodes, pool_nodes_backward};
pub use shape::GatherShape;
