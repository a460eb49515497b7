//! Cycles as arrays, recordings in MCAP files, and their pages.

use crate::array::{Output, output};
use crate::errors::{failed, input, of_failure};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use upswing_ipc::{Mode, Telemetry};
use upswing_process::Failure;
use upswing_record::{Message, RecordingError, Window, scan};
use upswing_view::page::{self, PageData, RecordingDigest};

/// The cycles as a dictionary of arrays with the names of the fields of a recording.
pub fn arrays<'py>(py: Python<'py>, cycles: &[Telemetry]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let whole = |name: &str, of: fn(&Telemetry) -> u64| {
        dict.set_item(name, PyArray1::from_iter(py, cycles.iter().map(of)))
    };
    whole("seq", |c| c.seq)?;
    whole("t_ns", |c| c.t_ns)?;
    whole("measurement_seq", |c| c.measurement_seq)?;
    whole("mode", |c| c.mode)?;
    whole("fault", |c| c.fault)?;
    whole("warnings", |c| c.warnings)?;
    whole("degraded", |c| c.degraded)?;
    whole("plan_id", |c| c.plan_id)?;
    whole("flags", |c| c.flags)?;
    whole("wake_ns", |c| c.wake_ns)?;
    whole("read_ns", |c| c.read_ns)?;
    whole("compute_ns", |c| c.compute_ns)?;
    whole("write_ns", |c| c.write_ns)?;
    whole("clock", |c| c.clock)?;
    dict.set_item("t_plan", PyArray1::from_iter(py, cycles.iter().map(|c| c.t_plan)))?;
    let rows = |name: &str, of: fn(&Telemetry) -> &[f64]| -> PyResult<()> {
        let width = cycles.first().map_or(0, |cycle| of(cycle).len());
        let values: Vec<f64> = cycles.iter().flat_map(|cycle| of(cycle).iter().copied()).collect();
        let array: Output<'_> = output(py, vec![cycles.len(), width], values)?;
        dict.set_item(name, array)
    };
    rows("q", |c| c.of_joints(&c.q))?;
    rows("qd", |c| c.of_joints(&c.qd))?;
    rows("q_d", |c| c.of_joints(&c.q_d))?;
    rows("qd_d", |c| c.of_joints(&c.qd_d))?;
    rows("u_d", |c| c.of_actuated(&c.u_d))?;
    rows("u", |c| c.of_actuated(&c.u))?;
    rows("tau", |c| c.of_actuated(&c.tau))?;
    rows("tau_measured", |c| c.of_actuated(&c.tau_measured))?;
    dict.set_item("modes", Mode::ALL.iter().map(Mode::to_string).collect::<Vec<_>>())?;
    Ok(dict)
}

/// The time window of the arguments.
fn window(start: f64, end: Option<f64>) -> PyResult<Window> {
    let to = end.unwrap_or(f64::INFINITY);
    match start >= 0.0 && start < to {
        true => Ok(Window { from: start, to }),
        false => Err(input(format!("`start`, `end`: expected 0 <= start < end in s, got {start} to {to}"))),
    }
}

/// Reads a recording: its cycles as arrays, and its details, settings and joints.
#[pyfunction]
#[pyo3(signature = (path, start = 0.0, end = None))]
pub fn read_recording(
    py: Python<'_>,
    path: PathBuf,
    start: f64,
    end: Option<f64>,
) -> PyResult<Bound<'_, PyDict>> {
    let window = window(start, end)?;
    let (cycles, recording) = py.detach(|| upswing_record::read(&path, window)).map_err(input)?;
    let model = recording.model(&path).map_err(input)?;
    let dict = arrays(py, &cycles)?;
    dict.set_item("joints", model.joint_names().collect::<Vec<_>>())?;
    let actuated = (0..model.sizes().actuated()).map(|i| model.joint_name(i));
    dict.set_item("actuated", actuated.collect::<Vec<_>>())?;
    dict.set_item("details", recording.details)?;
    dict.set_item("files", recording.files.into_iter().collect::<std::collections::HashMap<_, _>>())?;
    dict.set_item("cut", recording.cut)?;
    dict.set_item("damage", recording.damage)?;
    Ok(dict)
}

/// The page of a recording, as `upswing report` writes it.
pub fn page_of(path: &Path, window: Window) -> Result<Vec<u8>, Failure> {
    let mut digest = None;
    let recording = scan(
        path,
        window,
        |_, _| (),
        |head, message| -> Result<(), RecordingError> {
            let Message::Cycle(cycle) = message else { return Ok(()) };
            let digest = match &mut digest {
                Some(digest) => digest,
                none => none.insert(RecordingDigest::new(path, head)?),
            };
            digest.take(&cycle);
            Ok(())
        },
    )?;
    // Cannot fail: a recording has at least one cycle.
    let digest = digest.ok_or_else(|| Failure::failed("no cycle"))?;
    let mut html = Vec::new();
    page::write(&PageData::new(path, &recording, &digest)?, &mut html).map_err(Failure::failed)?;
    Ok(html)
}

/// The page of a recording as HTML.
#[pyfunction]
#[pyo3(signature = (path, start = 0.0, end = None))]
pub fn report_html(py: Python<'_>, path: PathBuf, start: f64, end: Option<f64>) -> PyResult<String> {
    let window = window(start, end)?;
    let html = py.detach(|| page_of(&path, window)).map_err(of_failure)?;
    String::from_utf8(html).map_err(failed)
}
