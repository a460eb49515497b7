//! Controller and simulated plant in one process: the pure functions of both, cycle by cycle, without shared memory.

use crate::swing_up::SETTLE;
use upswing_config::{Config, Push};
use upswing_ipc::{Mode, PlannerResponse, Telemetry};
use upswing_model::JointVector;
use upswing_ocp::qp::Solver;
use upswing_planner::replan::{Effort, Manoeuvre, NoPlan, Planner};
use upswing_planner::service::describe;
use upswing_plant::{Plant, SetEventError, StateError};
use upswing_record::report::Report;
use upswingd::controller::{Controller, Order, Output};
use upswingd::plan::{PlanRefusal, accept};
use upswingd::supervisor::{Refusal, Request};
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
        "{mode} was given up {time:.3} s after the plan's start: {trip}; q {:.3?} rad, qd {:.3?} rad/s",
        .record.q, .record.qd
    )]
    GivenUp {
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
            Self::GivenUp { mode, trip, .. } => {
                format!("{mode} was given up: {}, joint {}", trip.cause.text(), trip.joint + 1)
            }
        }
    }
}

/// Cycles in a row in which the controller does not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Missed {
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
    pub missed: Vec<Missed>,
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
    /// new it makes nothing, as its process does, and the order waits.
    pub fn cycle(&mut self, order: &mut Option<Order>) -> Option<Output> {
        let measurement = self.plant.measure();
        let new = measurement.seq != self.measured;
        self.measured = measurement.seq;
        let output = new.then(|| self.controller.step(&measurement, 0, order.take()));
        self.plant.step(output.as_ref().map(|output| &output.command));
        output
    }
}

/// A run that ends as soon as something is refused or given up.
struct Run<'a> {
    system: ClosedLoop,
    records: &'a mut Vec<Telemetry>,
    /// Largest true speeds so far while a plan runs, rad/s.
    fastest: JointVector,
}

impl Run<'_> {
    fn cycle(&mut self, order: Option<(&'static str, Order)>) -> Result<(), Aborted> {
        let before = self.system.controller.mode();
        let (request, mut order) = order.unzip();
        let output = (0..MOST_SILENT).find_map(|_| self.system.cycle(&mut order)).ok_or(Aborted::Silent)?;
        let record = output.record.telemetry;
        self.records.push(record);
        if matches!(record.mode(), Ok(Mode::Track | Mode::Balance)) {
            self.fastest = self.fastest.sup(&self.system.plant.velocity().abs());
        }
        if let (Some(request), Some(Err(refusal))) = (request, output.answer) {
            return Err(Aborted::Refused { request, refusal });
        }
        match output.record.trip {
            Some(trip) => {
                let start =
                    self.records.iter().find(|r| r.mode() == Ok(Mode::Track)).map_or(record.t_ns, |r| r.t_ns);
                let time = record.t_ns.saturating_sub(start) as f64 * 1e-9;
                Err(Aborted::GivenUp { mode: before, time, trip, record: Box::new(record) })
            }
            None => Ok(()),
        }
    }

    fn cycles(&mut self, count: u64) -> Result<(), Aborted> {
        (0..count).try_for_each(|_| self.cycle(None))
    }

    /// `count` cycles, without those that are missed: in them the drives hear nothing.
    fn cycles_without(&mut self, missed: &[Missed], count: u64) -> Result<(), Aborted> {
        let mut passed = 0;
        for miss in missed {
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

/// Enables the controller, lets the arm settle in Hold, plans from the measured state, swings up and balances for
/// `seconds`: the course of [`crate::swing_up::swing_up`], with time standing still while the plan is made. `config`
/// are the settings of the controller; the plant may be another one. `disturbances` is told the duration t_F of the plan,
/// s. `records` is cleared and then holds every cycle.
///
/// # Errors
/// [`Aborted`] if it could not be run to the end; how it ended, the report says.
pub fn swing_up(
    planner: &Planner,
    solver: &mut Solver,
    config: &Config,
    plant: Plant,
    seconds: f64,
    disturbances: impl FnOnce(f64) -> Disturbances,
    records: &mut Vec<Telemetry>,
) -> Result<Report, Aborted> {
    let period = config.daemon.cycle.period.seconds();
    let cycles = |s: f64| (s / period).ceil() as u64;
    records.clear();
    let mut run = Run { system: ClosedLoop::new(config, plant), records, fastest: JointVector::zeros() };
    // As in a system of processes, where nothing is measured before the first cycle.
    run.cycle(None)?;
    run.cycle(Some(("enable", Order::Do(Request::Enable))))?;
    run.cycles(cycles(SETTLE) - 1)?;
    let start = *run.system.controller.state();
    let replan = planner.replan_with(
        solver,
        Manoeuvre::SwingUp,
        &start,
        &Effort::iterations(config.planner.replan.iterations),
    )?;
    let plan = accept(&Box::<upswing_ipc::Plan>::from(&replan.plan(config)), config)?;
    let id = plan.id;
    run.cycle(Some(("load", Order::Load(plan))))?;
    run.cycle(Some(("start", Order::Do(Request::Start(id)))))?;
    let Disturbances { pushes, missed } = disturbances(replan.trajectory.t_f);
    let now = run.system.plant.seq();
    for push in pushes {
        run.system.plant.push(&Push { from: now + push.from, ..push })?;
    }
    run.cycles_without(&missed, cycles(replan.trajectory.t_f + seconds))?;
    let response = PlannerResponse {
        time_total_us: replan.times.total.as_secs_f64() * 1e6,
        ..describe(&replan, &config.planner.replan)
    };
    Ok(Report::new(config, &response, run.records, 0, seconds, Some(&run.fastest)))
}
