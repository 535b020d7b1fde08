//! Vertices and faces: validation and welding. No adjacency here.

use crate::error::{GeomError, Result};
use glam::DVec3;
use std::collections::HashMap;

/// A triangle: three vertex ids, anticlockwise seen from outside.
pub type Face = [u32; 3];

/// Checks that a mesh can be worked on: it has faces, its indices exist, its coordinates are finite.
///
/// Boundaries, non-manifold edges, isolated vertices, zero-area or repeated faces and several components
/// are input to be handled and pass.
///
/// # Errors
/// [`GeomError::EmptyMesh`], [`GeomError::IndexOutOfRange`] or [`GeomError::NonFiniteVertex`], each with the
/// first offending id.
///
/// ```
/// use gcnd_geom::{mesh::validate, DVec3, GeomError};
/// let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y];
/// assert!(validate(&vertices, &[[0, 1, 2]]).is_ok());
/// assert_eq!(
///     validate(&vertices, &[[0, 1, 3]]),
///     Err(GeomError::IndexOutOfRange { face_id: 0, vertex_id: 3, n_vertices: 3 })
/// );
/// ```
pub fn validate(vertices: &[DVec3], faces: &[Face]) -> Result<()> {
    if faces.is_empty() {
        return Err(GeomError::EmptyMesh);
    }
    check_vertices(vertices)?;
    check_faces(faces, vertices.len())
}

/// Checks that every coordinate is finite.
///
/// # Errors
/// [`GeomError::NonFiniteVertex`] with the first offending id.
pub fn check_vertices(vertices: &[DVec3]) -> Result<()> {
    match vertices.iter().position(|v| !v.is_finite()) {
        Some(vertex_id) => Err(GeomError::NonFiniteVertex { vertex_id }),
        None => Ok(()),
    }
}

/// Checks that every face refers to existing vertices and that ids fit in 32 bits.
///
/// # Errors
/// [`GeomError::IndexOutOfRange`] with the first offending face, or [`GeomError::TooLarge`].
pub fn check_faces(faces: &[Face], n_vertices: usize) -> Result<()> {
    let limit = u32::MAX as usize;
    for (what, count) in [("vertices", n_vertices), ("faces", faces.len())] {
        if count > limit {
            return Err(GeomError::TooLarge { what, count, limit });
        }
    }
    for (face_id, face) in faces.iter().enumerate() {
        if let Some(&bad) = face.iter().find(|&&v| v as usize >= n_vertices) {
            return Err(GeomError::IndexOutOfRange { face_id, vertex_id: i64::from(bad), n_vertices });
        }
    }
    Ok(())
}

/// Vertices merged by exactly equal position.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Weld {
    /// The first vertex at each distinct position, ascending.
    pub representatives: Vec<u32>,
    /// For every input vertex its index in [`Weld::representatives`].
    pub welded_from_input: Vec<u32>,
}

/// Merges vertices whose coordinates are exactly equal, as an STL file and texture seams repeat them.
///
/// `0.0` and `-0.0` are the same position. The order of first appearance is kept.
///
/// ```
/// use gcnd_geom::{mesh::weld, DVec3};
/// let weld = weld(&[DVec3::X, DVec3::Y, DVec3::X]);
/// assert_eq!(weld.representatives, [0, 1]);
/// assert_eq!(weld.welded_from_input, [0, 1, 0]);
/// ```
pub fn weld(vertices: &[DVec3]) -> Weld {
    let key = |v: &DVec3| (*v + DVec3::ZERO).to_array().map(f64::to_bits);
    let mut seen: HashMap<[u64; 3], u32> = HashMap::with_capacity(vertices.len());
    let mut representatives = Vec::new();
    let welded_from_input = (0u32..)
        .zip(vertices)
        .map(|(vertex_id, v)| {
            *seen.entry(key(v)).or_insert_with(|| {
                representatives.push(vertex_id);
                representatives.len() as u32 - 1
            })
        })
        .collect();
    Weld { representatives, welded_from_input }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_defect_is_named_with_its_first_id() {
        let v = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(0.0, f64::NAN, 0.0), DVec3::INFINITY];
        assert_eq!(validate(&v[..3], &[]), Err(GeomError::EmptyMesh));
        assert_eq!(validate(&v, &[[0, 1, 2]]), Err(GeomError::NonFiniteVertex { vertex_id: 3 }));
        assert_eq!(
            validate(&v[..3], &[[0, 1, 2], [0, 9, 2]]),
            Err(GeomError::IndexOutOfRange { face_id: 1, vertex_id: 9, n_vertices: 3 })
        );
    }

    #[test]
    fn welding_takes_negative_zero_for_zero() {
        let weld = weld(&[DVec3::new(-0.0, 1.0, 2.0), DVec3::ONE, DVec3::new(0.0, 1.0, 2.0)]);
        assert_eq!(weld.representatives, [0, 1]);
        assert_eq!(weld.welded_from_input, [0, 1, 0]);
    }
}
