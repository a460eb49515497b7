//! Controllers of the benchmark: measured states in, torques out, every [`DT`]. [`Pilot`] is the daemon with one plan; [`Replanner`] is its law with
//! a new plan whenever it has lost its reference.
//!
//! The daemon of the pilot keeps its own control period. In each step it runs ahead on the model from the measured state on, cycle by cycle, and reads the
//! angles of the model as those of its encoders; the mean of its torques is the torque of the step.

use super::machine::{DT, Joints, State as MachineState};
use std::f64::consts::{PI, TAU};
use std::time::Instant;
use upswing_config::Config;
use upswing_ipc::{Clock, Measurement, Mode, PlanMessage};
use upswing_model::{JointVector, State, Workspace, runge_kutta_step};
use upswing_planner::replan::Planner;
use upswing_trajectory::Plan;
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

/// The control law of the daemon, (22) and (24), on measured states, with a new plan from where the machine is whenever it has lost its reference.
///
/// A plan begins [`Self::LEAD`] after the measurement it is made for, in the state that the machine falls to without torque until then.
pub struct Replanner<'a> {
    planner: &'a Planner,
    work: Workspace,
    /// The plan, and the steps since its begin; negative before.
    plan: Option<(Plan, i64)>,
    /// Longest time that a plan took, s.
    pub slowest: f64,
}

impl<'a> Replanner<'a> {
    /// Time for a plan, s.
    pub const LEAD: f64 = 0.1;
    /// Distance from the reference at which it is lost, rad; velocities count a fifth.
    const LOST: f64 = 1.0;

    /// Without a plan.
    pub fn new(planner: &'a Planner) -> Self {
        Self { planner, work: Workspace::default(), plan: None, slowest: 0.0 }
    }

    /// Takes the measured state and returns the commanded torques, N m.
    pub fn step(&mut self, [q1, q2, v1, v2]: &MachineState) -> Joints {
        let config = self.planner.config();
        let order = config.model.order();
        let sorted = |chain: [f64; 2]| JointVector::from_fn(order.sizes(), |c| chain[order.joint(c)]);
        // The pose of the hanging machine is 0 after any number of turns.
        let within = |q: f64| (q + PI).rem_euclid(TAU) - PI;
        let mut x = State::new(&sorted([within(*q1), within(*q2)]), &sorted([*v1, *v2]));
        if let Some((plan, steps)) = &mut self.plan {
            *steps += 1;
            if *steps < 0 {
                return [0.0; 2];
            }
            let reference = plan.reference(*steps as f64 * DT);
            for i in 0..order.sizes().joints() {
                // The same turn as that of the reference.
                x[i] = reference.x[i] + within(x[i] - reference.x[i]);
            }
            let away = x - reference.x;
            let lost = away.q().amax().max(0.2 * away.qd().amax()) > Self::LOST;
            if !lost {
                let tau = config.model.torque(&x, &reference.input(&x), &mut self.work);
                let mut torques = [0.0; 2];
                torques[order.joint(0)] = tau[0];
                return torques;
            }
        }
        let start = self.fall(&x);
        let begin = Instant::now();
        let effort = config.planner.replan.iterations;
        self.plan = self.planner.replan(&start, effort, None).ok().map(|replan| {
            let steps = -(Self::LEAD / DT).round() as i64;
            (replan.plan(config), steps)
        });
        self.slowest = self.slowest.max(begin.elapsed().as_secs_f64());
        [0.0; 2]
    }

    /// The state to which the machine falls from `x` without torque during [`Self::LEAD`].
    fn fall(&mut self, x: &State) -> State {
        let model = &self.planner.config().model;
        let none = JointVector::zeros(x.sizes());
        let mut rate = |x: &State| {
            let qdd = model.forward_dynamics(&x.q(), &x.qd(), &none, &mut self.work).ok_or(())?;
            Ok::<_, ()>(State::new(&x.qd(), &qdd))
        };
        (0..(Self::LEAD / DT).round() as usize)
            .fold(*x, |x, _| runge_kutta_step(&x, DT, &mut rate).unwrap_or(x))
    }
}
