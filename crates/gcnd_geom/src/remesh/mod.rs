//! Isotropic remeshing that keeps sharp edges: regular triangles for training shapes.
//!
//! After Botsch and Kobbelt, *A Remeshing Approach to Multiresolution Modeling*, SGP 2004. One round splits the
//! edges longer than 4/3 of the wanted length, collapses those shorter than 4/5, flips edges towards valence
//! six and moves vertices tangentially; here every moved vertex is put back onto the input surface, and sharp
//! edges, corners and boundaries are kept as curves of their own.

mod collapse;
mod driver;
mod dynamic;
mod features;
mod flip;
mod relax;
mod split;
mod surface;

pub use driver::{RemeshParams, remesh, remesh_with_sizes};

#[cfg(test)]
mod tests;
