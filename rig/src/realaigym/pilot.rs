//! The daemon as a controller of the benchmark: measured states in, torques out, every [`DT`].
//!
//! The daemon keeps its own control period. In each step it runs ahead on the model from the measured state on, cycle by cycle, and reads the
//! angles of the model as those of its encoders; the mean of its torques is the torque of the step.

use super::machine::{DT, Joints, State as MachineState};
use upswing_config::Config;
use upswing_ipc::{Clock, Measurement, Mode, PlanMessage};
use upswing_model::{JointVector, State, Workspace, runge_kutta_step};
use upswing_planner::replan::Planner;
use upswingd::controller::Controller;
use upswingd::plan::accept;
use upswingd::step::{StepInput, StepRequest};

/// The daemon with the plan of a swing-up, which starts at the first measurement.
#[derive(Clone)]
pub struct Pilot<'a> {
    config: &'a Config,
    work: Workspace,
    controller: Controller,
    /// Number of the last measurement.
    seq: u64,
    /// Torques of the last command, N m, shoulder and elbow.
    tau: Joints,
    braked: bool,
    /// Request of the next cycle.
    request: Option<StepRequest>,
}

impl<'a> Pilot<'a> {
    /// A daemon that holds the hanging machine, which needs no torque, and has loaded the plan.
    pub fn new(planner: &'a Planner) -> Result<Self, String> {
        let config = planner.config();
        let hanging = State::zeros(config.model.sizes());
        let replan = planner.replan(&hanging, config.planner.replan.iterations, None);
        let plan = replan.map_err(|e| e.to_string())?.plan(config);
        let plan =
            accept(&PlanMessage::new(&plan, config.model.order()), config).map_err(|e| e.to_string())?;
        let start = StepRequest::Start(plan.id);
        let (controller, work) = (Controller::new(config), Workspace::default());
        let mut pilot = Self { config, work, controller, seq: 0, tau: [0.0; 2], braked: true, request: None };
        for request in [None, Some(StepRequest::Enable), Some(StepRequest::Load(plan))] {
            pilot.request = request;
            pilot.cycle(&hanging.q());
        }
        pilot.request = Some(start);
        match pilot.controller.mode() {
            Mode::Hold if pilot.tau == [0.0; 2] => Ok(pilot),
            mode => Err(format!("expected a daemon in Hold without torque, got {mode}, {:?} N m", pilot.tau)),
        }
    }

    /// Takes the measured state and returns the commanded torques, N m.
    pub fn step(&mut self, [q1, q2, v1, v2]: &MachineState) -> Joints {
        let cycles = self.config.daemon.cycle.period.nearest_cycles(DT);
        let mut x = State::new(&self.sorted(&[*q1, *q2]), &self.sorted(&[*v1, *v2]));
        let mut sum = [0.0; 2];
        for _ in 0..cycles {
            self.cycle(&x.q());
            sum = [0, 1].map(|i| sum[i] + self.tau[i]);
            x = self.next(&x);
        }
        sum.map(|sum| sum / cycles as f64)
    }

    /// The state one cycle of the daemon after `x` under the torques of its last command.
    fn next(&mut self, x: &State) -> State {
        let (model, load) = (&self.config.model, self.sorted(&self.tau));
        let rate = |x: &State| {
            let qdd = model.forward_dynamics(&x.q(), &x.qd(), &load, &mut self.work).ok_or(())?;
            Ok::<_, ()>(State::new(&x.qd(), &qdd))
        };
        runge_kutta_step(x, self.config.daemon.cycle.period.seconds(), rate).unwrap_or(*x)
    }

    fn sorted(&self, chain: &Joints) -> JointVector {
        let order = self.config.model.order();
        JointVector::from_fn(order.sizes(), |c| chain[order.joint(c)])
    }

    /// One cycle of the daemon at the angles `q`.
    fn cycle(&mut self, q: &JointVector) {
        self.seq += 1;
        let (order, period) = (self.config.model.order(), self.config.daemon.cycle.period);
        let braked = if self.braked { Measurement::BRAKES_CLOSED } else { 0 };
        let measurement = Measurement {
            seq: self.seq,
            t_ns: period.nanos_of(self.seq),
            status: Measurement::DRIVES_READY | braked,
            clock: Clock::Lockstep.code(),
            period_ns: period.nanos(),
            ..Measurement::new(order, q, &self.sorted(&self.tau).actuated())
        };
        let output = self.controller.step(StepInput::new(measurement, 0, self.request.take()));
        // The daemon sends no command that is not finite.
        let torque = output.command.torque(order.sizes()).map_or(0.0, |torque| torque[0]);
        self.tau[order.joint(0)] = torque;
        self.braked = output.command.brake != 0;
    }
}
