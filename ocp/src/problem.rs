//! The swing-up as an optimisation problem: (6), (8) with the torque constraint (9) or (11).

use crate::kkt::{TargetRow, nearest_state};
use upswing_model::{ActuatedVector, Limits, Model, Sizes, State};
use upswing_trajectory::Trajectory;

/// The form of the motor torque that is kept within its limits, with what its bounds need.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is one of a problem")]
pub enum TorqueConstraint {
    /// (9): the torque itself.
    Exact,
    /// (11), the paper's: the torque without its Coriolis part, within bounds tightened by the bound c of that
    /// part.
    WithoutCoriolis {
        /// Smallest C~ qd of each motor.
        lower: ActuatedVector,
        /// Largest C~ qd of each motor.
        upper: ActuatedVector,
    },
}

impl TorqueConstraint {
    /// Bounds (lower, upper) of the constrained torque, N m or N.
    pub fn bounds(&self, tau_max: &ActuatedVector) -> (ActuatedVector, ActuatedVector) {
        match self {
            Self::Exact => (-tau_max, *tau_max),
            Self::WithoutCoriolis { lower, upper } => (-tau_max - lower, tau_max - upper),
        }
    }
}

/// One trajectory to optimise.
#[derive(Clone, Debug)]
pub struct Problem<'a> {
    /// The robot.
    pub model: &'a Model,
    /// Limits to keep (with the fractions of the settings applied).
    pub limits: Limits,
    /// N, the number of collocation intervals of a trajectory.
    pub intervals: usize,
    /// By how much the bounds of x_k are narrower than `limits` on both sides, rad or m, and per second; empty: nowhere.
    pub narrower: Vec<State>,
    /// Torque constraint.
    pub torque: TorqueConstraint,
    /// r of R = r I in (6a), s^4/rad^2.
    pub input_weight: f64,
    /// Bounds of t_F, s.
    pub t_f: (f64, f64),
    /// x_S
    pub start: State,
    /// The rows of (8).
    pub target: Vec<TargetRow>,
}

/// x_T of (8) for an arm with a spherical pendulum: q1 = q3 = q5 = q7 = 0, q9 = 0, the given q8 and pitch q2 - q4 + q6 (rad), at rest;
/// q2, q4, q6 are free but for the pitch. Of another chain, the joints that it has.
pub fn upright_target(sizes: Sizes, pitch: f64, q8: f64) -> Vec<TargetRow> {
    /// Joints that pitch the flange, with their signs.
    const PITCH: [(usize, f64); 3] = [(1, 1.0), (3, -1.0), (5, 1.0)];
    let (joints, actuated) = (sizes.joints(), sizes.actuated());
    let free = |i: &usize| *i < actuated && PITCH.iter().any(|(joint, _)| joint == i);
    let value = |i| if i == actuated { q8 } else { 0.0 };
    let mut rows: Vec<_> =
        (0..joints).filter(|i| !free(i)).map(|i| TargetRow::unit(sizes, i, value(i))).collect();
    let mut coefficients = State::zeros(sizes);
    for (joint, sign) in PITCH.into_iter().filter(|(joint, _)| *joint < actuated) {
        coefficients[joint] = sign;
    }
    if coefficients.amax() > 0.0 {
        rows.push(TargetRow { coefficients, value: pitch });
    }
    rows.extend((joints..sizes.state()).map(|i| TargetRow::unit(sizes, i, 0.0)));
    rows
}

impl Problem<'_> {
    /// Numbers of joints of the robot.
    pub fn sizes(&self) -> Sizes {
        self.model.sizes()
    }

    /// Lowest and highest state within the limits.
    fn range(&self) -> (State, State) {
        let l = &self.limits;
        (State::new(&l.q_min, &-l.qd_max), State::new(&l.q_max, &l.qd_max))
    }

    /// The bounds of x_k.
    pub fn bounds(&self, k: usize) -> (State, State) {
        let (lowest, highest) = self.range();
        match self.narrower.get(k) {
            Some(by) => (lowest + by, highest - by),
            None => (lowest, highest),
        }
    }

    /// Narrows the bounds at the knots between which `trajectory` exceeds a limit: the trapezoidal rule knows the knots only.
    /// Whether it exceeds any.
    pub fn narrow(&mut self, trajectory: &Trajectory) -> bool {
        /// By how much, in units of the excess: the motion changes with its bounds, and a part of the excess comes back.
        const EXTRA: f64 = 1.5;
        /// The least, as a share of the range.
        const LEAST: f64 = 1e-4;
        let f = trajectory.f(self.model);
        let spline = trajectory.spline(&f);
        let (lowest, highest) = self.range();
        let n = trajectory.intervals();
        self.narrower.resize(n + 1, State::zeros(self.sizes()));
        let mut exceeds = false;
        for k in 0..n {
            for (row, _, x) in spline.extrema(k) {
                let excess = (x - highest[row]).max(lowest[row] - x).max(0.0);
                if excess == 0.0 {
                    continue;
                }
                exceeds = true;
                let range = highest[row] - lowest[row];
                // Neither start nor target move.
                for knot in [k, k + 1].into_iter().filter(|knot| (1..n).contains(knot)) {
                    let by = &mut self.narrower[knot][row];
                    *by = (*by + EXTRA * excess + LEAST * range).min(0.25 * range);
                }
            }
        }
        exceeds
    }

    /// J of (6a): t_F + h/2 sum u_k' R u_k, for `n` intervals with the `effort` sum u_k' u_k.
    pub(crate) fn cost(&self, t_f: f64, n: usize, effort: f64) -> f64 {
        t_f + 0.5 * t_f / n as f64 * self.input_weight * effort
    }

    /// A straight line from the start to the nearest point of the target, with zero velocities and inputs.
    pub fn straight_line(&self, t_f: f64) -> Trajectory {
        let end = nearest_state(&self.target, &self.start);
        let n = self.intervals;
        let at = |k: usize| {
            let s = k as f64 / n as f64;
            self.start * (1.0 - s) + end * s
        };
        Trajectory { t_f, x: (0..=n).map(at).collect(), u: vec![ActuatedVector::zeros(self.sizes()); n + 1] }
    }

    /// A solution from another start as a guess: its states are shifted by a share of the difference of the starts
    /// that falls linearly to 0 at the end.
    pub fn shifted(&self, neighbour: &Trajectory) -> Trajectory {
        let mut guess = neighbour.clone();
        let shift = self.start - neighbour.start();
        let n = neighbour.intervals();
        for (k, x) in guess.x.iter_mut().enumerate() {
            *x += shift * (1.0 - k as f64 / n as f64);
        }
        guess
    }
}
