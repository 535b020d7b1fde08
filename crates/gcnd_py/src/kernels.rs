//! The network's CPU kernels on torch's memory: float32, or bfloat16 as its 16-bit patterns.

use crate::arrays::{slice, slice_mut};
use crate::errors::{ConfigError, IntoPython};
use gcnd_geom::kernels::{self, Bf16, GatherShape};
use numpy::{
    PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

type Untyped<'a, 'py> = &'a Bound<'py, PyUntypedArray>;

fn sizes<const D: usize>(name: &str, shape: &[usize]) -> PyResult<[usize; D]> {
    shape
        .try_into()
        .map_err(|_| ConfigError::new_err(format!("{name} has shape {shape:?}, expected {D} dimensions")))
}

fn gather_shape(values: Untyped<'_, '_>, n_neighbors: usize) -> PyResult<GatherShape> {
    let [n_patches, n_nodes, n_channels] = sizes("values", values.shape())?;
    Ok(GatherShape { n_patches, n_nodes, n_channels, n_neighbors })
}

fn neighbor_count(neighbors: &PyReadonlyArrayDyn<'_, i32>) -> PyResult<usize> {
    Ok(sizes::<3>("neighbors", neighbors.shape())?[2])
}

/// Two arrays of one element type, input and output: float32, or bfloat16 patterns as int16.
enum Pair<'py> {
    Single(PyReadonlyArrayDyn<'py, f32>, PyReadwriteArrayDyn<'py, f32>),
    Brain(PyReadonlyArrayDyn<'py, i16>, PyReadwriteArrayDyn<'py, i16>),
}

fn pair<'py>(input: Untyped<'_, 'py>, output: Untyped<'_, 'py>) -> PyResult<Pair<'py>> {
    if let (Ok(a), Ok(b)) = (input.cast::<PyArrayDyn<f32>>(), output.cast::<PyArrayDyn<f32>>()) {
        return Ok(Pair::Single(a.readonly(), b.readwrite()));
    }
    if let (Ok(a), Ok(b)) = (input.cast::<PyArrayDyn<i16>>(), output.cast::<PyArrayDyn<i16>>()) {
        return Ok(Pair::Brain(a.readonly(), b.readwrite()));
    }
    let message = format!(
        "values have dtypes {} and {}, expected both float32 or both int16 (bfloat16 patterns)",
        input.dtype(),
        output.dtype()
    );
    Err(ConfigError::new_err(message))
}

/// Calls a core kernel, generic over its element, on a pair of arrays outside the GIL.
macro_rules! on_pair {
    ($py:expr, $input:expr, $output:expr, |$a:ident, $b:ident| $call:expr) => {
        match pair($input, $output)? {
            Pair::Single(a, mut b) => {
                let ($a, $b) = (slice("values", &a)?, slice_mut("out", &mut b)?);
                $py.detach(|| $call).into_python()
            }
            Pair::Brain(a, mut b) => {
                let $a: &[Bf16] = bytemuck::cast_slice(slice("values", &a)?);
                let $b: &mut [Bf16] = bytemuck::cast_slice_mut(slice_mut("out", &mut b)?);
                $py.detach(|| $call).into_python()
            }
        }
    };
}

#[pyfunction]
pub fn gather_max(
    py: Python<'_>,
    values: Untyped<'_, '_>,
    neighbors: PyReadonlyArrayDyn<'_, i32>,
    out: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(values, neighbor_count(&neighbors)?)?;
    let neighbors = slice("neighbors", &neighbors)?;
    on_pair!(py, values, out, |a, b| kernels::gather_max_values(a, neighbors, shape, b))
}

#[pyfunction]
pub fn gather_max_argmax(
    py: Python<'_>,
    values: Untyped<'_, '_>,
    neighbors: PyReadonlyArrayDyn<'_, i32>,
    out: Untyped<'_, '_>,
    mut argmax: PyReadwriteArrayDyn<'_, i16>,
) -> PyResult<()> {
    let shape = gather_shape(values, neighbor_count(&neighbors)?)?;
    let neighbors = slice("neighbors", &neighbors)?;
    let argmax: &mut [u16] = bytemuck::cast_slice_mut(slice_mut("argmax", &mut argmax)?);
    on_pair!(py, values, out, |a, b| kernels::gather_max(a, neighbors, shape, b, argmax))
}

#[pyfunction]
pub fn gather_max_backward(
    py: Python<'_>,
    grad_out: Untyped<'_, '_>,
    argmax: PyReadonlyArrayDyn<'_, i16>,
    grad: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(grad_out, 1)?;
    let argmax: &[u16] = bytemuck::cast_slice(slice("argmax", &argmax)?);
    on_pair!(py, grad_out, grad, |a, b| kernels::gather_max_backward(a, argmax, shape, b))
}

#[pyfunction]
pub fn gather_sum(
    py: Python<'_>,
    values: Untyped<'_, '_>,
    neighbors: PyReadonlyArrayDyn<'_, i32>,
    out: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(values, neighbor_count(&neighbors)?)?;
    let neighbors = slice("neighbors", &neighbors)?;
    on_pair!(py, values, out, |a, b| kernels::gather_sum(a, neighbors, shape, b))
}

#[pyfunction]
pub fn gather_sum_backward(
    py: Python<'_>,
    grad_out: Untyped<'_, '_>,
    neighbors: PyReadonlyArrayDyn<'_, i32>,
    grad: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(grad_out, neighbor_count(&neighbors)?)?;
    let neighbors = slice("neighbors", &neighbors)?;
    on_pair!(py, grad_out, grad, |a, b| kernels::gather_sum_backward(a, neighbors, shape, b))
}

#[pyfunction]
pub fn edge_max_leaky(
    py: Python<'_>,
    parts: Untyped<'_, '_>,
    scale: PyReadonlyArrayDyn<'_, f32>,
    neighbors: PyReadonlyArrayDyn<'_, i32>,
    slope: f32,
    out: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(out, neighbor_count(&neighbors)?)?;
    let (scale, neighbors) = (slice("scale", &scale)?, slice("neighbors", &neighbors)?);
    on_pair!(py, parts, out, |a, b| kernels::edge_max_leaky(a, scale, neighbors, shape, slope, b))
}

#[pyfunction]
pub fn pool_nodes(
    py: Python<'_>,
    values: Untyped<'_, '_>,
    out: Untyped<'_, '_>,
    mut argmax: PyReadwriteArrayDyn<'_, i16>,
) -> PyResult<()> {
    let shape = gather_shape(values, 1)?;
    let argmax: &mut [u16] = bytemuck::cast_slice_mut(slice_mut("argmax", &mut argmax)?);
    on_pair!(py, values, out, |a, b| kernels::pool_nodes(a, shape, b, argmax))
}

#[pyfunction]
pub fn pool_nodes_backward(
    py: Python<'_>,
    grad_out: Untyped<'_, '_>,
    argmax: PyReadonlyArrayDyn<'_, i16>,
    grad: Untyped<'_, '_>,
) -> PyResult<()> {
    let shape = gather_shape(grad, 1)?;
    let argmax: &[u16] = bytemuck::cast_slice(slice("argmax", &argmax)?);
    on_pair!(py, grad_out, grad, |a, b| kernels::pool_nodes_backward(a, argmax, shape, b))
}

#[pyfunction]
pub fn knn(py: Python<'_>, features: Untyped<'_, '_>, mut out: PyReadwriteArrayDyn<'_, i32>) -> PyResult<()> {
    let [n_patches, n_nodes, n_channels] = sizes("features", features.shape())?;
    let [_, _, k] = sizes::<3>("out", out.shape())?;
    let out = slice_mut("out", &mut out)?;
    if let Ok(features) = features.cast::<PyArrayDyn<f32>>() {
        let features = features.readonly();
        let values = slice("features", &features)?;
        return py.detach(|| kernels::knn(values, n_patches, n_nodes, n_channels, k, out)).into_python();
    }
    let features = features
        .cast::<PyArrayDyn<i16>>()
        .map_err(|_| ConfigError::new_err("features must be float32 or int16 (bfloat16 patterns)"))?
        .readonly();
    let values: &[Bf16] = bytemuck::cast_slice(slice("features", &features)?);
    py.detach(|| kernels::knn(values, n_patches, n_nodes, n_channels, k, out)).into_python()
}
