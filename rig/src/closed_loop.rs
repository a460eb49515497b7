//! Controller and simulated plant in one process: the pure functions of both, cycle by cycle, without shared memory.

use crate::course::{self, Course};
use upswing_config::{Config, Push};
use upswing_ipc::operator::Manoeuvre;
use upswing_ipc::{Mode, PlannerResponse, Telemetry};
use upswing_model::JointVector;
use upswing_ocp::qp::Solver;
use upswing_planner::replan::{Effort, NoPlan, Planner};
use upswing_planner::service::describe;
use upswing_plant::{Plant, SetEventError, StateError};
use upswing_record::evaluation::SwingUpEvaluation;
use upswingd::controller::Controller;
use upswingd::plan::{PlanRefusal, accept};
use upswingd::step::{Output, Request, StepInput};
use upswingd::supervisor::Refusal;
use upswingd::trip::Trip;

/// Cycles without a new measurement after which a run is given up: one second.
const MOST_SILENT: u32 = 8000;

/// Why a swing-up was not run to its end.
#[derive(Debug, thiserror::Error)]
pub enum Aborted {
    /// The plant cannot be where it shall start.
    #[error(transparent)]
    Start(#[from] StateError),
    /// The planner found no plan.
    #[error(transparent)]
    NoPlan(#[from] NoPlan),
    /// The daemon did not accept the plan.
    #[error("the daemon refused the plan: {0}")]
    Plan(#[from] PlanRefusal),
    /// The controller did not obey.
    #[error("{request} was refused: {refusal}")]
    Refused {
        /// What was asked.
        request: &'static str,
        /// Why not.
        refusal: Refusal,
    },
    /// A push that cannot be.
    #[error("push: {0}")]
    Push(#[from] SetEventError),
    /// A fault of the plant keeps all measurements back.
    #[error("no new measurement in {MOST_SILENT} cycles")]
    Silent,
    /// The controller gave up its mode.
    #[error(
        "{mode} tripped {time:.3} s after the plan's start: {trip}; q {:.3?} rad, qd {:.3?} rad/s",
        .record.q, .record.qd
    )]
    Tripped {
        /// The mode before.
        mode: Mode,
        /// Time since the start of the plan, s; 0 before it.
        time: f64,
        /// What was found beyond which limit.
        trip: Trip,
        /// The cycle in which it happened.
        record: Box<Telemetry>,
    },
}

impl Aborted {
    /// The kind of failure, without numbers, to be counted.
    pub fn kind(&self) -> String {
        match self {
            Self::Start(_) => "the plant cannot start there".into(),
            Self::NoPlan(_) => "no plan".into(),
            Self::Plan(_) => "the daemon refused the plan".into(),
            Self::Refused { request, .. } => format!("{request} was refused"),
            Self::Push(_) => "the push cannot be".into(),
            Self::Silent => "no measurements".into(),
            Self::Tripped { mode, trip, .. } => {
                format!("{mode} tripped: {}, joint {}", trip.cause.text(), trip.joint + 1)
            }
        }
    }
}

/// Cycles in a row in which the controller does not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissedCycles {
    /// The first one, counted from the start of the plan.
    pub from: u64,
    /// How many.
    pub cycles: u64,
}

/// What disturbs a swing-up after its plan has started.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Disturbances {
    /// Pushes on the rod, their cycles counted from the start of the plan.
    pub pushes: Vec<Push>,
    /// In the order of time.
    pub missed: Vec<MissedCycles>,
}

/// A controller and a plant that answer each other, as on the clock `lockstep`.
#[derive(Clone, Debug)]
pub struct ClosedLoop {
    /// Of the daemon.
    pub controller: Controller,
    /// Simulated.
    pub plant: Plant,
    /// `seq` of the newest measurement.
    measured: u64,
}

impl ClosedLoop {
    /// Before the first cycle.
    pub fn new(config: &Config, plant: Plant) -> Self {
        Self { controller: Controller::new(config), plant, measured: 0 }
    }

    /// One cycle of the plant: what the controller made of its measurement. Where a fault of the plant shows it nothing
    /// new it makes nothing, as its process does, and the request waits.
    pub fn cycle(&mut self, request: &mut Option<Request>) -> Option<Output> {
        let measurement = self.plant.measure();
        let new = measurement.seq != self.measured;
        self.measured = measurement.seq;
        let output = new.then(|| self.controller.step(StepInput::new(measurement, 0, request.take())));
        self.plant.step(output.as_ref().map(|output| &output.command));
        output
    }
}

/// A swing-up that ends as soon as something is refused or a limit trips.
struct SwingUpRun<'a, D> {
    system: ClosedLoop,
    config: &'a Config,
    planner: &'a Planner,
    solver: &'a mut Solver,
    disturbances: Option<D>,
    /// Missed cycles after the start of the plan.
    missed: Vec<MissedCycles>,
    records: &'a mut Vec<Telemetry>,
    /// Largest true speeds so far while a plan runs, rad/s.
    fastest: JointVector,
}

impl<D> SwingUpRun<'_, D> {
    fn cycle(&mut self, request: Option<Request>) -> Result<(), Aborted> {
        let before = self.system.controller.mode();
        let (name, mut request) = request.map(|request| (request.name(), request)).unzip();
        let output = (0..MOST_SILENT).find_map(|_| self.system.cycle(&mut request)).ok_or(Aborted::Silent)?;
        let record = output.record.telemetry;
        self.records.push(record);
        if matches!(record.mode(), Ok(Mode::Track | Mode::Balance)) {
            self.fastest = self.fastest.sup(&self.system.plant.velocity().abs());
        }
        if let (Some(request), Some(Err(refusal))) = (name, output.answer) {
            return Err(Aborted::Refused { request, refusal });
        }
        match output.record.trip {
            Some(trip) => {
                let start =
                    self.records.iter().find(|r| r.mode() == Ok(Mode::Track)).map_or(record.t_ns, |r| r.t_ns);
                let time = record.t_ns.saturating_sub(start) as f64 * 1e-9;
                Err(Aborted::Tripped { mode: before, time, trip, record: Box::new(record) })
            }
            None => Ok(()),
        }
    }

    fn cycles(&mut self, count: u64) -> Result<(), Aborted> {
        (0..count).try_for_each(|_| self.cycle(None))
    }

    /// `count` cycles, without those that are missed: in them the drives hear nothing.
    fn cycles_without_missed(&mut self, count: u64) -> Result<(), Aborted> {
        let mut passed = 0;
        for miss in std::mem::take(&mut self.missed) {
            self.cycles(miss.from.min(count).saturating_sub(passed))?;
            passed = passed.max(miss.from.min(count));
            let end = miss.from.saturating_add(miss.cycles).min(count);
            while passed < end {
                self.system.plant.step(None);
                passed += 1;
            }
        }
        self.cycles(count - passed)
    }
}

impl<D: FnOnce(f64) -> Disturbances> Course for SwingUpRun<'_, D> {
    type Error = Aborted;

    fn advance(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycles(cycles)
    }

    fn hold(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycle(Some(Request::Enable))?;
        self.cycles(cycles - 1)
    }

    /// Time stands still while the plan is made.
    fn start(&mut self, manoeuvre: Manoeuvre) -> Result<PlannerResponse, Aborted> {
        let start = *self.system.controller.state();
        let settings = &self.config.planner.replan;
        let effort = Effort::iterations(settings.iterations);
        let replan = self.planner.replan_with(self.solver, manoeuvre, &start, &effort)?;
        let plan = accept(&Box::<upswing_ipc::Plan>::from(&replan.plan(self.config)), self.config)?;
        let id = plan.id;
        self.cycle(Some(Request::Load(plan)))?;
        self.cycle(Some(Request::Start(id)))?;
        if let Some(disturbances) = self.disturbances.take() {
            let Disturbances { pushes, missed } = disturbances(replan.trajectory.t_f);
            let now = self.system.plant.seq();
            for push in pushes {
                self.system.plant.push(&Push { from: now + push.from, ..push })?;
            }
            self.missed = missed;
        }
        let time_total_us = replan.statistics.total.as_secs_f64() * 1e6;
        Ok(PlannerResponse { time_total_us, ..describe(&replan, settings) })
    }

    fn watch(&mut self, cycles: u64) -> Result<(), Aborted> {
        self.cycles_without_missed(cycles)
    }
}

/// Takes the course of a swing-up ([`course::swing_up`]) and evaluates it. `config` are the settings of the controller; the plant may
/// be another one. `disturbances` is told the duration t_F of the plan, s. `records` is cleared and then holds every cycle.
///
/// # Errors
/// [`Aborted`] if the run could not be finished; the report says how a finished run ended.
pub fn swing_up(
    planner: &Planner,
    solver: &mut Solver,
    config: &Config,
    plant: Plant,
    seconds: f64,
    disturbances: impl FnOnce(f64) -> Disturbances,
    records: &mut Vec<Telemetry>,
) -> Result<SwingUpEvaluation, Aborted> {
    records.clear();
    let mut run = SwingUpRun {
        system: ClosedLoop::new(config, plant),
        config,
        planner,
        solver,
        disturbances: Some(disturbances),
        missed: Vec::new(),
        records,
        fastest: JointVector::zeros(),
    };
    let period = config.daemon.cycle.period.seconds();
    let response = course::swing_up(&mut run, period, seconds)?;
    Ok(SwingUpEvaluation::new(config, &response, run.records, 0, seconds, Some(&run.fastest)))
}
