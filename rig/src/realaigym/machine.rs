//! The double pendulum of the benchmark and its simulation, from the equations and parameters that the benchmark publishes (the module above
//! names the source). Independent of `model/` and `plant-sim/`.

use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Time between two control steps, over which the torque is constant, s.
pub const DT: f64 = 0.002;
/// Ratio of the motors' gears.
const GEAR: f64 = 6.0;
/// g, m/s^2.
const GRAVITY: f64 = 9.81;
/// Height of the tip above the shoulder from which on the pendulum counts as upright, as a share of its length.
const UPRIGHT: f64 = 0.9;
/// Design C.1, model 1.0: the machine of version 2, and of the systems `acrobot` and `pendubot`.
pub const C1: Parameters = Parameters {
    m: [0.5234602302310271, 0.6255677234174437],
    l: [0.2, 0.3],
    r: [0.2, 0.25569305436052964],
    i: [0.031887199591513114, 0.05086984812807257],
    ..FRICTIONLESS
};
/// Design C.0, model 3.0: the acrobot of version 1.
pub const C0: Parameters = Parameters {
    m: [0.6416937799349799, 0.563935954099688],
    l: [0.2, 0.3],
    r: [0.2, 0.3212669909674605],
    i: [0.02671076499939512, 0.053878129629650884],
    ..FRICTIONLESS
};
/// Design A.0, model 2.0: the pendubot of version 1.
pub const A0: Parameters = Parameters {
    m: [0.5593806151425046, 0.6043459469186889],
    l: [0.3, 0.2],
    r: [0.3, 0.18377686083653508],
    i: [0.053470810264216295, 0.02392374528789766],
    ..FRICTIONLESS
};
/// No friction and no motor inertia, as in all leaderboards.
const FRICTIONLESS: Parameters =
    Parameters { m: [0.0; 2], l: [0.0; 2], r: [0.0; 2], i: [0.0; 2], b: [0.0; 2], cf: [0.0; 2], ir: 0.0 };

/// A quantity of each joint, shoulder and elbow.
pub type Joints = [f64; 2];
/// Angles of shoulder and elbow, rad, then their velocities, rad/s. Both links hang at 0; the elbow is relative to the upper link.
pub type State = [f64; 4];

/// Parameters of the machine, of the upper and of the lower link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Masses, kg.
    pub m: Joints,
    /// Lengths, m.
    pub l: Joints,
    /// Distances of the centres of mass from the joints, m.
    pub r: Joints,
    /// Moments of inertia about the joints, kg m^2.
    pub i: Joints,
    /// Viscous friction, N m s/rad.
    pub b: Joints,
    /// Coulomb friction, N m: the torque is cf atan(100 qd).
    pub cf: Joints,
    /// Inertia of a motor before its gear, kg m^2.
    pub ir: f64,
}

impl Parameters {
    /// Accelerations of both joints, rad/s^2, under the torques `tau`, N m.
    pub fn acceleration(&self, [q1, q2, v1, v2]: &State, tau: &Joints) -> Joints {
        let Self { m, l, r, i, b, cf, ir } = self;
        let coupling = m[1] * l[0] * r[1];
        let m11 = i[0] + i[1] + m[1] * l[0] * l[0] + 2.0 * coupling * q2.cos() + (GEAR * GEAR + 1.0) * ir;
        let m12 = i[1] + coupling * q2.cos() - GEAR * ir;
        let m22 = i[1] + GEAR * GEAR * ir;
        let gravity = self.gravity(&[*q1, *q2, *v1, *v2]);
        let coriolis = [-coupling * q2.sin() * (2.0 * v1 * v2 + v2 * v2), coupling * q2.sin() * v1 * v1];
        let load: Joints = std::array::from_fn(|k| {
            let v = [*v1, *v2][k];
            tau[k] - gravity[k] - coriolis[k] - b[k] * v - cf[k] * (100.0 * v).atan()
        });
        let determinant = m11 * m22 - m12 * m12;
        [(m22 * load[0] - m12 * load[1]) / determinant, (m11 * load[1] - m12 * load[0]) / determinant]
    }

    /// Torques that carry the weight of the links, N m.
    pub fn gravity(&self, [q1, q2, ..]: &State) -> Joints {
        let Self { m, l, r, .. } = self;
        let lower = m[1] * r[1] * (q1 + q2).sin();
        [GRAVITY * (m[0] * r[0] * q1.sin() + m[1] * l[0] * q1.sin() + lower), GRAVITY * lower]
    }

    /// Whether the tip is above the line that counts as upright.
    pub fn upright(&self, x: &State) -> bool {
        let [upper, lower] = self.l;
        -upper * x[0].cos() - lower * (x[0] + x[1]).cos() > UPRIGHT * (upper + lower)
    }

    /// The description of the machine for the planner and the daemon, with the names and limits of the systems' own.
    pub fn urdf(&self, limits: &Joints) -> String {
        /// Mass that the description counts to the lower link, kg. It is on the axis of the elbow, so that the motion is the same. Without it
        /// the lower link of [`C0`] would be no body: its I2 is less than m2 r2^2.
        const AT_ELBOW: f64 = 0.15;
        let masses = [self.m[0] - AT_ELBOW, self.m[1] + AT_ELBOW];
        let moments = [self.m[0] * self.r[0] - AT_ELBOW * self.l[0], self.m[1] * self.r[1]];
        let inertias = [self.i[0] - AT_ELBOW * self.l[0].powi(2), self.i[1]];
        let link = |i: usize, name: &str| {
            let (m, r) = (masses[i], moments[i] / masses[i]);
            let about_centre = inertias[i] - m * r * r;
            format!(
                "<link name=\"{name}\"><inertial><origin xyz=\"0 0 {}\"/><mass value=\"{m}\"/>\
                 <inertia ixx=\"{about_centre}\" ixy=\"0\" ixz=\"0\" iyy=\"{about_centre}\" iyz=\"0\" izz=\"0.0005\"/>\
                 </inertial></link>",
                -r
            )
        };
        let joint = |i: usize, name: &str, parent: &str, child: &str, z: f64| {
            let (kind, range) = if limits[i] > 0.0 {
                ("revolute", format!("lower=\"{}\" upper=\"{TAU}\" ", -TAU))
            } else {
                ("continuous", String::new())
            };
            format!(
                "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
                 <origin xyz=\"0 0 {z}\"/><axis xyz=\"0 -1 0\"/><limit {range}velocity=\"20\" effort=\"{}\"/></joint>",
                limits[i]
            )
        };
        format!(
            "<robot name=\"double_pendulum\"><link name=\"bench\"/>{}{}{}{}</robot>",
            joint(0, "shoulder", "bench", "upper_link", 0.0),
            link(0, "upper_link"),
            joint(1, "elbow", "upper_link", "lower_link", -self.l[0]),
            link(1, "lower_link"),
        )
    }

    /// The state after [`DT`] under constant torques: one step of the classical Runge-Kutta method.
    fn next(&self, x: &State, tau: &Joints) -> State {
        let rate = |x: &State| {
            let a = self.acceleration(x, tau);
            [x[2], x[3], a[0], a[1]]
        };
        let along = |k: &State, h: f64| std::array::from_fn(|i| x[i] + h * k[i]);
        let k1 = rate(x);
        let k2 = rate(&along(&k1, 0.5 * DT));
        let k3 = rate(&along(&k2, 0.5 * DT));
        let k4 = rate(&along(&k3, DT));
        std::array::from_fn(|i| x[i] + DT * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) / 6.0)
    }
}

/// Differences of a simulation from the undisturbed one.
#[derive(Clone, Debug)]
pub struct Condition {
    /// Parameters of the machine.
    pub parameters: Parameters,
    /// Standard deviation of the noise of the measured velocities, rad/s.
    pub velocity_noise: f64,
    /// Standard deviation of the noise of the torque, N m.
    pub torque_noise: f64,
    /// Share k of its error that the torque makes good per step: tau = tau_last + k (commanded - tau_last).
    pub response: f64,
    /// Delay of the measurement, steps.
    pub delay: usize,
    /// Torques that are added behind the limits in each step, N m; none from its end on.
    pub perturbation: Vec<Joints>,
}

impl Condition {
    /// No difference.
    pub const fn nominal(parameters: Parameters) -> Self {
        Self {
            parameters,
            velocity_noise: 0.0,
            torque_noise: 0.0,
            response: 1.0,
            delay: 0,
            perturbation: Vec::new(),
        }
    }
}

/// A simulated machine. Its random numbers come from `uniform`, in [0, 1).
pub struct Machine<R> {
    condition: Condition,
    /// Largest torques of the motors, N m.
    limits: Joints,
    x: State,
    /// The states that a measurement may show, newest last.
    recent: VecDeque<State>,
    /// Torques of the last step, N m.
    tau: Joints,
    step: usize,
    uniform: R,
}

impl<R: Iterator<Item = f64>> Machine<R> {
    /// A machine whose links hang at rest, before its first step.
    pub fn new(condition: Condition, limits: Joints, uniform: R) -> Self {
        let x = State::default();
        Self { condition, limits, x, recent: VecDeque::from([x]), tau: [0.0; 2], step: 0, uniform }
    }

    /// The true state.
    pub fn state(&self) -> &State {
        &self.x
    }

    /// The measured state: delayed, velocities with noise.
    pub fn measure(&mut self) -> State {
        let mut x = self.recent[0];
        if self.condition.velocity_noise > 0.0 {
            x[2..].iter_mut().for_each(|v| *v += self.condition.velocity_noise * self.normal());
        }
        x
    }

    /// Advances by [`DT`] under the commanded torques, and returns the torques that acted, N m.
    pub fn step(&mut self, commanded: &Joints) -> Joints {
        let Condition { response, torque_noise, .. } = self.condition;
        let push = self.condition.perturbation.get(self.step).copied().unwrap_or_default();
        let tau = [0, 1].map(|i| {
            let limit = self.limits[i];
            let mut tau = self.tau[i] + response * (commanded[i] - self.tau[i]);
            if torque_noise > 0.0 && limit > 0.0 {
                tau += torque_noise * self.normal();
            }
            tau.clamp(-limit, limit) + push[i]
        });
        // A joint without a motor has no input, also none for a push.
        let input = [0, 1].map(|i| if self.limits[i] > 0.0 { tau[i] } else { 0.0 });
        self.x = self.condition.parameters.next(&self.x, &input);
        self.tau = tau;
        self.step += 1;
        self.recent.push_back(self.x);
        if self.recent.len() > self.condition.delay + 1 {
            self.recent.pop_front();
        }
        tau
    }

    /// A sample of the standard normal distribution, by the Box-Muller transform.
    fn normal(&mut self) -> f64 {
        let mut uniform = || 1.0 - self.uniform.next().unwrap_or_default();
        (-2.0 * uniform().ln()).sqrt() * (TAU * uniform()).cos()
    }
}
