//! numpy arrays as the core's slices. The only place where glam's column-major matrices would meet numpy's rows;
//! the core writes row-major `(P, 3, 3)` itself, so nothing is transposed here.

use crate::errors::ConfigError;
use bytemuck::{AnyBitPattern, NoUninit};
use gcnd_geom::{DVec3, Face};
use numpy::{
    Element, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;
pub type Faces<'py> = PyReadonlyArray2<'py, u32>;

/// `as_slice` also takes Fortran order, whose values would be read in the wrong places.
fn c_order<T>(name: &str, in_order: bool, slice: Result<T, impl std::error::Error>) -> PyResult<T> {
    let refuse = || ConfigError::new_err(format!("{name} must be a contiguous array in C order"));
    if in_order { slice.map_err(|_| refuse()) } else { Err(refuse()) }
}

fn rows<'a, S, T>(name: &str, array: &'a PyReadonlyArray2<'_, S>) -> PyResult<&'a [T]>
where
    S: Element + NoUninit,
    T: AnyBitPattern,
{
    if array.shape()[1] != 3 {
        let shape = array.shape();
        return Err(ConfigError::new_err(format!("{name} has shape {shape:?}, expected (n, 3)")));
    }
    Ok(bytemuck::cast_slice(c_order(name, array.is_c_contiguous(), array.as_slice())?))
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
    c_order(name, array.is_c_contiguous(), array.as_slice())
}

/// Any contiguous writable array as a slice.
pub fn slice_mut<'a, T: Element>(
    name: &str,
    array: &'a mut PyReadwriteArrayDyn<'_, T>,
) -> PyResult<&'a mut [T]> {
    let in_order = array.is_c_contiguous();
    c_order(name, in_order, array.as_slice_mut())
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
