//! The one error type of the core: every variant carries the offending ids and values.

use thiserror::Error;

/// What can be wrong with a mesh, an array or a parameter.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum GeomError {
    /// The mesh has no face to work on.
    #[error("the mesh has no faces")]
    EmptyMesh,
    /// A face names a vertex that does not exist.
    #[error("face {face_id} refers to vertex {vertex_id}, but the mesh has {n_vertices} vertices")]
    IndexOutOfRange {
        /// The face that holds the index.
        face_id: usize,
        /// The index as given.
        vertex_id: i64,
        /// How many vertices there are.
        n_vertices: usize,
    },
    /// A vertex has a NaN or infinite coordinate.
    #[error("vertex {vertex_id} has a coordinate that is NaN or infinite")]
    NonFiniteVertex {
        /// The first such vertex.
        vertex_id: usize,
    },
    /// Two arrays that belong together differ in length.
    #[error("{what} has length {got}, expected {expected}")]
    LengthMismatch {
        /// Which array.
        what: &'static str,
        /// The length it should have.
        expected: usize,
        /// The length it has.
        got: usize,
    },
    /// A parameter lies outside its allowed range.
    #[error("{name} is {value}, allowed: {allowed}")]
    InvalidParameter {
        /// The parameter's name as in the public interface.
        name: &'static str,
        /// The value given.
        value: String,
        /// The allowed values in words.
        allowed: &'static str,
    },
    /// More items than 32-bit ids can number.
    #[error("{count} {what} are too many, the limit is {limit}")]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// Positions left the bounding box by more than its longest side, something became NaN, or a system could not be solved.
    #[error("the filter diverged in iteration {iteration}; the input is unchanged")]
    Diverged {
        /// The iteration, counted from 1 over all of the filter's steps.
        iteration: usize,
    },
    /// A filter is about to take more memory than it may.
    #[error("the system to be solved takes about {:.1} GB of memory, and {:.1} GB are free", *needed as f64 / 1e9, *free as f64 / 1e9)]
    OutOfMemory {
        /// What it would take, in bytes.
        needed: u64,
        /// What is left of what it was allowed, in bytes.
        free: u64,
    },
    /// Whoever watched a filter asked it to stop.
    #[error("the filter was cancelled after iteration {iteration}; the input is unchanged")]
    Cancelled {
        /// The last iteration that was done, counted from 1 over all of the filter's steps.
        iteration: usize,
    },
}

/// A result whose error is a [`GeomError`].
pub type Result<T> = std::result::Result<T, GeomError>;

/// Returns [`GeomError::LengthMismatch`] unless `got == expected`.
pub fn check_len(what: &'static str, expected: usize, got: usize) -> Result<()> {
    if expected == got { Ok(()) } else { Err(GeomError::LengthMismatch { what, expected, got }) }
}

/// Returns [`GeomError::InvalidParameter`] unless `value` is positive and finite.
pub fn check_positive(name: &'static str, value: f64) -> Result<()> {
    check_parameter(name, value, value.is_finite() && value > 0.0, "a positive finite number")
}

/// Returns [`GeomError::InvalidParameter`] unless `is_allowed`.
pub fn check_parameter(
    name: &'static str,
    value: impl ToString,
    is_allowed: bool,
    allowed: &'static str,
) -> Result<()> {
    if is_allowed {
        Ok(())
    } else {
        Err(GeomError::InvalidParameter { name, value: value.to_string(), allowed })
    }
}
