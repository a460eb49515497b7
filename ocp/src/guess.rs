//! Initial guesses for the nonlinear program that fit any chain: the unactuated joints swing with growing amplitude to the target, in time
//! with their natural frequency at rest; the actuated joints move to theirs along a line, with a wave on it or without.

use crate::kkt::nearest_state;
use crate::problem::Problem;
use std::f64::consts::PI;
use upswing_model::{ActuatedVector, JointVector, Linearization, State, Workspace};
use upswing_trajectory::Trajectory;

/// The shape of a guess.
#[derive(Clone, Copy, Debug)]
pub struct Swing {
    /// Number of half swings on the way; 0 is a line, between whole numbers the swings begin with a shorter one.
    pub half_swings: f64,
    /// t_F, s
    pub duration: f64,
    /// Amplitudes of waves on the positions, rad or m.
    pub waves: JointVector,
    /// Number of half waves in the duration, joint by joint.
    pub half_waves: JointVector,
}

impl Swing {
    /// A swing without waves.
    pub fn plain(problem: &Problem<'_>, half_swings: f64, duration: f64) -> Self {
        let none = JointVector::zeros(problem.sizes());
        Self { half_swings, duration, waves: none, half_waves: none }
    }
}

/// A function of the share s of the duration, and its first and second derivative.
#[derive(Clone, Copy)]
struct Curve(f64, f64, f64);

impl Curve {
    /// From 0 to 1, beginning and ending at rest.
    fn way(s: f64) -> Self {
        let (sin, cos) = libm::sincos(PI * s);
        Self(0.5 * (1.0 - cos), 0.5 * PI * sin, 0.5 * PI * PI * cos)
    }

    /// This curve times `half_swings` half periods of a cosine that end with 1.
    fn swinging(self, half_swings: f64, s: f64) -> Self {
        let w = PI * half_swings;
        let (sin, cos) = libm::sincos(w * (1.0 - s));
        let Self(c, dc, ddc) = self;
        Self(c * cos, dc * cos + c * w * sin, ddc * cos + 2.0 * dc * w * sin - c * w * w * cos)
    }

    /// A sine of `half_waves` half periods.
    fn wave(half_waves: f64, s: f64) -> Self {
        let w = PI * half_waves;
        let (sin, cos) = libm::sincos(w * s);
        Self(sin, w * cos, -w * w * sin)
    }
}

impl Problem<'_> {
    /// From the start to the nearest point of the target as the `swing` says; velocities and inputs belong to the positions.
    pub fn swing(&self, swing: &Swing) -> Trajectory {
        let Swing { half_swings, duration, waves, half_waves } = swing;
        let (n, sizes, t_f) = (self.intervals, self.sizes(), *duration);
        let way = nearest_state(&self.target, &self.start).q() - self.start.q();
        let mut x = Vec::with_capacity(n + 1);
        let mut u = Vec::with_capacity(n + 1);
        for k in 0..=n {
            let s = k as f64 / n as f64;
            let (mut q, mut qd) = (self.start.q(), JointVector::zeros(sizes));
            let mut qdd = ActuatedVector::zeros(sizes);
            for i in 0..sizes.joints() {
                let line = Curve::way(s);
                let way_curve = if i < sizes.actuated() { line } else { line.swinging(*half_swings, s) };
                let wave = Curve::wave(half_waves[i], s);
                q[i] += way[i] * way_curve.0 + waves[i] * wave.0;
                qd[i] = (way[i] * way_curve.1 + waves[i] * wave.1) / t_f;
                if let Some(qdd) = qdd.get_mut(i) {
                    *qdd = (way[i] * way_curve.2 + waves[i] * wave.2) / (t_f * t_f);
                }
            }
            x.push(if k == 0 { self.start } else { State::new(&q, &qd) });
            u.push(qdd);
        }
        Trajectory { t_f, x, u }
    }

    /// Half a period of the slowest oscillation of the unactuated joints about the rest position next to the start, while the actuated
    /// joints do not move, s; 1 s where nothing pulls them back.
    pub fn half_period(&self) -> f64 {
        let (model, sizes, mut work) = (self.model, self.sizes(), Workspace::default());
        let q = model.rest_position(&self.start.q(), &mut work).unwrap_or_else(|_| self.start.q());
        let at_rest = State::new(&q, &JointVector::zeros(sizes));
        let mut derivatives = Linearization::new(sizes);
        model.linearize(&at_rest, &ActuatedVector::zeros(sizes), &mut work, &mut derivatives);
        let (a, u) = (sizes.actuated(), sizes.unactuated());
        // M_UU^-1 dg_U/dq_U
        let stiffness = nalgebra::DMatrix::from_fn(u, u, |i, j| -derivatives.qdd_u(i)[a + j]);
        let squares = stiffness.complex_eigenvalues();
        let slowest = squares.iter().map(|square| square.re.abs()).fold(f64::INFINITY, f64::min);
        let half_period = PI / slowest.sqrt();
        if half_period.is_finite() { half_period } else { 1.0 }
    }
}
