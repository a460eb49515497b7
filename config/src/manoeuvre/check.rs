//! Checks of a manoeuvre against the model: rows of full rank, an end that is an equilibrium of its posture within the limits, and a start.

use super::{GivenError, Manoeuvre, TargetRow, TargetValue, nearest};
use crate::combinations::combinations;
use crate::conflict::{in_file, unit};
use upswing_model::{JointVector, Limits, Model, State, TargetError, Workspace};

/// A mistake in a manoeuvre.
#[derive(Debug, thiserror::Error)]
pub(super) enum Mistake {
    /// In the row of this number of the target, counted from 0.
    #[error("{1}")]
    Row(usize, String),
    /// In the target as a whole.
    #[error("{0}")]
    Target(String),
    /// In the grid of starts.
    #[error("{0}")]
    Grid(String),
}

/// Share of a row that has to be orthogonal to the rows before it.
const INDEPENDENT: f64 = 1e-8;
/// Largest number of values that requests give with which a target is checked.
const MOST_GIVEN: usize = 729;
/// Largest number of poses of a grid in which a start is looked for.
const MOST_STARTS: usize = 10_000;

/// Checks a manoeuvre that does not reverse another one.
pub(super) fn check(manoeuvre: &Manoeuvre, model: &Model, limits: &Limits) -> Result<(), Mistake> {
    rank(&manoeuvre.target, model)?;
    let values: Vec<_> = manoeuvre.given().map(|axis| ends_and_middle(axis.from, axis.to)).collect();
    for given in combinations(&values).take(MOST_GIVEN) {
        end(manoeuvre, &given, model, limits)?;
    }
    let grid = &manoeuvre.grid;
    let has_start = (0..grid.poses().min(MOST_STARTS))
        .any(|pose| manoeuvre.start_state(model, limits, &grid.pose(pose)).is_some());
    if has_start {
        return Ok(());
    }
    Err(Mistake::Grid(format!(
        "expected poses in which the unactuated joints are {} within their ranges, got none: change the grid or `start`",
        manoeuvre.start
    )))
}

/// Both ends and the middle; one value if they are equal.
fn ends_and_middle(from: f64, to: f64) -> Vec<f64> {
    if from == to { vec![from] } else { vec![from, 0.5 * (from + to), to] }
}

/// Checks that no row depends on those before it, and that a pose in which joints hang is determined.
fn rank(target: &[TargetRow], model: &Model) -> Result<(), Mistake> {
    let mut basis = Vec::new();
    let mut add = |row: &JointVector| -> bool {
        let mut rest = *row;
        // Twice: the first time leaves rounding errors of nearly parallel rows.
        for _ in 0..2 {
            for known in &basis {
                rest -= *known * rest.dot(known);
            }
        }
        let norm = rest.norm();
        // Written so that NaN is refused.
        let independent = norm > INDEPENDENT * row.norm();
        if independent {
            basis.push(rest / norm);
        }
        independent
    };
    // Rows with `rest` last: the pose has to be determined without them.
    let (rest, known): (Vec<_>, Vec<_>) =
        (0..target.len()).partition(|i| target[*i].value == TargetValue::Rest);
    let dependent = |i: usize| {
        let joints =
            target[i].coefficients.iter().enumerate().filter(|(_, coefficient)| **coefficient != 0.0);
        let joints: Vec<_> = joints.map(|(joint, _)| format!("`{}`", model.joint_name(joint))).collect();
        let joints = joints.join(", ");
        Mistake::Row(
            i,
            format!(
                "expected a row that does not depend on the other rows, got one of {joints} that does: remove it"
            ),
        )
    };
    if let Some(i) = known.into_iter().find(|i| !add(&target[*i].coefficients)) {
        return Err(dependent(i));
    }
    if let Some(first) = rest.first() {
        let sizes = model.sizes();
        for joint in 0..sizes.actuated() {
            let unit = JointVector::from_fn(sizes, |i| f64::from(u8::from(i == joint)));
            if add(&unit) {
                return Err(Mistake::Row(
                    *first,
                    format!(
                        "expected rows that determine the position of joint `{}`, got none: where a joint hangs depends on the pose",
                        model.joint_name(joint)
                    ),
                ));
            }
        }
        if let Some(i) = rest.into_iter().find(|i| !add(&target[*i].coefficients)) {
            return Err(dependent(i));
        }
    }
    Ok(())
}

/// Checks the end with `given` values: within the limits, and in all poses that meet the rows an equilibrium of the stated posture.
fn end(manoeuvre: &Manoeuvre, given: &[f64], model: &Model, limits: &Limits) -> Result<(), Mistake> {
    let rows = manoeuvre.rows(model, given).map_err(|e| match e {
        GivenError::NoRest(e) => Mistake::Target(format!(
            "{e}, {}: change the rows without `rest`",
            values(manoeuvre, given, model)
        )),
        e => Mistake::Target(e.to_string()),
    })?;
    for (i, (row, value)) in rows.iter().enumerate() {
        within(i, row, *value, model, limits)?;
    }
    /// Of the golden section.
    const SHARE: f64 = 0.381_966_011;
    let sizes = model.sizes();
    let middle = JointVector::from_fn(sizes, |i| 0.5 * (limits.q_min[i] + limits.q_max[i]));
    let work = &mut Workspace::default();
    // Joints that the rows leave free are anywhere: all of them in the middle of their ranges, and each at its ends and at a place that is
    // no fraction of a turn.
    let places = (0..sizes.joints()).flat_map(|joint| [0.0, SHARE, 1.0].map(|share| (joint, share)));
    for place in std::iter::once(None).chain(places.map(Some)) {
        let mut q = middle;
        if let Some((joint, share)) = place {
            q[joint] = limits.q_min[joint] + share * (limits.q_max[joint] - limits.q_min[joint]);
        }
        let q = nearest(&rows, &q);
        let x = State::new(&q, &JointVector::zeros(sizes));
        let pose = || pose(&q, model);
        model.check_equilibrium(&x, work).map_err(|TargetError { joint, acceleration, unit }| {
            Mistake::Target(format!(
                "expected an equilibrium of the unactuated joints, got one in which joint `{joint}` at rest accelerates with \
                 {acceleration:.3} {unit}/s^2, at {}: change the rows",
                pose()
            ))
        })?;
        let posture = model.posture(&q, work);
        if posture != manoeuvre.end {
            return Err(Mistake::Target(format!(
                "expected an equilibrium in which the unactuated joints are {}, as `end` says, got one in which they are {posture}, at {}",
                manoeuvre.end,
                pose()
            )));
        }
    }
    Ok(())
}

/// Checks that the joints of row number `i` can give the product `value` within their limits.
fn within(i: usize, row: &JointVector, value: f64, model: &Model, limits: &Limits) -> Result<(), Mistake> {
    /// Rounding of a product, rad or m.
    const ROUNDING: f64 = 1e-9;
    let product = |above_zero: &JointVector, below_zero: &JointVector| -> f64 {
        row.iter().enumerate().map(|(j, c)| c * if *c > 0.0 { above_zero[j] } else { below_zero[j] }).sum()
    };
    let (low, high) = (product(&limits.q_min, &limits.q_max), product(&limits.q_max, &limits.q_min));
    if (low - ROUNDING..=high + ROUNDING).contains(&value) {
        return Ok(());
    }
    let mut joints = (0..row.len()).filter(|joint| row[*joint] != 0.0);
    let Some(first) = joints.next() else { return Ok(()) };
    let kind = model.joint_kind(first);
    let names = std::iter::once(first).chain(joints).map(|joint| format!("`{}`", model.joint_name(joint)));
    let [low, high, got] = [low, high, value].map(|q| in_file(kind, q));
    let names = names.collect::<Vec<_>>().join(", ");
    let unit = unit(kind);
    Err(Mistake::Row(
        i,
        format!(
            ".value_{unit}: expected a value from {low} to {high} {unit}, which the ranges of {names} allow, got {got}: stay inside the \
             limits in robot.toml"
        ),
    ))
}

/// The values that a request gives, for messages.
fn values(manoeuvre: &Manoeuvre, given: &[f64], model: &Model) -> String {
    let shown = manoeuvre.given().zip(given).map(|(axis, value)| shown(axis.joint, *value, model));
    shown.collect::<Vec<_>>().join(", ")
}

/// A pose for messages: joints with their positions.
fn pose(q: &JointVector, model: &Model) -> String {
    q.iter().enumerate().map(|(joint, q)| shown(joint, *q, model)).collect::<Vec<_>>().join(", ")
}

fn shown(joint: usize, q: f64, model: &Model) -> String {
    let (q, unit) = model.joint_kind(joint).shown(q);
    format!("{} {q:.4} {unit}", model.joint_name(joint))
}
