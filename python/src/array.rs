//! Numpy arrays: checked input, batches over any leading shape, and results that are moved to numpy without a copy.

use crate::errors::input;
use numpy::ndarray::{ArrayD, IxDyn};
use numpy::{IntoPyArray as _, PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::borrow::Cow;

/// An array of floats of Python.
pub type Output<'py> = Bound<'py, PyArrayDyn<f64>>;

/// Numbers of Python: a numpy array, which is read in place, or anything that `numpy.asarray` makes one of.
pub struct Input<'py>(PyReadonlyArrayDyn<'py, f64>);

impl<'a, 'py> FromPyObject<'a, 'py> for Input<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let array = match object.cast::<PyArrayDyn<f64>>() {
            Ok(array) => array.to_owned(),
            Err(_) => {
                let numpy = object.py().import("numpy")?;
                numpy.call_method1("asarray", (object, "float64"))?.cast_into::<PyArrayDyn<f64>>()?
            }
        };
        Ok(Self(array.try_readonly()?))
    }
}

/// Vectors of one length in an array whose last dimension is that length.
pub struct Vectors<'a> {
    /// Leading shape; empty: one vector.
    pub lead: Vec<usize>,
    width: usize,
    values: Cow<'a, [f64]>,
}

impl Input<'_> {
    /// The vectors of `width` numbers in the argument `name`; `of` says what the numbers belong to.
    pub fn vectors(&self, name: &str, width: usize, of: &str) -> PyResult<Vectors<'_>> {
        let array = self.0.as_array();
        let shape = array.shape();
        match shape.split_last() {
            Some((last, lead)) if *last == width => Ok(Vectors {
                lead: lead.to_vec(),
                width,
                values: match array.to_slice() {
                    Some(values) => Cow::Borrowed(values),
                    None => Cow::Owned(array.iter().copied().collect()),
                },
            }),
            _ => Err(input(format!(
                "`{name}`: expected an array of shape (..., {width}), {of}, got the shape {shape:?}"
            ))),
        }
    }

    /// The one vector in the argument `name`, as [`Self::vectors`].
    pub fn vector(&self, name: &str, width: usize, of: &str) -> PyResult<Cow<'_, [f64]>> {
        let vectors = self.vectors(name, width, of)?;
        if vectors.lead.is_empty() {
            return Ok(vectors.values);
        }
        let shape = self.shape();
        Err(input(format!("`{name}`: expected an array of shape ({width},), {of}, got the shape {shape:?}")))
    }

    /// The shape of the array.
    pub fn shape(&self) -> Vec<usize> {
        self.0.as_array().shape().to_vec()
    }

    /// The numbers in the order of C.
    pub fn numbers(&self) -> Vec<f64> {
        self.0.as_array().iter().copied().collect()
    }
}

impl Vectors<'_> {
    /// Number of vectors.
    pub fn count(&self) -> usize {
        self.lead.iter().product()
    }

    /// Vector number `i`; the only one for each number if there is one vector without a leading shape.
    #[inline]
    pub fn get(&self, i: usize) -> &[f64] {
        let i = if self.lead.is_empty() { 0 } else { i };
        &self.values[i * self.width..][..self.width]
    }
}

/// An array of Python with these values.
pub fn output(py: Python<'_>, shape: Vec<usize>, values: Vec<f64>) -> PyResult<Output<'_>> {
    let array = ArrayD::from_shape_vec(IxDyn(&shape), values).map_err(crate::errors::failed)?;
    Ok(array.into_pyarray(py))
}

/// Batches of fewer vectors are computed on the thread of the caller, which does not release the interpreter for one vector.
const FEW: usize = 64;

/// Computes an array of the shape `out` for each vector of `inputs`, whose leading shapes are equal or empty: `each` gets the number of the
/// vector and writes its part of the result. Large batches run on all cores, with the same bits.
pub fn map<'py, const N: usize>(
    py: Python<'py>,
    inputs: [(&str, &Vectors<'_>); N],
    out: &[usize],
    each: impl Fn(usize, &mut [f64]) -> PyResult<()> + Sync,
) -> PyResult<Output<'py>> {
    let mut lead: &[usize] = &[];
    let mut of = "";
    for (name, vectors) in inputs {
        if vectors.lead.is_empty() || vectors.lead == lead {
            continue;
        }
        if !lead.is_empty() {
            return Err(input(format!(
                "`{name}`: expected the leading shape {lead:?} of `{of}`, or one vector, got {:?}",
                vectors.lead
            )));
        }
        (lead, of) = (&vectors.lead, name);
    }
    let (count, size) = (lead.iter().product::<usize>(), out.iter().product::<usize>());
    let mut values = vec![0.0; count * size];
    if count == 1 {
        each(0, &mut values)?;
    } else if size > 0 {
        py.detach(|| {
            if count < FEW {
                values.chunks_exact_mut(size).enumerate().try_for_each(|(i, part)| each(i, part))
            } else {
                values.par_chunks_exact_mut(size).enumerate().try_for_each(|(i, part)| each(i, part))
            }
        })?;
    }
    output(py, [lead, out].concat(), values)
}
