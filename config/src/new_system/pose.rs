//! The pose of a target: the unactuated joints can hang and stand in it.

use super::holding_share;
use crate::combinations::combinations;
use upswing_model::{
    ActuatedVector, JointKind, JointVector, Limits, Model, Posture, UnactuatedVector, Workspace,
};

/// Positions of all joints in the end of a swing-up, and in its start with the same positions of the actuated joints.
pub(super) struct Pose {
    /// The unactuated joints hang.
    pub hanging: JointVector,
    /// They stand; `None` if they cannot.
    pub standing: Option<JointVector>,
    /// Why they cannot.
    pub no_standing: String,
    /// Largest speed of each unactuated joint in a fall from standing to hanging with the actuated joints held, rad/s or m/s.
    pub fall_speed: UnactuatedVector,
}

/// A pose that is examined.
struct Candidate {
    q_a: ActuatedVector,
    hanging: JointVector,
    standing: Option<JointVector>,
    /// Difference of potential energy between standing and hanging, J; 0 if they cannot stand.
    height: f64,
}

/// Largest number of poses that are examined, and positions of each actuated joint as shares of its range: the first list that fits.
const MOST_POSES: usize = 4096;
const SHARES: [&[f64]; 3] = [&[0.5, 0.25, 0.75, 0.1, 0.9], &[0.5, 0.25, 0.75], &[0.5, 0.75]];
/// Share of the torque open to plans with which motors may hold a pose.
const HOLD: f64 = 0.8;
/// Height of a swing relative to the largest one from which on poses count as equal.
const AS_HIGH: f64 = 0.95;

/// Largest distance by which an equilibrium may be beyond a range, rad or m: half a turn is often the end of one.
const ROUNDING: f64 = 1e-6;

impl Pose {
    /// The pose closest to the middle of the ranges in which the unactuated joints hang and stand, and swing as high as in any other one.
    ///
    /// # Errors
    /// A sentence if they hang in no pose.
    pub fn find(model: &Model, planning: &Limits) -> Result<Self, String> {
        let sizes = model.sizes();
        let fits = |shares: &&[f64]| {
            shares.len().checked_pow(sizes.actuated() as u32).is_some_and(|n| n <= MOST_POSES)
        };
        let shares = SHARES.into_iter().find(fits).unwrap_or(SHARES[2]);
        let positions = |i: usize| -> Vec<f64> {
            let kind = model.joint_kind(i);
            let (low, high) = (planning.q_min[i], planning.q_max[i]);
            shares.iter().map(|share| rounded(kind, low + (high - low) * share)).collect()
        };
        let positions: Vec<_> = (0..sizes.actuated()).map(positions).collect();
        let all = combinations(&positions).take(MOST_POSES);
        let candidates: Vec<_> = all.filter_map(|q_a| Candidate::at(model, planning, &q_a)).collect();
        let highest = candidates.iter().map(|c| c.height).fold(0.0, f64::max);
        let distance = |c: &Candidate| -> f64 {
            let of = |i: usize| {
                let (low, high) = (planning.q_min[i], planning.q_max[i]);
                ((c.q_a[i] - 0.5 * (low + high)) / (high - low)).powi(2)
            };
            (0..sizes.actuated()).map(of).sum()
        };
        let high = candidates.iter().filter(|c| c.height >= AS_HIGH * highest);
        let best = high.min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(Candidate { hanging, standing, height, .. }) = best else {
            return Err(format!(
                "expected a pose in which the unactuated joints hang within their ranges and the motors hold it with {} % of the torque \
                 open to plans, got none of {} poses: check the ranges and efforts, and that gravity acts along -z of the root link",
                HOLD * 100.0,
                positions.iter().map(Vec::len).product::<usize>().min(MOST_POSES)
            ));
        };
        let no_standing =
            "the free joints have no pose upright within their ranges that the motors can hold".into();
        let work = &mut Workspace::default();
        let inertia = model.mass_matrix(hanging, work).unactuated();
        // With the kinetic energy E of the whole chain, the largest speed of joint i is the root of 2 E (M_UU^-1)_ii.
        let compliance = UnactuatedVector::from_fn(sizes, |i| {
            let unit = UnactuatedVector::from_fn(sizes, |j| f64::from(u8::from(i == j)));
            inertia.solve_positive(&unit).map_or(0.0, |column| column[i])
        });
        // Without a swing-up: a swing of 90 deg.
        let energy = if *height > 0.0 {
            *height
        } else {
            model.potential_energy(&quarter(hanging)) - model.potential_energy(hanging)
        };
        let fall_speed = UnactuatedVector::from_fn(sizes, |i| (2.0 * energy.abs() * compliance[i]).sqrt());
        Ok(Self { hanging: *hanging, standing: *standing, no_standing, fall_speed })
    }
}

impl Pose {
    /// Period of the slowest small swing, s: that of a pendulum, whose fall from upright is twice as fast as its angular frequency.
    pub fn slowest_period(&self) -> f64 {
        let slowest = self.fall_speed.iter().copied().fold(f64::INFINITY, f64::min);
        2.0 * std::f64::consts::TAU / slowest
    }
}

/// The positions with the first unactuated joint turned by 90 deg.
fn quarter(q: &JointVector) -> JointVector {
    let mut q = *q;
    if let Some(first) = q.unactuated_mut().first_mut() {
        *first += std::f64::consts::FRAC_PI_2;
    }
    q
}

impl Candidate {
    /// The pose with the actuated joints at `q_a`; `None` if the unactuated joints do not hang there, or the motors cannot hold it.
    fn at(model: &Model, planning: &Limits, q_a: &[f64]) -> Option<Self> {
        let work = &mut Workspace::default();
        let hanging = model.standstill(planning, q_a, None).ok()?.q();
        let holds = |q: &JointVector| holding_share(model, planning, q) <= HOLD;
        if model.posture(&hanging, work) != Posture::Hanging || !holds(&hanging) {
            return None;
        }
        let standing = upright(model, planning, &hanging).filter(holds);
        let height = standing.map_or(0.0, |q| model.potential_energy(&q) - model.potential_energy(&hanging));
        Some(Self { q_a: hanging.actuated(), hanging, standing, height })
    }
}

/// The highest position of the unactuated joints within their ranges, closest to the `hanging` one; `None` if there is none. Two axes of a
/// gimbal lead upright in two ways, of which the ranges may exclude one: the search begins with any of the joints turned by half a turn.
fn upright(model: &Model, planning: &Limits, hanging: &JointVector) -> Option<JointVector> {
    /// Number of joints that are turned.
    const TURNED: usize = 4;
    let (sizes, work) = (model.sizes(), &mut Workspace::default());
    let turning = (sizes.actuated()..sizes.joints()).filter(|i| model.joint_kind(*i) != JointKind::Prismatic);
    let turning: Vec<_> = turning.take(TURNED).collect();
    let mut best: Option<(JointVector, f64)> = None;
    for turned in 0..1_usize << turning.len() {
        let mut q = *hanging;
        let half_turns = turning.iter().enumerate().filter(|(bit, _)| turned & (1 << bit) != 0);
        half_turns.for_each(|(_, i)| q[*i] += std::f64::consts::PI);
        let Ok(q) = model.upright_position(&q, work) else { continue };
        let Some(q) = within(model, planning, &q, hanging) else { continue };
        if model.posture(&q, work) != Posture::Standing {
            continue;
        }
        // Of equally high positions, the closest.
        let value = model.potential_energy(&q) - 1e-6 * (q - *hanging).norm();
        if best.is_none_or(|(_, of_best)| value > of_best) {
            best = Some((q, value));
        }
    }
    best.map(|(q, _)| q)
}

/// The positions `q` with whole turns added to those of the unactuated joints that turn, so that they are within their ranges, closest to
/// `near`; `None` if a range has no such position.
fn within(model: &Model, planning: &Limits, q: &JointVector, near: &JointVector) -> Option<JointVector> {
    let mut q = *q;
    for i in model.sizes().actuated()..model.sizes().joints() {
        let turns: &[f64] = match model.joint_kind(i) {
            JointKind::Prismatic => &[0.0],
            _ => &[0.0, -1.0, 1.0, -2.0, 2.0],
        };
        let at = turns.iter().map(|turns| q[i] + turns * std::f64::consts::TAU);
        let (low, high) = (planning.q_min[i], planning.q_max[i]);
        let inside =
            at.filter(|at| (low - ROUNDING..=high + ROUNDING).contains(at)).map(|at| at.clamp(low, high));
        // Of two equally close ones the one closer to 0.
        let key = |at: f64| (((at - near[i]).abs() * 1e6).round(), (at.abs() * 1e6).round());
        q[i] = inside.min_by(|a, b| key(*a).partial_cmp(&key(*b)).unwrap_or(std::cmp::Ordering::Equal))?;
    }
    Some(q)
}

/// A position rounded to a number that is easily read: whole deg, cm.
fn rounded(kind: JointKind, q: f64) -> f64 {
    match kind {
        JointKind::Prismatic => (q * 100.0).round() / 100.0,
        _ => q.to_degrees().round().to_radians(),
    }
}
