//! Trajectory databases: read, verified, built.

use crate::array::{Input, Output, output};
use crate::errors::{failed, input};
use crate::progress::interruptible;
use crate::system::{System, To, Wanted};
use crate::trajectory::{Trajectory, certificate};
use pyo3::exceptions::{PyIndexError, PyKeyboardInterrupt};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use upswing_config::Config;
use upswing_planner::database::{self, BuildSummary, DatabaseFile};
use upswing_planner::replan::key;
use upswing_process::output::OutputFile;
use upswing_process::shard::Shard;
use upswing_trajectory::{Database as File, Entry};

/// A database of trajectories of one manoeuvre: a sequence of `Trajectory`.
#[pyclass(frozen, module = "upswing")]
pub struct Database {
    config: Arc<Config>,
    manoeuvre: usize,
    file: File,
    /// Path of the file, or name of the shipped database.
    #[pyo3(get)]
    origin: String,
}

impl Database {
    /// Reads a file that was made for these settings.
    fn of(py: Python<'_>, system: &System, manoeuvre: usize, file: DatabaseFile) -> PyResult<Self> {
        let config = system.config.clone();
        let origin = file.origin.clone();
        let file = py.detach(|| {
            let file = file.load().map_err(input)?;
            let made_for = database::check_origin(&config, manoeuvre, &file);
            made_for.map(|()| file).map_err(|e| input(format!("{origin}: {e}")))
        })?;
        Ok(Self { config, manoeuvre, file, origin })
    }

    /// The database of the settings; `None` if there is none.
    pub fn of_settings(py: Python<'_>, system: &System, manoeuvre: usize) -> PyResult<Option<Self>> {
        let file = DatabaseFile::of(&system.config, manoeuvre).map_err(input)?;
        file.map(|file| Self::of(py, system, manoeuvre, file)).transpose()
    }

    fn entry(&self, number: usize) -> PyResult<Entry> {
        if number >= self.file.entries() {
            let count = self.file.entries();
            return Err(PyIndexError::new_err(format!(
                "expected an entry from 0 to {}, got {number}",
                count.saturating_sub(1)
            )));
        }
        self.file.entry(number).map_err(|e| failed(format!("{}: {e}", self.origin)))
    }
}

#[pymethods]
impl Database {
    /// Reads a file, or the database of the system. Raises `InputError` if it is damaged, or of another robot or other settings.
    #[staticmethod]
    #[pyo3(signature = (system, path = None, manoeuvre = None))]
    fn load(
        py: Python<'_>,
        system: &System,
        path: Option<PathBuf>,
        manoeuvre: Option<&str>,
    ) -> PyResult<Self> {
        let number = system.number(manoeuvre)?;
        match path {
            Some(path) => Self::of(py, system, number, DatabaseFile::open(&path).map_err(input)?),
            None => Self::of_settings(py, system, number)?.ok_or_else(|| {
                let name = &system.config.manoeuvres[number].name;
                input(format!("`{name}` of this system has no database: build one, or name a file"))
            }),
        }
    }

    fn __len__(&self) -> usize {
        self.file.entries()
    }

    /// Name of the manoeuvre.
    #[getter]
    fn manoeuvre(&self) -> String {
        self.config.manoeuvres[self.manoeuvre].name.clone()
    }

    /// Fingerprint of the contents, 16 hexadecimal digits.
    #[getter]
    fn fingerprint(&self) -> String {
        format!("{:016x}", self.file.fingerprint())
    }

    /// Durations of the entries, (entries,), s.
    #[getter]
    fn durations<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        output(py, vec![self.file.entries()], self.file.durations().to_vec())
    }

    /// Start poses q_A of the entries and the values given to their targets, (entries, n_A + given).
    #[getter]
    fn keys<'py>(&self, py: Python<'py>) -> PyResult<Output<'py>> {
        let mut keys: Vec<_> = self.file.keys().keys().collect();
        keys.sort_unstable_by_key(|(number, _)| *number);
        let width = self.file.heading().key;
        output(py, vec![keys.len(), width], keys.into_iter().flat_map(|(_, key)| key.to_vec()).collect())
    }

    fn __getitem__(&self, number: isize) -> PyResult<Trajectory> {
        let number = if number < 0 { number + self.file.entries() as isize } else { number };
        // What is still negative is beyond the last entry.
        Ok(Trajectory::of(
            &self.config,
            self.entry(usize::try_from(number).unwrap_or(usize::MAX))?.trajectory,
        ))
    }

    /// Certificate in the file, as `Trajectory.certificate` computes it.
    fn certificate<'py>(&self, py: Python<'py>, number: usize) -> PyResult<Bound<'py, PyDict>> {
        certificate(py, &self.entry(number)?.certificate)
    }

    /// Numbers and distances of the nearest entries, nearest first.
    #[pyo3(signature = (start, count = 1, *, to = None, pendulum = "rest"))]
    fn nearest(
        &self,
        start: Input<'_>,
        count: usize,
        to: Option<To>,
        pendulum: &str,
    ) -> PyResult<Vec<(usize, f64)>> {
        let system = System { config: self.config.clone() };
        let name = self.config.manoeuvres[self.manoeuvre].name.as_str();
        let Wanted { manoeuvre, given, start } = system.wanted(&start, Some(name), to.as_ref(), pendulum)?;
        let metric = upswing_planner::replan::metric(&self.config, &self.config.manoeuvres[manoeuvre]);
        let near = self.file.keys().nearest(&key(&start, &given), &metric, count);
        Ok(near.into_iter().map(|near| (near.index, near.distance)).collect())
    }

    /// Recomputes all statements of the records, as `upswing db verify`: numbers of poses and their flaws; empty: none.
    #[pyo3(signature = (progress = None))]
    fn verify(&self, py: Python<'_>, progress: Option<Bound<'_, PyAny>>) -> PyResult<Vec<(u64, String)>> {
        let found = interruptible(py, progress.as_ref(), self.file.entries(), |_, done| {
            let count = || {
                done.fetch_add(1, Ordering::Relaxed);
            };
            database::verify(&self.config, self.manoeuvre, &self.file, count)
        })?;
        let found = found.map_err(|e| failed(format!("{}: {e}", self.origin)))?;
        Ok(found.into_iter().map(|found| (found.pose, found.flaw.to_string())).collect())
    }

    fn __repr__(&self) -> String {
        format!("<upswing.Database {}, {} entries>", self.origin, self.file.entries())
    }
}

/// Numbers of a build as a dictionary.
fn summary<'py>(py: Python<'py>, summary: &BuildSummary) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("poses", summary.poses)?;
    dict.set_item("resumed", summary.resumed)?;
    dict.set_item("solved", summary.solved)?;
    dict.set_item("rejected", summary.rejected)?;
    dict.set_item("failed", &summary.failed)?;
    Ok(dict)
}

/// Builds the database of a manoeuvre into a file on all cores, as `upswing db build`, and returns the numbers of poses by outcome.
///
/// `grid`: another grid of start poses, "paper" or a .toml file. `progress(done, total)` is called about every 0.1 s. After Ctrl-C or an
/// exception of `progress` the finished lines stay in a journal, and the same call goes on from there.
#[pyfunction]
#[pyo3(signature = (system, path, manoeuvre = None, *, grid = None, progress = None))]
pub fn build_database<'py>(
    py: Python<'py>,
    system: &System,
    path: PathBuf,
    manoeuvre: Option<&str>,
    grid: Option<PathBuf>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let number = system.number(manoeuvre)?;
    let mut config = (*system.config).clone();
    match grid {
        Some(name) if name == Path::new("paper") && number == 0 => config.use_paper_grid().map_err(input)?,
        Some(path) => config.use_grid(number, &path).map_err(input)?,
        None => {}
    }
    if config.manoeuvres[number].reverses.is_some() {
        let name = &config.manoeuvres[number].name;
        return Err(input(format!(
            "`{name}` runs the entries of another manoeuvre backwards: build that one"
        )));
    }
    let poses = database::poses(&config.manoeuvres[number]);
    let built = interruptible(py, progress.as_ref(), poses, |stop, done| {
        let count = |n| {
            done.fetch_add(n, Ordering::Relaxed);
        };
        database::build(&config, number, Shard::WHOLE, &OutputFile::new(&path), stop, count)
    })?;
    let built = built.map_err(failed)?;
    match built.left {
        0 => summary(py, &built),
        left => {
            Err(PyKeyboardInterrupt::new_err(format!("{left} poses left; the same call goes on from here")))
        }
    }
}
