//! Log of the control cycles in the service thread: telemetry to publish, statistics, warnings, flight recorder.

use crate::flight::FlightRecorder;
use crate::histogram::Histogram;
use crate::overrun::{Overrun, ThreadWatch};
use crate::step::CycleRecord;
use crate::supervisor::RequestRefusal;
use crate::trip::{TripCause, warning_texts};
use std::time::{Duration, Instant};
use tracing::{error, info, warn};
use upswing_config::Config;
use upswing_ipc::{
    Clock, ControlResponse, IpcError, Mode, Node, Publisher, Readiness, StepBatch, Telemetry, TelemetryBatch,
    Text,
};

/// Longest time for which telemetry waits for its batch to fill.
const FLUSH: Duration = Duration::from_millis(5);
/// Time span of a flight record, s.
const FLIGHT: f64 = 2.0;
/// Shortest time between two logged overruns; all overruns are counted.
const OVERRUN_LOG: Duration = Duration::from_secs(1);

/// Log of the control cycles since the start of the daemon.
pub struct CycleLog<'a> {
    config: &'a Config,
    /// The newest record; `None` before the first.
    pub newest: Option<CycleRecord>,
    /// Time of the last record with a new measurement.
    pub sign_of_life: Instant,
    telemetry: Publisher<TelemetryBatch>,
    batch: Box<TelemetryBatch>,
    steps: Publisher<StepBatch>,
    step_batch: Box<StepBatch>,
    /// Time of the oldest record in the batches.
    batch_begin: Instant,
    wake: Histogram,
    compute: Histogram,
    /// Warnings since the last [`CycleLog::forget_warnings`], bits as in [`Telemetry`].
    warnings: u64,
    watch: Option<ThreadWatch>,
    overrun: Option<(Overrun, Instant)>,
    recorder: FlightRecorder,
    /// Message to the operator: path of the last flight record, or why it could not be written; empty if there is none.
    flight: String,
}

impl<'a> CycleLog<'a> {
    /// Creates a log without a cycle.
    ///
    /// # Errors
    /// [`IpcError`] if a publisher cannot be created.
    pub fn new(config: &'a Config, node: &Node) -> Result<Self, IpcError> {
        let settings = &config.daemon;
        Ok(Self {
            config,
            newest: None,
            sign_of_life: Instant::now(),
            telemetry: node.publisher()?,
            batch: TelemetryBatch::boxed_zeroed(),
            steps: node.publisher()?,
            step_batch: StepBatch::boxed_zeroed(),
            batch_begin: Instant::now(),
            wake: Histogram::default(),
            compute: Histogram::default(),
            warnings: 0,
            watch: None,
            overrun: None,
            recorder: FlightRecorder::new(settings.cycle.period.cycles_in(FLIGHT) as usize),
            flight: String::new(),
        })
    }

    /// Reads the kernel's counters of the real-time thread `tid` from now on.
    pub fn watch(&mut self, tid: u32) {
        match ThreadWatch::new(tid) {
            Ok(watch) => self.watch = Some(watch),
            Err(e) => warn!("causes of overruns will not be known: no counters of thread {tid}: {e}"),
        }
    }

    /// The mode after the newest cycle.
    pub fn mode(&self) -> Mode {
        self.newest.and_then(|record| record.telemetry.mode().ok()).unwrap_or(Mode::Idle)
    }

    /// Id of the running plan, 0: none.
    pub fn running_plan(&self) -> u64 {
        self.newest.map_or(0, |record| record.telemetry.plan_id)
    }

    /// Clears the warnings.
    pub fn forget_warnings(&mut self) {
        self.warnings = 0;
    }

    /// Publishes telemetry that has waited too long; to be called often. `dropped`: records lost so far.
    ///
    /// # Errors
    /// If telemetry cannot be published.
    pub fn publish_due(&mut self, dropped: u64) -> Result<(), IpcError> {
        if let Some(watch) = &mut self.watch {
            watch.refresh();
        }
        if self.batch_begin.elapsed() >= FLUSH { self.flush(dropped) } else { Ok(()) }
    }

    /// Adds a record to the log. `dropped`: records lost so far.
    ///
    /// # Errors
    /// If telemetry cannot be published.
    pub fn note(&mut self, record: CycleRecord, dropped: u64) -> Result<(), IpcError> {
        let before = self.mode();
        let (last_seq, last_measured) =
            self.newest.map_or((0, 0), |r| (r.telemetry.seq, r.telemetry.measurement_seq));
        self.newest = Some(record);
        let telemetry = &record.telemetry;
        if telemetry.measurement_seq != last_measured {
            self.sign_of_life = Instant::now();
        }
        // Steps between cycles give a record, too, but count as no cycle.
        let is_cycle = telemetry.seq != last_seq;
        if is_cycle {
            self.recorder.push(telemetry);
            self.count(telemetry);
        }
        self.log_mode_change(before, &record);
        if self.step_batch.count == 0 {
            self.batch_begin = Instant::now();
        }
        self.step_batch.push(record.step);
        if is_cycle {
            self.batch.push(*telemetry);
        }
        if self.batch.is_full() || self.step_batch.is_full() { self.flush(dropped) } else { Ok(()) }
    }

    /// Publishes all telemetry that waits. `dropped`: records lost so far.
    ///
    /// # Errors
    /// If telemetry cannot be published.
    pub fn flush(&mut self, dropped: u64) -> Result<(), IpcError> {
        // Steps first: a subscriber that has a cycle then can have the step that computed it.
        let mut sent = Ok(());
        if self.step_batch.count > 0 {
            sent = self.steps.publish(&self.step_batch);
            self.step_batch.clear();
        }
        if self.batch.count > 0 {
            self.batch.dropped = dropped;
            // An error of the steps does not prevent the telemetry from being sent.
            sent = sent.and(self.telemetry.publish(&self.batch));
            self.batch.clear();
        }
        sent
    }

    /// Counts a cycle in the statistics and warnings.
    fn count(&mut self, telemetry: &Telemetry) {
        let compute = telemetry.read_ns + telemetry.compute_ns + telemetry.write_ns;
        let clock = telemetry.clock();
        if clock.is_ok_and(Clock::is_timed) {
            self.compute.add(compute);
        }
        if clock.is_ok_and(Clock::is_real_time) {
            self.wake.add(telemetry.wake_ns);
        }
        if telemetry.flags & Telemetry::OVERRUN != 0 {
            self.log_overrun(telemetry);
        }
        let new = telemetry.warnings & !self.warnings;
        if new != 0 {
            self.warnings |= new;
            warn!("cycle {}: warning level exceeded: {}", telemetry.seq, texts(new));
        }
    }

    /// Logs an overrun with its causes, unless another was logged within [`OVERRUN_LOG`].
    fn log_overrun(&mut self, telemetry: &Telemetry) {
        if self.overrun.as_ref().is_some_and(|(_, seen)| seen.elapsed() < OVERRUN_LOG) {
            return;
        }
        let (around, window) = self.watch.as_mut().map(ThreadWatch::take).unwrap_or_default();
        let overrun = Overrun { telemetry: *telemetry, around, window };
        warn!("{overrun}");
        self.overrun = Some((overrun, Instant::now()));
    }

    /// Logs a change of the mode; saves the flight record at a fault.
    fn log_mode_change(&mut self, before: Mode, record: &CycleRecord) {
        let mode = self.mode();
        if mode == before {
            return;
        }
        let seq = record.telemetry.seq;
        match record.trip {
            Some(trip) if mode == Mode::Fault => {
                error!("cycle {seq}: {before} -> {mode}: {}", trip.text(&self.config.model));
                self.flight = match self.recorder.save(&self.config.daemon.recorder) {
                    Ok(Some(path)) => format!("the cycles before it are in {}", path.display()),
                    Ok(None) => String::new(),
                    Err(e) => {
                        format!("the cycles before it could not be written ({e}): check recorder.directory")
                    }
                };
                if !self.flight.is_empty() {
                    info!("{}", self.flight);
                }
            }
            Some(trip) if mode == Mode::Stop => {
                warn!("cycle {seq}: {before} -> {mode}: {}", trip.text(&self.config.model));
            }
            _ => info!("cycle {seq}: {before} -> {mode}"),
        }
    }

    /// Message about the last Fault or Stop: its trip, and the path of the flight record; empty if there is none.
    pub fn remark(&self) -> String {
        let trip = self.newest.and_then(|record| record.trip);
        let told = trip.map(|trip| format!("tripped: {}", trip.text(&self.config.model)));
        let flight = Some(&self.flight).filter(|text| self.mode() == Mode::Fault && !text.is_empty());
        told.into_iter().chain(flight.cloned()).collect::<Vec<_>>().join("; ")
    }

    /// Next action that is open to the operator.
    pub fn next_action(&self) -> String {
        let remedy = match &self.newest {
            None => Some(TripCause::NoMeasurement.remedy()),
            Some(record) => record.unready.as_ref().and_then(RequestRefusal::remedy),
        };
        let of_mode = || self.mode().next_action(|start| self.config.first_manoeuvre(start)).to_string();
        remedy.map_or_else(of_mode, str::to_owned)
    }

    /// Whether the daemon can be enabled.
    fn readiness(&self) -> Readiness {
        match &self.newest {
            None => Readiness::NoMeasurement,
            Some(record) => record.unready.as_ref().map_or(Readiness::Ready, RequestRefusal::readiness),
        }
    }

    /// Fills the fields of a response that follow from the cycles.
    pub fn respond(&self) -> ControlResponse {
        let record = self.newest;
        let telemetry = record.map(|record| record.telemetry).unwrap_or_default();
        let overrun = self.overrun.as_ref().map(|(overrun, _)| overrun.to_string());
        ControlResponse {
            mode: self.mode().code(),
            readiness: self.readiness().code(),
            fault: telemetry.fault,
            warnings: self.warnings,
            running_plan: self.running_plan(),
            seq: telemetry.seq,
            t_ns: telemetry.t_ns,
            overruns: record.map_or(0, |record| record.overruns),
            wake: self.wake.percentiles(),
            compute: self.compute.percentiles(),
            overrun: Text::new(&overrun.unwrap_or_default()),
            next: Text::new(&self.next_action()),
            ..ControlResponse::default()
        }
    }
}

fn texts(warnings: u64) -> String {
    warning_texts(warnings).collect::<Vec<_>>().join(", ")
}
