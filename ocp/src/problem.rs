//! The swing-up as an optimisation problem: (6), (8) with the torque constraint (9) or (11).

use crate::kkt::TargetRow;
use nalgebra::SVector;
use upswing_model::{
    ActuatedVector, Derivatives, Hessian, Limits, Model, NQ, NX, State, StateParts, UnactuatedVector,
    Workspace, state,
};
use upswing_trajectory::{KNOTS, N, Trajectory};

/// The form of the motor torque that is kept within its limits, with what its bounds need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TorqueConstraint {
    /// (9): the torque itself.
    Exact,
    /// (11), the paper's: the torque without its Coriolis part, within bounds tightened by the bound c of that
    /// part (N m).
    WithoutCoriolis {
        /// Smallest C~ qd of each motor.
        lower: ActuatedVector,
        /// Largest C~ qd of each motor.
        upper: ActuatedVector,
    },
}

impl TorqueConstraint {
    /// Bounds (lower, upper) of the constrained torque, N m.
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
    /// By how much the bounds of x_k are narrower than `limits` on both sides, rad and rad/s; empty: nowhere.
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

/// x_T of (8): q1 = q3 = q5 = q7 = 0, q9 = 0, the given q8 and pitch q2 - q4 + q6 (rad), at rest; q2, q4, q6
/// are free but for the pitch.
pub fn upright_target(pitch: f64, q8: f64) -> Vec<TargetRow> {
    /// Joints that (8) fixes, and q8's own place among them.
    const FIXED: [usize; 6] = [0, 2, 4, 6, 7, 8];
    let mut rows: Vec<_> =
        FIXED.iter().map(|i| TargetRow::unit(*i, if *i == 7 { q8 } else { 0.0 })).collect();
    let mut coefficients = State::zeros();
    (coefficients[1], coefficients[3], coefficients[5]) = (1.0, -1.0, 1.0);
    rows.push(TargetRow { coefficients, value: pitch });
    rows.extend((NQ..NX).map(|i| TargetRow::unit(i, 0.0)));
    rows
}

/// First derivatives at one knot, with the constrained torque.
pub(crate) struct KnotDerivatives {
    /// Of the dynamics.
    pub dynamics: Derivatives,
    /// Of (11) where that is the constraint.
    pub constraint: Option<Derivatives>,
}

impl KnotDerivatives {
    /// Derivatives of the torque that the constraint bounds.
    pub(crate) fn torque(&self) -> &Derivatives {
        self.constraint.as_ref().unwrap_or(&self.dynamics)
    }
}

impl Problem<'_> {
    /// The bounds of x_k, rad and rad/s.
    pub fn bounds(&self, k: usize) -> (State, State) {
        let l = &self.limits;
        let by = self.narrower.get(k).copied().unwrap_or_else(State::zeros);
        (state(&l.q_min, &-l.qd_max) + by, state(&l.q_max, &l.qd_max) - by)
    }

    /// Narrows the bounds at the knots between which `trajectory` exceeds a limit: the trapezoidal rule knows the knots only.
    /// Whether it exceeds any.
    pub fn narrow(&mut self, trajectory: &Trajectory) -> bool {
        /// By how much, in units of the excess: the motion changes with its bounds, and a part of the excess comes back.
        const EXTRA: f64 = 1.5;
        /// The least, as a share of the range.
        const LEAST: f64 = 1e-4;
        let f = trajectory.f(self.model, &mut Workspace::default());
        let spline = trajectory.spline(&f);
        let (lowest, highest) =
            (state(&self.limits.q_min, &-self.limits.qd_max), state(&self.limits.q_max, &self.limits.qd_max));
        self.narrower.resize(KNOTS, State::zeros());
        let mut exceeds = false;
        for k in 0..N {
            for (row, _, x) in spline.extrema(k) {
                let excess = (x - highest[row]).max(lowest[row] - x).max(0.0);
                if excess == 0.0 {
                    continue;
                }
                exceeds = true;
                let range = highest[row] - lowest[row];
                // Neither start nor target move.
                for knot in [k, k + 1].into_iter().filter(|knot| (1..N).contains(knot)) {
                    let by = &mut self.narrower[knot][row];
                    *by = (*by + EXTRA * excess + LEAST * range).min(0.25 * range);
                }
            }
        }
        exceeds
    }

    /// J of (6a): t_F + h/2 sum u_k' R u_k.
    pub fn cost(&self, t_f: f64, u: &[ActuatedVector]) -> f64 {
        let effort: f64 = u.iter().map(|u| u.norm_squared()).sum();
        t_f + 0.5 * t_f / N as f64 * self.input_weight * effort
    }

    /// f_k and the constrained torque at a knot.
    pub(crate) fn knot(
        &self,
        x: &State,
        u: &ActuatedVector,
        work: &mut Workspace,
    ) -> (State, ActuatedVector) {
        let exact = self.model.derivative_and_torque(x, u, work);
        match self.torque {
            TorqueConstraint::Exact => exact,
            TorqueConstraint::WithoutCoriolis { .. } => {
                (exact.0, self.model.torque_without_coriolis(x, u, work))
            }
        }
    }

    /// First derivatives, and second derivatives of `w` . qdd_U + `mu` . tau, at a knot.
    pub(crate) fn knot_derivatives(
        &self,
        x: &State,
        u: &ActuatedVector,
        w: &UnactuatedVector,
        mu: &ActuatedVector,
        work: &mut Workspace,
    ) -> (KnotDerivatives, Hessian) {
        let dynamics = self.model.derivatives(x, u, work);
        match self.torque {
            TorqueConstraint::Exact => {
                let hessian = self.model.hessian(w, mu, &dynamics, work);
                (KnotDerivatives { dynamics, constraint: None }, hessian)
            }
            TorqueConstraint::WithoutCoriolis { .. } => {
                let mut hessian = self.model.hessian(w, &ActuatedVector::zeros(), &dynamics, work);
                let constraint = self.model.derivatives_without_coriolis(x, u, work);
                hessian += self.model.hessian_without_coriolis(mu, &constraint, work);
                (KnotDerivatives { dynamics, constraint: Some(constraint) }, hessian)
            }
        }
    }

    /// A straight line from the start to the nearest point of the target, with zero velocities and inputs.
    pub fn straight_line(&self, t_f: f64) -> Trajectory {
        let end = self.nearest_target(&self.start);
        let at = |k: usize| {
            let s = k as f64 / N as f64;
            self.start * (1.0 - s) + end * s
        };
        Trajectory {
            t_f,
            x: Box::new(std::array::from_fn(at)),
            u: Box::new([ActuatedVector::zeros(); KNOTS]),
        }
    }

    /// From the start to the nearest point of the target at constant speed with short ramps, with a half wave of the
    /// given amplitudes (joint counted from 0, rad) on some joints: it leaves the symmetric ridge between optima on
    /// which a straight line begins. The velocities follow the angles.
    pub fn bent_line(&self, t_f: f64, bends: &[(usize, f64)]) -> Trajectory {
        use std::f64::consts::PI;
        /// Share of the duration in which the speed rises, and falls.
        const RAMP: f64 = 0.1;
        const SPEED: f64 = 1.0 / (1.0 - RAMP);
        let mut guess = self.straight_line(t_f);
        let way = guess.x[N] - self.start;
        for k in 1..N {
            let s = k as f64 / N as f64;
            // The way covered and the speed, of 1 in a time of 1.
            let edge = s.min(1.0 - s);
            let covered =
                if edge < RAMP { 0.5 * SPEED / RAMP * edge * edge } else { SPEED * (edge - 0.5 * RAMP) };
            let covered = if s < 0.5 { covered } else { 1.0 - covered };
            let speed = SPEED * (edge / RAMP).min(1.0);
            for i in 0..NQ {
                guess.x[k].q_mut()[i] = self.start[i] + way[i] * covered;
                guess.x[k].qd_mut()[i] = way[i] * speed / t_f;
            }
            for (joint, amplitude) in bends {
                guess.x[k].q_mut()[*joint] += amplitude * (PI * s).sin();
                guess.x[k].qd_mut()[*joint] += amplitude * PI / t_f * (PI * s).cos();
            }
        }
        guess
    }

    /// A solution from another start as a guess: its states are shifted by a share of the difference of the starts
    /// that falls linearly to 0 at the end.
    pub fn shifted(&self, neighbour: &Trajectory) -> Trajectory {
        let mut guess = neighbour.clone();
        let shift = self.start - neighbour.x[0];
        for (k, x) in guess.x.iter_mut().enumerate() {
            *x += shift * (1.0 - k as f64 / N as f64);
        }
        guess
    }

    /// The state that meets the target rows closest to `x`. The rows of (8) are orthogonal, so that one
    /// projection after the other does it.
    fn nearest_target(&self, x: &State) -> State {
        self.target.iter().fold(*x, |x, row| {
            let c: &SVector<f64, NX> = &row.coefficients;
            x + c * ((row.value - c.dot(&x)) / c.norm_squared())
        })
    }
}
