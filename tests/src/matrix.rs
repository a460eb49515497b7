//! The fault matrix: outcome of each fault of the plant in each mode of the daemon, simulated deterministically with controller and
//! plant in one process. The tests read the expected outcomes from `docs/faults.md`.

use clap::Parser;
use std::error::Error;
use std::sync::LazyLock;
use upswing_config::{Config, Fault, FaultKind};
use upswing_ipc::{Mode, PlanMessage};
use upswing_model::{ActuatedVector, JointVector};
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswing_rig::closed_loop::ClosedLoop;
use upswing_rig::fault_args::FaultArgs;
use upswingd::plan::accept;
use upswingd::step::{CycleRecord, StepRequest};
use upswingd::supervisor::is_braked;
use upswingd::trip::Trip;

/// Text of `docs/faults.md`, the page with the tables of expected outcomes.
pub const PAGE: &str = include_str!("../../docs/faults.md");

/// Time in which the arm settles in Hold, or in Balance after the end of a plan, cycles.
const SETTLE: u64 = 2_000;
/// Time in which the brakes close, cycles.
const BRAKING: u64 = 800;
/// Time in Stop before a fault, cycles: the stop has just begun.
const STOPPING: u64 = 80;
/// Largest deviation of an angle from a run without the fault that may go unnoticed, rad.
const ASTRAY: f64 = 0.25;
/// Time for which the system is run after a fault, cycles; one second.
pub const WATCHED: u64 = 8_000;

static CONFIG: LazyLock<Config> = LazyLock::new(|| Config::embedded().expect("embedded settings"));
static PLANNER: LazyLock<Planner> =
    LazyLock::new(|| Planner::new(CONFIG.clone()).expect("the embedded database fits the settings"));

/// A row of a table of [`PAGE`]: a fault, and the outcome in each column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultRow {
    /// The fault: the first cell, without its backquotes.
    pub fault: String,
    /// The outcomes: the other cells.
    pub outcomes: Vec<String>,
}

/// Column names (without the first) and rows of the table below the heading `section` of a page.
///
/// # Panics
/// If the page has no such section, or the section has no table.
pub fn table(page: &str, section: &str) -> (Vec<String>, Vec<FaultRow>) {
    let heading = format!("\n## {section}\n");
    let (_, text) = page.split_once(&heading).unwrap_or_else(|| panic!("no `{section}` in the page"));
    let text = text.split("\n## ").next().unwrap_or("");
    let cells = |line: &str| -> Vec<String> {
        let inner = line.trim().trim_matches('|');
        inner.split('|').map(|cell| cell.trim().trim_matches('`').to_owned()).collect()
    };
    let mut lines = text.lines().filter(|line| line.starts_with('|')).map(cells);
    let columns = lines.next().unwrap_or_else(|| panic!("no table in `{section}`"));
    let rows = lines.skip(1).map(|mut cells| {
        assert_eq!(cells.len(), columns.len(), "cells of the row {cells:?}");
        FaultRow { fault: cells.remove(0), outcomes: cells }
    });
    let rows = rows.collect();
    (columns[1..].to_vec(), rows)
}

/// A row of the table as Markdown, as [`PAGE`] has to contain it.
pub fn line(fault: &str, outcomes: &[String]) -> String {
    format!("| `{fault}` | {} |", outcomes.join(" | "))
}

/// The mode with the name `name`, in any case.
///
/// # Panics
/// If there is no such mode.
pub fn mode(name: &str) -> Mode {
    let found = Mode::ALL.iter().find(|mode| mode.to_string() == name.to_lowercase());
    *found.unwrap_or_else(|| panic!("no mode `{name}`"))
}

/// Parses a fault in the syntax of `upswing disturb fault`, for example `encoder-jump --joint joint_4 --amount 0.1`.
///
/// # Errors
/// Error of the command line or [`FaultError`](upswing_config::FaultError).
pub fn fault(text: &str) -> Result<FaultArgs, Box<dyn Error>> {
    #[derive(Parser)]
    #[command(no_binary_name = true)]
    struct Line {
        #[command(flatten)]
        fault: FaultArgs,
    }
    let line = Line::try_parse_from(text.split_whitespace())?;
    line.fault.fault(&CONFIG.model)?;
    Ok(line.fault)
}

/// Defines one test per mode, so that the tests run in parallel.
#[macro_export]
macro_rules! in_each_mode {
    ($check:ident: $($test:ident $mode:ident),+) => {
        $(
            #[test]
            fn $test() {
                $check(upswing_ipc::Mode::$mode);
            }
        )+
    };
    ($check:ident) => {
        $crate::in_each_mode!(
            $check: in_idle Idle, in_hold Hold, in_track Track, in_balance Balance, in_stop Stop, in_fault Fault
        );
    };
}

/// A test case of the fault matrix: controller and plant in one mode, and their trips since.
#[derive(Clone)]
pub struct FaultCase {
    /// Controller and plant.
    pub system: ClosedLoop,
    /// Records of every cycle since the start; `None`: no recording.
    pub records: Option<Vec<CycleRecord>>,
    /// The plan that was started last.
    pub plan: Option<PlanMessage>,
    /// Settings of the robot and of both.
    pub config: Config,
    /// Duration t_F of the plan, cycles.
    pub plan_cycles: u64,
    /// Mode before the fault, and the true angles after [`WATCHED`] cycles without a fault, rad.
    before: Mode,
    undisturbed: JointVector,
    /// Trips since the fault, each with the mode after the trip.
    given_up: Vec<(Mode, Trip)>,
}

impl FaultCase {
    /// A case in Idle, in the start pose of the settings, under a scenario of the plant if one is given.
    ///
    /// # Panics
    /// If there is no such scenario.
    pub fn idle(scenario: Option<&str>) -> Self {
        Self::idle_at(scenario, None)
    }

    /// A case as [`Self::idle`], with the actuated joints at `pose` (rad or m) if one is given.
    ///
    /// # Panics
    /// If there is no such scenario, or the pendulum has no rest position within its limits in this pose.
    pub fn idle_at(scenario: Option<&str>, pose: Option<ActuatedVector>) -> Self {
        let mut config = CONFIG.clone();
        if let Some(scenario) = scenario {
            config.use_scenario(scenario).unwrap_or_else(|e| panic!("{e}"));
        }
        config.plant.start.q = pose.unwrap_or(config.plant.start.q);
        let plant = Plant::new(&config).expect("a possible start");
        let system = ClosedLoop::new(&config, plant);
        Self {
            undisturbed: *system.plant.position(),
            system,
            records: None,
            plan: None,
            config,
            plan_cycles: 0,
            before: Mode::Idle,
            given_up: Vec::new(),
        }
    }

    /// Brings the case to a mode, ready for a fault: settled in Hold, halfway through a plan in Track, after a quarter of a second in
    /// Balance, just after a stop halfway through a plan, or in Fault with closed brakes after a fault that is over.
    pub fn in_mode(mut self, mode: Mode) -> Self {
        self.run(1);
        if mode != Mode::Idle {
            self.request(StepRequest::Enable);
            self.run(SETTLE);
        }
        if matches!(mode, Mode::Track | Mode::Balance | Mode::Stop) {
            assert!(self.start(), "the plan is accepted");
        }
        match mode {
            Mode::Track | Mode::Stop => self.run(self.plan_cycles / 2),
            Mode::Balance => self.run(self.plan_cycles + SETTLE),
            _ => {}
        }
        match mode {
            Mode::Stop => {
                self.request(StepRequest::Stop);
                self.run(STOPPING);
            }
            Mode::Fault => {
                self.break_now(Fault::new(FaultKind::EncoderNan, 0, 1));
                self.run(BRAKING);
            }
            _ => {}
        }
        assert_eq!(self.system.controller.mode(), mode);
        (self.before, self.given_up) = (mode, Vec::new());
        let mut twin = Self { records: None, ..self.clone() };
        twin.run(WATCHED);
        self.undisturbed = *twin.system.plant.position();
        self
    }

    /// Plans a swing-up from the present state and starts the plan; false if planning, acceptance or start fails.
    pub fn start(&mut self) -> bool {
        let iterations = self.config.planner.replan.iterations;
        let Ok(replan) = PLANNER.replan(self.system.controller.state(), iterations, None) else {
            return false;
        };
        let period = self.config.daemon.cycle.period.seconds();
        self.plan_cycles = (replan.trajectory.t_f / period).ceil() as u64;
        let plan = PlanMessage::new(&replan.plan(&self.config), self.config.model.order());
        let Ok(accepted) = accept(&plan, &self.config) else { return false };
        let id = accepted.id;
        self.plan = Some(plan);
        self.request(StepRequest::Load(accepted));
        self.request(StepRequest::Start(id));
        self.system.controller.mode() == Mode::Track
    }

    /// Runs `cycles` cycles without a request.
    pub fn run(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.cycle(&mut None);
        }
    }

    /// Sends a request to the controller and runs cycles, at most [`WATCHED`], until the controller receives it with a new
    /// measurement.
    pub fn request(&mut self, request: StepRequest) {
        let mut request = Some(request);
        for _ in 0..WATCHED {
            self.cycle(&mut request);
            if request.is_none() {
                return;
            }
        }
    }

    /// Runs one cycle of controller and plant.
    ///
    /// # Panics
    /// If a commanded torque is NaN or beyond its limit, or not 0 while the brakes are commanded closed.
    fn cycle(&mut self, request: &mut Option<StepRequest>) {
        let mode = self.system.controller.mode();
        let Some(output) = self.system.cycle(request) else { return };
        let command = &output.command;
        let torque = command.torque(self.config.model.sizes()).unwrap_or_else(|e| panic!("{e}"));
        for (i, (tau, max)) in torque.iter().zip(self.config.robot.limits.tau_max.iter()).enumerate() {
            let max = if command.brake == 1 { 0.0 } else { *max };
            assert!(tau.abs() <= max, "cycle {}: {tau} N m on joint {}, limit {max}", command.seq, i + 1);
        }
        let now = self.system.controller.mode();
        if let (Some(trip), true) =
            (output.record.trip, now != mode && matches!(now, Mode::Stop | Mode::Fault))
        {
            self.given_up.push((now, trip));
        }
        if let Some(records) = &mut self.records {
            records.push(output.record);
        }
    }

    /// Injects a fault that begins in the next cycle.
    ///
    /// # Panics
    /// If the plant refuses the fault.
    pub fn break_now(&mut self, fault: Fault) {
        let fault = Fault { from: self.system.plant.seq(), ..fault };
        self.system.plant.set_fault(&fault).unwrap_or_else(|e| panic!("{e}"));
    }

    /// The mode of the controller, and true if the brakes of the plant are closed.
    pub fn mode(&self) -> (Mode, bool) {
        (self.system.controller.mode(), self.system.plant.brakes_closed())
    }

    /// Outcome of a fault after [`WATCHED`] cycles, in the terms of [`PAGE`].
    pub fn outcome(&self) -> String {
        let (mode, braked) = self.mode();
        if mode == Mode::Fault && !braked {
            return "Fault with open brakes".into();
        }
        if !self.given_up.is_empty() {
            let text = |(mode, trip): &(Mode, Trip)| match mode {
                Mode::Stop => format!("Stop: {:?}", trip.cause),
                _ => format!("Fault: {:?}", trip.cause),
            };
            return self.given_up.iter().map(text).collect::<Vec<_>>().join(", ");
        }
        let undisturbed = if self.before == Mode::Stop { Mode::Hold } else { self.before };
        match mode {
            _ if braked && !is_braked(mode) => "brakes".into(),
            mode if mode == undisturbed => {
                let astray = (self.system.plant.position() - self.undisturbed).amax() > ASTRAY;
                if astray { "not noticed" } else { "goes on" }.into()
            }
            mode => format!("ends in {mode}"),
        }
    }
}
