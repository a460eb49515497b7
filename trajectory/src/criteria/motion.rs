//! Criteria for the trajectory of a plan: limits, dynamics and end.

use super::{
    DERIVATIVE_TOLERANCE, PlanCriteria, TORQUE_SLACK, UnmetCriterion, VELOCITY_SLACK, finite, same_sizes,
};
use crate::margins::visit_points;
use crate::{Certificate, INTERVALS, Margins, Spline, Trajectory};
use upswing_model::thresholds::{PLAN_END_ACCELERATION, PLAN_POSITION_SLACK, REST_SPEED_PLAN_END};
use upswing_model::{ActuatedVector, JointVector, LimitKind, Model, State, Workspace};

/// Parts into which the points at which torques are checked divide each interval.
const PARTS: usize = Certificate::BETWEEN + 1;

impl PlanCriteria {
    /// The part of [`Self::check`] that needs no gains. Returns the margins to the limits.
    ///
    /// # Errors
    /// The first criterion that the trajectory does not meet, with its numbers.
    pub fn check_motion(&self, model: &Model, spline: &Spline<'_>) -> Result<Margins, UnmetCriterion> {
        check_sizes(model, spline)?;
        finite("x", spline.x.iter().map(|x| x.as_slice()))?;
        finite("u", spline.u.iter().map(|u| u.as_slice()))?;
        finite("f", spline.f.iter().map(|f| f.as_slice()))?;
        // A NaN is refused, too.
        if !(spline.t_f > 0.0 && spline.t_f <= Trajectory::LONGEST) {
            return Err(UnmetCriterion::Duration { got: spline.t_f });
        }
        let n = spline.intervals();
        for k in 0..=n {
            self.check_state(model, &spline.x[k], k as f64)?;
            if k < n {
                spline
                    .extrema(k)
                    .try_for_each(|(row, share, got)| self.check_row(model, row, got, k as f64 + share))?;
            }
        }
        let mut margins = Margins::NONE;
        visit_points(spline, PARTS, model, |i, time, x, tau| {
            margins.include(time, x, tau, &self.limits);
            let knot = i as f64 / PARTS as f64;
            (0..tau.len())
                .try_for_each(|joint| self.check_limit(model, LimitKind::Torque, joint, tau[joint], knot))
        })?;
        check_derivatives(model, spline)?;
        self.check_defects(model, spline)?;
        check_end(model, &spline.x[n])?;
        Ok(margins)
    }

    /// Positions and velocities of the state `x` at `knot`.
    fn check_state(&self, model: &Model, x: &State, knot: f64) -> Result<(), UnmetCriterion> {
        (0..x.len()).try_for_each(|row| self.check_row(model, row, x[row], knot))
    }

    /// The value `got` of a row of the state at `knot`.
    fn check_row(&self, model: &Model, row: usize, got: f64, knot: f64) -> Result<(), UnmetCriterion> {
        let (kind, joint) = LimitKind::of_row(row, model.sizes());
        self.check_limit(model, kind, joint, got, knot)
    }

    /// The value `got` against a limit, with its slack; a NaN is refused.
    fn check_limit(
        &self,
        model: &Model,
        kind: LimitKind,
        joint: usize,
        got: f64,
        knot: f64,
    ) -> Result<(), UnmetCriterion> {
        let (lower, upper) = self.limits.range(kind, joint);
        let (lowest, highest) = match kind {
            LimitKind::Position => (lower - PLAN_POSITION_SLACK, upper + PLAN_POSITION_SLACK),
            LimitKind::Velocity => (lower - VELOCITY_SLACK, upper + VELOCITY_SLACK),
            LimitKind::Torque => (lower * (1.0 + TORQUE_SLACK), upper * (1.0 + TORQUE_SLACK)),
        };
        if (lowest..=highest).contains(&got) {
            Ok(())
        } else {
            let unit = kind.unit(model.joint_kind(joint));
            Err(UnmetCriterion::Limit {
                kind,
                joint,
                name: model.joint_name(joint).to_owned(),
                unit,
                knot,
                got,
                lowest,
                highest,
            })
        }
    }

    fn check_defects(&self, model: &Model, spline: &Spline<'_>) -> Result<(), UnmetCriterion> {
        for (k, defect) in spline.defects().enumerate() {
            if let Some(row) = (0..defect.len()).find(|row| !(defect[*row].abs() <= self.defect)) {
                let (kind, joint) = LimitKind::of_row(row, model.sizes());
                let (unit, got, most) = (kind.unit(model.joint_kind(joint)), defect[row].abs(), self.defect);
                let name = model.joint_name(joint).to_owned();
                return Err(UnmetCriterion::Defect { kind, joint, name, unit, knot: k + 1, got, most });
            }
            // Where the spline ends, before it jumps to the knot.
            self.check_state(model, &(spline.x[k + 1] - defect), k as f64 + 1.0)?;
        }
        Ok(())
    }
}

/// The numbers of knots, and those of the joints against the model.
fn check_sizes(model: &Model, spline: &Spline<'_>) -> Result<(), UnmetCriterion> {
    let knots = spline.x.len();
    let got = knots.saturating_sub(1);
    if !INTERVALS.contains(&got) {
        return Err(UnmetCriterion::Intervals { got });
    }
    for (what, got) in [("u", spline.u.len()), ("f", spline.f.len())] {
        if got != knots {
            return Err(UnmetCriterion::Knots { what, expected: knots, got });
        }
    }
    same_sizes("x", model, spline.x.iter().map(|x| x.sizes()))?;
    same_sizes("u", model, spline.u.iter().map(|u| u.sizes()))?;
    same_sizes("f", model, spline.f.iter().map(|f| f.sizes()))
}

/// f_k of the plan against f(x_k, u_k) (5) of the model.
fn check_derivatives(model: &Model, spline: &Spline<'_>) -> Result<(), UnmetCriterion> {
    for (knot, f) in model.f_of_all(spline.x, spline.u).iter().enumerate() {
        for row in 0..f.len() {
            let (got, expected) = (spline.f[knot][row], f[row]);
            if !((got - expected).abs() <= DERIVATIVE_TOLERANCE * (1.0 + expected.abs())) {
                return Err(UnmetCriterion::Derivative { knot, row, got, expected });
            }
        }
    }
    Ok(())
}

/// Rest at the state `x`, in an equilibrium of the unactuated joints.
fn check_end(model: &Model, x: &State) -> Result<(), UnmetCriterion> {
    let at_rest = State::new(&x.q(), &JointVector::zeros(model.sizes()));
    let acceleration =
        model.f(&at_rest, &ActuatedVector::zeros(model.sizes()), &mut Workspace::default()).qd_u().amax();
    let speed = x.qd().amax();
    if speed <= REST_SPEED_PLAN_END && acceleration <= PLAN_END_ACCELERATION {
        Ok(())
    } else {
        Err(UnmetCriterion::End { speed, acceleration })
    }
}
