//! The certificate of a database entry: figures of its trajectory that can be computed again from the trajectory alone.

use crate::{Gains, Margins, Trajectory, largest};
use upswing_model::{ActuatedVector, Limits, Model, State, Workspace};

/// Cost, accuracy and margins of one trajectory, which [`Certificate::of`] computes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// Cost J (6a), s.
    pub cost: f64,
    /// Largest component of the defects (6b), rad or rad/s.
    pub defect: f64,
    /// Smallest margin of a position, also between the knots, as a share of half the range.
    pub margin_q: f64,
    /// Smallest margin of a velocity, likewise.
    pub margin_qd: f64,
    /// Smallest margin of a motor torque, likewise.
    pub margin_tau: f64,
    /// Largest component (rad or rad/s) of [`open_loop_end`] less x_N. Infinite if the integration fails.
    pub end_error: f64,
}

impl Certificate {
    /// Points between two knots at which margins are taken.
    pub const BETWEEN: usize = 9;

    /// The certificate of a trajectory, for R = `input_weight` I (s^4/rad^2) and `limits`.
    pub fn of(trajectory: &Trajectory, model: &Model, limits: &Limits, input_weight: f64) -> Self {
        let mut work = Workspace::default();
        let margins = Margins::of(trajectory, model, limits, Self::BETWEEN);
        Self {
            cost: trajectory.cost(input_weight),
            defect: trajectory.defect(model),
            margin_q: margins.q.share,
            margin_qd: margins.qd.share,
            margin_tau: margins.tau.share,
            end_error: largest(&(open_loop_end(trajectory, model, &mut work) - trajectory.end())),
        }
    }

    /// The worst value of each figure over `certificates`: largest cost, defect and end error, smallest margins. Without
    /// certificates the errors are 0 and the margins 1.
    pub fn worst<'a>(certificates: impl IntoIterator<Item = &'a Self>) -> Self {
        let best =
            Self { cost: 0.0, defect: 0.0, margin_q: 1.0, margin_qd: 1.0, margin_tau: 1.0, end_error: 0.0 };
        certificates.into_iter().fold(best, |worst, c| Self {
            cost: worst.cost.max(c.cost),
            defect: worst.defect.max(c.defect),
            margin_q: worst.margin_q.min(c.margin_q),
            margin_qd: worst.margin_qd.min(c.margin_qd),
            margin_tau: worst.margin_tau.min(c.margin_tau),
            end_error: worst.end_error.max(c.end_error),
        })
    }

    /// The figures in the order of the database file.
    pub(crate) fn to_array(self) -> [f64; 6] {
        [self.cost, self.defect, self.margin_q, self.margin_qd, self.margin_tau, self.end_error]
    }

    /// The certificate of the figures in the order of the database file.
    pub(crate) fn from_array(v: [f64; 6]) -> Self {
        let [cost, defect, margin_q, margin_qd, margin_tau, end_error] = v;
        Self { cost, defect, margin_q, margin_qd, margin_tau, end_error }
    }

    /// Largest difference of a figure to that of `other`, relative to the larger of 1 and the figure. Two computations of
    /// the same trajectory differ by rounding only. Infinite if a figure is not finite.
    pub fn difference(&self, other: &Self) -> f64 {
        self.to_array()
            .iter()
            .zip(other.to_array())
            .map(|(a, b)| (a - b).abs() / a.abs().max(1.0))
            .fold(0.0, |worst, d| if d.is_nan() { f64::INFINITY } else { worst.max(d) })
    }
}

/// The state at t_F, rad and rad/s, that the dynamics (5) reach from x_0 without feedback under u(t) of the spline (12). NaN if the
/// integration fails.
pub fn open_loop_end(trajectory: &Trajectory, model: &Model, work: &mut Workspace) -> State {
    end_under(trajectory, model, work, |_, u, _| u)
}

/// Largest distance, rad or rad/s, from x_N to the state at t_F that the dynamics (5) reach from x_0 under u = u_d + K (x - x_d) (22), with
/// u_d and x_d of the spline (12): without delay, filter and limits. Infinite if the integration fails.
pub fn end_error(trajectory: &Trajectory, gains: &Gains, model: &Model, work: &mut Workspace) -> f64 {
    let end = end_under(trajectory, model, work, |(k, dt), u, dx| {
        u + gains.between(k, (dt / trajectory.h()).clamp(0.0, 1.0)).times(&dx)
    });
    largest(&(end - trajectory.end()))
}

/// The state at t_F for an input that depends on the place on the spline (interval, s after its knot), u_d and x - x_d.
///
/// By the method of Dormand and Prince (J. Comput. Appl. Math. 6, 1980) of order 5 with error control of order 4, restarted
/// at each knot, where u(t) has a kink. All components are NaN if the local error cannot be kept small.
fn end_under(
    trajectory: &Trajectory,
    model: &Model,
    work: &mut Workspace,
    input: impl Fn((usize, f64), ActuatedVector, State) -> ActuatedVector,
) -> State {
    /// Largest local error of a step, rad or rad/s.
    const TOLERANCE: f64 = 1e-11;
    /// Shortest step, s.
    const SHORTEST: f64 = 1e-9;
    let f = trajectory.f(model);
    let spline = trajectory.spline(&f);
    let mut x = *trajectory.start();
    let mut step = trajectory.h();
    for k in 0..trajectory.intervals() {
        let (mut t, end) = (k as f64 * trajectory.h(), (k + 1) as f64 * trajectory.h());
        while t < end {
            let h = step.min(end - t);
            let last = h >= end - t;
            let (next, error) = dormand_prince(&x, t, h, |t, x| {
                let (k, dt) = spline.locate(t);
                let u = input((k, dt), spline.input_in(k, dt), x - spline.state_in(k, dt));
                model.f(x, &u, work)
            });
            let worst = largest(&error);
            if worst <= TOLERANCE {
                x = next;
                t = if last { end } else { t + h };
            } else if h <= SHORTEST {
                return State::repeat(x.sizes(), f64::NAN);
            }
            let growth = 0.9 * libm::pow(TOLERANCE / worst.max(1e-300), 0.2);
            step = (h * growth.clamp(0.2, 5.0)).max(SHORTEST);
        }
    }
    x
}

/// One step of length `h` (s) from `x` at `t`: the new state and an estimate of its error.
fn dormand_prince(x: &State, t: f64, h: f64, mut f: impl FnMut(f64, &State) -> State) -> (State, State) {
    const C: [f64; 7] = [0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];
    const A: [[f64; 6]; 7] = [
        [0.0; 6],
        [0.2, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0, 0.0],
        [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
    ];
    /// Weights of order 5 minus those of order 4.
    const E: [f64; 7] =
        [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0];
    let mut slopes = [State::zeros(x.sizes()); 7];
    let mut next = *x;
    for i in 0..7 {
        next = *x;
        for j in 0..i {
            next += slopes[j] * (h * A[i][j]);
        }
        slopes[i] = f(t + C[i] * h, &next);
    }
    let error = slopes.iter().zip(E).fold(State::zeros(x.sizes()), |sum, (slope, e)| sum + slope * (h * e));
    (next, error)
}
