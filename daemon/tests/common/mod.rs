//! A simulated arm and plans for tests.
#![allow(dead_code)] // each test file uses its own part

pub mod live;

use upswing_config::Config;
use upswing_ipc::{Clock, Command, Measurement, PlanMessage};
use upswing_model::{ActuatedVector, JointVector, NQ, NU, State, StateParts, Workspace, state};
use upswing_ocp::lqr;
use upswing_planner::offline::lqr_weights;
use upswing_planner::replan::Planner;
use upswing_trajectory::{KNOTS, Plan, Trajectory};

/// T_s, s and ns.
pub const PERIOD: f64 = 125e-6;
pub const PERIOD_NS: u64 = 125_000;

pub fn config() -> Config {
    Config::embedded().unwrap()
}

/// The pose [0, 0, 0, -90, 0, 0, 0] deg with the pendulum hanging at rest.
pub fn rest_pose(config: &Config) -> JointVector {
    let mut q = JointVector::zeros();
    q[3] = -std::f64::consts::FRAC_PI_2;
    config.model.rest_position(&q, &mut Workspace::default()).unwrap()
}

/// x_T (8) with the arm at [0, 0, 0, -90, 0, 0, 0] deg: the pendulum stands.
pub fn upright_pose() -> JointVector {
    let mut q = JointVector::zeros();
    q[3] = -std::f64::consts::FRAC_PI_2;
    q[7] = std::f64::consts::PI;
    q
}

pub fn at_rest(q: &JointVector) -> State {
    state(q, &JointVector::zeros())
}

/// A measurement of a healthy robot on the lockstep clock.
pub fn measurement(seq: u64, q: &JointVector) -> Measurement {
    Measurement {
        seq,
        t_ns: seq.wrapping_mul(PERIOD_NS),
        q: (*q).into(),
        tau_measured: [0.0; NU],
        status: Measurement::DRIVES_READY,
        clock: Clock::Lockstep.code(),
        period_ns: PERIOD_NS,
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
        measurement(self.seq, &self.x.q())
    }

    /// One period under a constant torque, by one Runge-Kutta step of fourth order; with closed brakes none.
    pub fn advance(&mut self, command: &Command) {
        if command.brake == 1 {
            return;
        }
        let mut tau = JointVector::zeros();
        tau.fixed_rows_mut::<NU>(0).copy_from_slice(&command.tau);
        let mut f = |x: &State| {
            let (q, qd) = (x.q(), x.qd());
            state(&qd, &self.config.model.forward_dynamics(&q, &qd, &tau, &mut self.work).unwrap())
        };
        let k1 = f(&self.x);
        let k2 = f(&(self.x + k1 * (0.5 * PERIOD)));
        let k3 = f(&(self.x + k2 * (0.5 * PERIOD)));
        let k4 = f(&(self.x + k3 * PERIOD));
        self.x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (PERIOD / 6.0);
    }
}

/// A sealed plan that stays at `x` for `t_f` s, with gains that stiffen the arm where the rod hangs, and that balance it
/// where it stands.
pub fn rest_payload(config: &Config, x: &State, t_f: f64) -> Box<PlanMessage> {
    let f = config.model.f(x, &nalgebra::SVector::zeros(), &mut Workspace::default());
    let mut payload = PlanMessage::boxed_zeroed();
    (payload.id, payload.fingerprint, payload.t_f) = (7, config.model.fingerprint(), t_f);
    payload.x.fill((*x).into());
    payload.f.fill(f.into());
    for i in 0..NU {
        payload.k_final[i][i] = -100.0;
        payload.k_final[i][NQ + i] = -20.0;
    }
    if x[NQ - 2] > 3.0 {
        let still =
            Trajectory { t_f: 0.01, x: Box::new([*x; KNOTS]), u: Box::new([ActuatedVector::zeros(); KNOTS]) };
        let mut work = Workspace::default();
        let gains =
            lqr::synthesize(&config.model, &still, &lqr_weights(&config.planner), PERIOD, &mut work).unwrap();
        payload.k_final = std::array::from_fn(|i| std::array::from_fn(|j| gains.knots[0][(i, j)]));
    }
    let gain = payload.k_final;
    payload.k.fill(gain);
    payload.seal();
    payload
}

/// A swing-up from hanging at rest, and from its end back to where it began.
pub fn swing(config: &Config, q: &JointVector) -> (Box<Plan>, Box<Plan>) {
    let planner = Planner::new(config.clone()).unwrap();
    let up = planner.replan(&at_rest(q), config.planner.replan.iterations, None).unwrap().plan(config);
    let trajectory = up.trajectory.reversed();
    let mut work = Workspace::default();
    let gains = lqr::synthesize(&config.model, &trajectory, &lqr_weights(&config.planner), PERIOD, &mut work)
        .unwrap();
    let down = Plan {
        id: 8,
        fingerprint: up.fingerprint,
        f: trajectory.f(&config.model, &mut work),
        trajectory,
        gains,
        activation_ns: None,
    };
    // Through shared memory and the checks, as in life.
    let [up, down] =
        [up, down].map(|plan| upswingd::plan::accept(&Box::<PlanMessage>::from(&plan), config).unwrap());
    (up, down)
}

/// [`rest_payload`] as the controller takes it.
pub fn rest_plan(config: &Config, x: &State, t_f: f64) -> Box<Plan> {
    upswingd::plan::accept(&rest_payload(config, x, t_f), config).unwrap()
}
