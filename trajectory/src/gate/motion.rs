//! The trajectory of a plan: limits, dynamics and end.

use super::{
    DERIVATIVE_TOLERANCE, END_SPEED, END_TILT, Gate, POSITION_SLACK, TORQUE_SLACK, Unfit, VELOCITY_SLACK,
    finite,
};
use crate::{Certificate, KNOTS, N, Spline, Trajectory};
use upswing_model::{Model, NQ, NU, NX, State, Workspace, position, velocity};

/// Points of the grid per interval between knots on which torques are checked.
const GRID: usize = Certificate::BETWEEN + 1;

impl Gate {
    /// The part of [`Gate::check`] that needs no gains, for a trajectory with its f_k.
    ///
    /// # Errors
    /// The first check that failed, with its numbers.
    pub fn check_motion(
        &self,
        model: &Model,
        trajectory: &Trajectory,
        f: &[State; KNOTS],
    ) -> Result<(), Unfit> {
        let Trajectory { t_f, x, u } = trajectory;
        finite("x", x.iter().map(|x| x.as_slice()))?;
        finite("u", u.iter().map(|u| u.as_slice()))?;
        finite("f", f.iter().map(|f| f.as_slice()))?;
        // Written so that a NaN is refused.
        if !(*t_f > 0.0 && *t_f <= Trajectory::LONGEST) {
            return Err(Unfit::Duration { got: *t_f });
        }
        let spline = Spline { t_f: *t_f, x, u, f };
        let mut work = Workspace::default();
        for k in 0..=N {
            self.check_state(&x[k], k as f64)?;
            if k < N {
                spline
                    .extrema(k)
                    .try_for_each(|(row, share, got)| self.check_row(row, got, k as f64 + share))?;
            }
            let points = if k < N { GRID } else { 1 };
            for point in 0..points {
                let share = point as f64 / GRID as f64;
                self.check_torque(model, &spline, k, share, &mut work)?;
            }
        }
        check_derivatives(model, trajectory, f, &mut work)?;
        self.check_defects(trajectory, f)?;
        check_end(model, &x[N])
    }

    /// Positions and velocities of the state `x`, which the plan passes at `knot`.
    fn check_state(&self, x: &State, knot: f64) -> Result<(), Unfit> {
        (0..NX).try_for_each(|row| self.check_row(row, x[row], knot))
    }

    /// A position (the first NQ rows of a state) or a velocity.
    fn check_row(&self, row: usize, got: f64, knot: f64) -> Result<(), Unfit> {
        let (what, unit, joint) = name(row);
        let (lowest, highest) = if row < NQ {
            (self.limits.q_min[joint] - POSITION_SLACK, self.limits.q_max[joint] + POSITION_SLACK)
        } else {
            let fastest = self.limits.qd_max[joint] + VELOCITY_SLACK;
            (-fastest, fastest)
        };
        within(what, unit, joint, knot, got, lowest, highest)
    }

    /// Torques (9) of the spline a `share` of an interval after knot k.
    fn check_torque(
        &self,
        model: &Model,
        spline: &Spline<'_>,
        k: usize,
        share: f64,
        work: &mut Workspace,
    ) -> Result<(), Unfit> {
        let (x, u) = if share > 0.0 { spline.between(k, share) } else { (spline.x[k], spline.u[k]) };
        let tau = model.torque(&x, &u, work);
        for i in 0..NU {
            let strongest = self.limits.tau_max[i] * (1.0 + TORQUE_SLACK);
            within("torque", "N m", i, k as f64 + share, tau[i], -strongest, strongest)?;
        }
        Ok(())
    }

    fn check_defects(&self, trajectory: &Trajectory, f: &[State; KNOTS]) -> Result<(), Unfit> {
        let half_h = 0.5 * trajectory.h();
        for (k, x) in trajectory.x.windows(2).enumerate() {
            let defect = x[1] - x[0] - (f[k] + f[k + 1]) * half_h;
            if let Some(row) = (0..NX).find(|row| !(defect[*row].abs() <= self.defect)) {
                let (what, unit, joint) = name(row);
                let (got, most) = (defect[row].abs(), self.defect);
                return Err(Unfit::Defect { what, unit, joint, knot: k + 1, got, most });
            }
            // Where the spline ends, before it jumps to the knot.
            self.check_state(&(x[1] - defect), k as f64 + 1.0)?;
        }
        Ok(())
    }
}

/// What a row of a state is: name, unit, joint.
fn name(row: usize) -> (&'static str, &'static str, usize) {
    if row < NQ { ("position", "rad", row) } else { ("velocity", "rad/s", row - NQ) }
}

fn within(
    what: &'static str,
    unit: &'static str,
    joint: usize,
    knot: f64,
    got: f64,
    lowest: f64,
    highest: f64,
) -> Result<(), Unfit> {
    if (lowest..=highest).contains(&got) {
        Ok(())
    } else {
        Err(Unfit::Limit { what, unit, joint, knot, got, lowest, highest })
    }
}

/// f_k of the plan against f(x_k, u_k) (5).
fn check_derivatives(
    model: &Model,
    trajectory: &Trajectory,
    f: &[State; KNOTS],
    work: &mut Workspace,
) -> Result<(), Unfit> {
    for (knot, ((x, u), f)) in trajectory.knots().zip(f).enumerate() {
        let model = model.f(x, u, work);
        for row in 0..NX {
            let (got, expected) = (f[row], model[row]);
            if !((got - expected).abs() <= DERIVATIVE_TOLERANCE * (1.0 + expected.abs())) {
                return Err(Unfit::Derivative { knot, row, got, expected });
            }
        }
    }
    Ok(())
}

/// Rest with the rod standing or hanging.
fn check_end(model: &Model, x: &State) -> Result<(), Unfit> {
    let rod = model.rod(&position(x));
    let upright = rod.xy().norm().atan2(rod.z);
    let hanging = std::f64::consts::PI - upright;
    let speed = velocity(x).amax();
    if speed <= END_SPEED && upright.min(hanging) <= END_TILT {
        Ok(())
    } else {
        Err(Unfit::End { speed, upright, hanging })
    }
}
