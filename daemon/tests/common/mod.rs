//! A simulated arm and plans for tests.
#![allow(dead_code)] // each test file uses its own part

pub mod live;

use std::sync::LazyLock;
use upswing_config::Config;
use upswing_ipc::{Clock, Command, Measurement, PlanMessage};
use upswing_model::{ActuatedVector, JointVector, Model, Sizes, State, UnactuatedVector, Workspace};
use upswing_ocp::lqr::{self, Recursion};
use upswing_planner::offline::lqr_weights;
use upswing_planner::replan::Planner;
use upswing_trajectory::{Gains, Plan, Trajectory};

/// T_s, s and ns.
pub const PERIOD: f64 = 125e-6;
pub const PERIOD_NS: u64 = 125_000;

static CONFIG: LazyLock<Config> = LazyLock::new(|| Config::embedded().unwrap());

pub fn config() -> Config {
    CONFIG.clone()
}

/// Numbers of joints of the robot.
pub fn sizes() -> Sizes {
    CONFIG.model.sizes()
}

/// One value for every joint.
pub fn all(value: f64) -> JointVector {
    JointVector::repeat(sizes(), value)
}

/// A vector that is 1 for one actuated joint.
pub fn unit(joint: usize) -> ActuatedVector {
    ActuatedVector::from_fn(sizes(), |i| f64::from(u8::from(i == joint)))
}

/// The pose [0, 0, 0, -90, 0, 0, 0] deg with the pendulum hanging at rest.
pub fn rest_pose(config: &Config) -> JointVector {
    let mut q = JointVector::zeros(sizes());
    q[3] = -std::f64::consts::FRAC_PI_2;
    config.model.rest_position(&q, &mut Workspace::default()).unwrap()
}

/// x_T (8) with the arm at [0, 0, 0, -90, 0, 0, 0] deg: the pendulum stands.
pub fn upright_pose() -> JointVector {
    let mut q = JointVector::zeros(sizes());
    q[3] = -std::f64::consts::FRAC_PI_2;
    q.unactuated_mut()[0] = std::f64::consts::PI;
    q
}

pub fn at_rest(q: &JointVector) -> State {
    State::new(q, &JointVector::zeros(q.sizes()))
}

/// A measurement of a healthy robot on the lockstep clock.
pub fn measurement(seq: u64, q: &JointVector) -> Measurement {
    measurement_of(&CONFIG.model, seq, q)
}

/// A measurement of a healthy robot of the chain of `model` on the lockstep clock.
pub fn measurement_of(model: &Model, seq: u64, q: &JointVector) -> Measurement {
    Measurement {
        seq,
        t_ns: seq.wrapping_mul(PERIOD_NS),
        status: Measurement::DRIVES_READY,
        clock: Clock::Lockstep.code(),
        period_ns: PERIOD_NS,
        ..Measurement::new(model.order(), q, &ActuatedVector::zeros(q.sizes()))
    }
}

/// The robot without encoder steps, friction or delays.
#[derive(Clone)]
pub struct Arm {
    config: Config,
    work: Workspace,
    pub x: State,
    pub seq: u64,
}

impl Arm {
    pub fn new(config: &Config, x: State) -> Self {
        Self { config: config.clone(), work: Workspace::default(), x, seq: 0 }
    }

    pub fn measure(&mut self) -> Measurement {
        self.seq += 1;
        measurement_of(&self.config.model, self.seq, &self.x.q())
    }

    /// One period under a constant torque, by one Runge-Kutta step of fourth order; with closed brakes none.
    pub fn advance(&mut self, command: &Command) {
        if command.brake == 1 {
            return;
        }
        let tau = command.torque(self.x.sizes()).unwrap();
        let tau = JointVector::joined(&tau, &UnactuatedVector::zeros(tau.sizes()));
        let mut f = |x: &State| {
            let (q, qd) = (x.q(), x.qd());
            State::new(&qd, &self.config.model.forward_dynamics(&q, &qd, &tau, &mut self.work).unwrap())
        };
        let k1 = f(&self.x);
        let k2 = f(&(self.x + k1 * (0.5 * PERIOD)));
        let k3 = f(&(self.x + k2 * (0.5 * PERIOD)));
        let k4 = f(&(self.x + k3 * PERIOD));
        self.x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (PERIOD / 6.0);
    }
}

/// The message of a plan.
pub fn message(plan: &Plan) -> PlanMessage {
    PlanMessage::new(plan, CONFIG.model.order())
}

/// A plan that stays at `x` for `t_f` s, with gains that stiffen the arm where the rod hangs, and that balance it where it
/// stands.
pub fn resting(config: &Config, x: &State, t_f: f64) -> Plan {
    let (sizes, intervals) = (x.sizes(), config.planner.offline.intervals);
    let none = ActuatedVector::zeros(sizes);
    let still = |n: usize| Trajectory { t_f: 0.01, x: vec![*x; n + 1], u: vec![none; n + 1] };
    let mut work = Workspace::default();
    let gain = if x.q_u()[0] > 3.0 {
        let weights = lqr_weights(&config.planner, sizes);
        let gains = lqr::synthesize(
            &config.model,
            &still(intervals),
            &weights,
            PERIOD,
            Recursion::Periods,
            &mut work,
        )
        .unwrap();
        gains.knot(0).as_slice().to_vec()
    } else {
        held(sizes)
    };
    let mut gains = Gains::zeros(sizes, intervals);
    (0..=intervals).for_each(|k| gains.knot_mut(k).copy_from_slice(&gain));
    gains.end_mut().copy_from_slice(&gain);
    Plan {
        id: 7,
        fingerprint: config.model.fingerprint(),
        activation_ns: None,
        replaces: None,
        trajectory: Trajectory { t_f, ..still(intervals) },
        f: vec![config.model.f(x, &none, &mut work); intervals + 1],
        gains,
    }
}

/// A gain that stiffens the arm and leaves the pendulum to itself, by rows.
pub fn held(sizes: Sizes) -> Vec<f64> {
    let row = |i: usize| {
        let mut row = State::zeros(sizes);
        (row.q_a_mut()[i], row.qd_a_mut()[i]) = (-100.0, -20.0);
        row.to_vec()
    };
    (0..sizes.actuated()).flat_map(row).collect()
}

/// A swing-up from hanging at rest, and from its end back to where it began.
pub fn swing(config: &Config, q: &JointVector) -> (Box<Plan>, Box<Plan>) {
    let planner = Planner::new(config.clone()).unwrap();
    let up = planner.replan(&at_rest(q), config.planner.replan.iterations, None).unwrap().plan(config);
    let trajectory = up.trajectory.reversed();
    let mut work = Workspace::default();
    let weights = lqr_weights(&config.planner, q.sizes());
    let gains =
        lqr::synthesize(&config.model, &trajectory, &weights, PERIOD, Recursion::Periods, &mut work).unwrap();
    let down = Plan {
        id: 8,
        fingerprint: up.fingerprint,
        f: trajectory.f(&config.model),
        trajectory,
        gains,
        activation_ns: None,
        replaces: None,
    };
    // Through the message and the checks, as in life.
    let [up, down] = [up, down].map(|plan| upswingd::plan::accept(&message(&plan), config).unwrap());
    (up, down)
}

/// [`resting`] as the controller takes it.
pub fn rest_plan(config: &Config, x: &State, t_f: f64) -> Box<Plan> {
    upswingd::plan::accept(&message(&resting(config, x, t_f)), config).unwrap()
}
