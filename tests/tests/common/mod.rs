//! Controller and plant in one process, as on the lockstep clock: deterministic and fast.

use std::sync::LazyLock;
use upswing_config::{Config, Fault};
use upswing_ipc::{Measurement, Mode};
use upswing_model::NU;
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswingd::controller::{Controller, Order};
use upswingd::supervisor::Request;

/// Time in which the arm settles on its hold before the plan is made, cycles.
const SETTLE: u64 = 2_000;

static CONFIG: LazyLock<Config> = LazyLock::new(|| Config::embedded().expect("embedded settings"));
static PLANNER: LazyLock<Planner> =
    LazyLock::new(|| Planner::new(CONFIG.clone()).expect("the embedded database fits the settings"));

/// A plant and the controller that acts on it.
#[derive(Clone)]
pub struct ClosedLoop {
    pub plant: Plant,
    pub controller: Controller,
    config: Config,
    shown: Option<Measurement>,
    /// t_F of the plan that was started, cycles.
    pub plan_cycles: u64,
}

impl ClosedLoop {
    /// Holding, in the start pose of the settings, settled.
    pub fn holding(scenario: Option<&str>) -> Self {
        let mut config = CONFIG.clone();
        if let Some(scenario) = scenario {
            config.use_scenario(scenario).unwrap_or_else(|e| panic!("{e}"));
        }
        let mut this = Self {
            plant: Plant::new(&config).expect("a possible start"),
            controller: Controller::new(&config),
            config,
            shown: None,
            plan_cycles: 0,
        };
        this.run(1);
        this.step(Some(Order::Do(Request::Enable)));
        this.run(SETTLE);
        this
    }

    /// Makes a plan from the present state and starts it; false if that is refused.
    pub fn start(&mut self) -> bool {
        let iterations = self.config.planner.replan.iterations;
        let Ok(replan) = PLANNER.replan(self.controller.state(), iterations, None) else { return false };
        let period = self.config.daemon.cycle.period.as_secs_f64();
        self.plan_cycles = (replan.trajectory.t_f / period).ceil() as u64;
        self.step(Some(Order::Load(Box::new(replan.plan(&self.config)))));
        self.step(Some(Order::Do(Request::Start)));
        self.controller.mode() == Mode::Track
    }

    pub fn run(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.step(None);
        }
    }

    /// One cycle; the controller computes it only if the plant shows it something new.
    ///
    /// # Panics
    /// If a torque is beyond its limit or not a number.
    fn step(&mut self, order: Option<Order>) {
        let measurement = self.plant.measure();
        let new = self.shown.is_none_or(|shown| shown.seq != measurement.seq);
        self.shown = Some(measurement);
        let command = new.then(|| self.controller.step(&measurement, 0, order).command);
        if let Some(command) = &command {
            for i in 0..NU {
                let (tau, max) = (command.tau[i], self.config.robot.limits.tau_max[i]);
                assert!(tau.abs() <= max, "cycle {}: {tau} N m on joint {}", measurement.seq, i + 1);
            }
        }
        self.plant.step(command.as_ref());
    }

    /// Adds a fault from the next cycle on.
    #[allow(dead_code, reason = "not every test file breaks something")]
    pub fn break_now(&mut self, fault: Fault) {
        let fault = Fault { from: self.plant.seq(), ..fault };
        self.plant.set_fault(&fault).unwrap_or_else(|e| panic!("{e}"));
    }

    /// The daemon's mode and whether the brakes hold.
    pub fn outcome(&self) -> (Mode, bool) {
        (self.controller.mode(), self.plant.brakes_closed())
    }
}
