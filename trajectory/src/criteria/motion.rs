//! Criteria for the trajectory of a plan: limits, dynamics and end.

use super::{
    DERIVATIVE_TOLERANCE, END_TILT, PlanCriteria, TORQUE_SLACK, UnmetCriterion, VELOCITY_SLACK, finite,
};
use crate::margins::SplinePoint;
use crate::{Certificate, Margins, N, Spline, Trajectory};
use upswing_model::thresholds::{PLAN_POSITION_SLACK, REST_SPEED_PLAN_END};
use upswing_model::{LimitKind, Model, NU, NX, State, StateParts, Workspace};

/// Parts into which the points at which torques are checked divide each interval.
const PARTS: usize = Certificate::BETWEEN + 1;

impl PlanCriteria {
    /// The part of [`Self::check`] that needs no gains. Returns the margins to the limits.
    ///
    /// # Errors
    /// The first criterion that the trajectory does not meet, with its numbers.
    pub fn check_motion(&self, model: &Model, spline: &Spline<'_>) -> Result<Margins, UnmetCriterion> {
        finite("x", spline.x.iter().map(|x| x.as_slice()))?;
        finite("u", spline.u.iter().map(|u| u.as_slice()))?;
        finite("f", spline.f.iter().map(|f| f.as_slice()))?;
        // A NaN is refused, too.
        if !(spline.t_f > 0.0 && spline.t_f <= Trajectory::LONGEST) {
            return Err(UnmetCriterion::Duration { got: spline.t_f });
        }
        let mut work = Workspace::default();
        let mut margins = Margins::NONE;
        for k in 0..=N {
            self.check_state(&spline.x[k], k as f64)?;
            if k < N {
                spline
                    .extrema(k)
                    .try_for_each(|(row, share, got)| self.check_row(row, got, k as f64 + share))?;
            }
            let points = if k < N { PARTS } else { 1 };
            for i in k * PARTS..k * PARTS + points {
                let sample = SplinePoint::new(spline, i, PARTS, model, &mut work);
                margins.include(&sample, &self.limits);
                let knot = i as f64 / PARTS as f64;
                (0..NU).try_for_each(|i| self.check_limit(LimitKind::Torque, i, sample.tau[i], knot))?;
            }
        }
        check_derivatives(model, spline, &mut work)?;
        self.check_defects(spline)?;
        check_end(model, &spline.x[N])?;
        Ok(margins)
    }

    /// Positions and velocities of the state `x` at `knot`.
    fn check_state(&self, x: &State, knot: f64) -> Result<(), UnmetCriterion> {
        (0..NX).try_for_each(|row| self.check_row(row, x[row], knot))
    }

    /// The value `got` of a row of the state at `knot`.
    fn check_row(&self, row: usize, got: f64, knot: f64) -> Result<(), UnmetCriterion> {
        let (kind, joint) = LimitKind::of_row(row);
        self.check_limit(kind, joint, got, knot)
    }

    /// The value `got` against a limit, with its slack; a NaN is refused.
    fn check_limit(&self, kind: LimitKind, joint: usize, got: f64, knot: f64) -> Result<(), UnmetCriterion> {
        let (lower, upper) = self.limits.range(kind, joint);
        let (lowest, highest) = match kind {
            LimitKind::Position => (lower - PLAN_POSITION_SLACK, upper + PLAN_POSITION_SLACK),
            LimitKind::Velocity => (lower - VELOCITY_SLACK, upper + VELOCITY_SLACK),
            LimitKind::Torque => (lower * (1.0 + TORQUE_SLACK), upper * (1.0 + TORQUE_SLACK)),
        };
        if (lowest..=highest).contains(&got) {
            Ok(())
        } else {
            Err(UnmetCriterion::Limit { kind, joint, knot, got, lowest, highest })
        }
    }

    fn check_defects(&self, spline: &Spline<'_>) -> Result<(), UnmetCriterion> {
        for (k, defect) in spline.defects().enumerate() {
            if let Some(row) = (0..NX).find(|row| !(defect[*row].abs() <= self.defect)) {
                let (kind, joint) = LimitKind::of_row(row);
                let (got, most) = (defect[row].abs(), self.defect);
                return Err(UnmetCriterion::Defect { kind, joint, knot: k + 1, got, most });
            }
            // Where the spline ends, before it jumps to the knot.
            self.check_state(&(spline.x[k + 1] - defect), k as f64 + 1.0)?;
        }
        Ok(())
    }
}

/// f_k of the plan against f(x_k, u_k) (5) of the model.
fn check_derivatives(model: &Model, spline: &Spline<'_>, work: &mut Workspace) -> Result<(), UnmetCriterion> {
    for knot in 0..=N {
        let f = model.f(&spline.x[knot], &spline.u[knot], work);
        for row in 0..NX {
            let (got, expected) = (spline.f[knot][row], f[row]);
            if !((got - expected).abs() <= DERIVATIVE_TOLERANCE * (1.0 + expected.abs())) {
                return Err(UnmetCriterion::Derivative { knot, row, got, expected });
            }
        }
    }
    Ok(())
}

/// Rest at the state `x`, with the rod standing or hanging.
fn check_end(model: &Model, x: &State) -> Result<(), UnmetCriterion> {
    let rod = model.rod(&x.q());
    let upright = rod.xy().norm().atan2(rod.z);
    let hanging = std::f64::consts::PI - upright;
    let speed = x.qd().amax();
    if speed <= REST_SPEED_PLAN_END && upright.min(hanging) <= END_TILT {
        Ok(())
    } else {
        Err(UnmetCriterion::End { speed, upright, hanging })
    }
}
