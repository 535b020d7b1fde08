//! Core errors as the package's Python exceptions.

use gcnd_geom::GeomError;
use pyo3::{PyErr, PyResult};

pyo3::import_exception!(gcnd.errors, GcndError);
pyo3::import_exception!(gcnd.errors, MeshError);
pyo3::import_exception!(gcnd.errors, ConfigError);

/// Turns a core error into `MeshError`, for parameters and array lengths `ConfigError`, for a filter that stopped
/// `GcndError`.
pub fn to_python(error: &GeomError) -> PyErr {
    let message = error.to_string();
    match error {
        GeomError::InvalidParameter { .. } | GeomError::LengthMismatch { .. } => {
            ConfigError::new_err(message)
        }
        GeomError::Diverged { .. } => GcndError::new_err((message, "choose milder parameters")),
        GeomError::Cancelled { .. } => GcndError::new_err(message),
        GeomError::OutOfMemory { .. } => MeshError::new_err((
            message,
            "close other programs, cut the mesh into parts, or use a machine with more memory",
        )),
        _ => MeshError::new_err(message),
    }
}

/// Adds the conversion to every core result.
pub trait IntoPython<T> {
    fn into_python(self) -> PyResult<T>;
}

impl<T> IntoPython<T> for gcnd_geom::Result<T> {
    fn into_python(self) -> PyResult<T> {
        self.map_err(|error| to_python(&error))
    }
}
