//! numpy arrays as the core's slices. The only place where glam's column-major matrices would meet numpy's rows;
//! the core writes row-major `(P, 3, 3)` itself, so nothing is transposed here.

use crate::errors::ConfigError;
use bytemuck::{AnyBitPattern, NoUninit};
use gcnd_geom::{DVec3, Face};
use numpy::{Element, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn, PyReadwriteArrayDyn};
use pyo3::prelude::*;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;
pub type Faces<'py> = PyReadonlyArray2<'py, u32>;

fn rows<'a, S, T>(name: &str, array: &'a PyReadonlyArray2<'_, S>) -> PyResult<&'a [T]>
where
    S: Element + NoUninit,
    T: AnyBitPattern,
{
    use numpy::PyUntypedArrayMethods;
    if array.shape()[1] != 3 {
        let shape = array.shape();
        return Err(ConfigError::new_err(format!("{name} has shape {shape:?}, expected (n, 3)")));
    }
    let slice = array
        .as_slice()
        .map_err(|_| ConfigError::new_err(format!("{name} must be a contiguous array in C order")))?;
    Ok(bytemuck::cast_slice(slice))
}

/// `(n, 3)` float64 as points.
pub fn points<'a>(name: &str, array: &'a Points<'_>) -> PyResult<&'a [DVec3]> {
    rows(name, array)
}

/// `(n, 3)` uint32 as faces.
pub fn faces<'a>(array: &'a Faces<'_>) -> PyResult<&'a [Face]> {
    rows("faces", array)
}

/// Any contiguous array as a slice.
pub fn slice<'a, T: Element>(name: &str, array: &'a PyReadonlyArrayDyn<'_, T>) -> PyResult<&'a [T]> {
    array
        .as_slice()
        .map_err(|_| ConfigError::new_err(format!("{name} must be a contiguous array in C order")))
}

/// Any contiguous writable array as a slice.
pub fn slice_mut<'a, T: Element>(
    name: &str,
    array: &'a mut PyReadwriteArrayDyn<'_, T>,
) -> PyResult<&'a mut [T]> {
    array
        .as_slice_mut()
        .map_err(|_| ConfigError::new_err(format!("{name} must be a contiguous array in C order")))
}

/// Triples as a new `(n, 3)` array.
pub fn triples<'py, S, T>(py: Python<'py>, values: Vec<T>) -> PyResult<Bound<'py, PyArray2<S>>>
where
    T: NoUninit,
    S: Element + AnyBitPattern,
{
    let flat: &[S] = bytemuck::cast_slice(&values);
    numpy::PyArray1::from_slice(py, flat).reshape([values.len(), 3])
}
