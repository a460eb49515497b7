//! Encoders that are stuck: angles that do not change although the torque must have moved their joints.
//!
//! A stuck encoder shows a robot at rest, which a feedback answers with a steady torque, or with one that grows. The model
//! knows what that torque does. While the angle of joint i keeps its value, the displacement y_i since its last change obeys
//!
//! ```text
//! M_i y'' + d_i y' = T_i + d,    y(0) = y'(0) = 0,
//! ```
//!
//! with the torque T_i that is commanded beyond what the model needs to hold still and M_i the inertia that joint i shows
//! alone. Presliding friction d_i is the most that may damp it, so that y is the least motion to be expected. The torque d is
//! what nobody knows: a payload, an offset of a sensor, friction that holds. It is constant while nothing moves, and within a
//! band about the last estimate. y is linear in it, so every cycle leaves an interval of values for which |y| stays
//! below what the encoder resolves; when no value is left, the encoder is stuck, or something blocks the joint. No noise is
//! needed to tell, but a torque that changes.
//!
//! Where torques are measured, measurements that freeze as a whole are noticed without a model: the commanded torque changes, and
//! neither its sensors nor any angle show it.

use crate::law::{Inertia, Torque};
use crate::trip::{Trip, TripCause};
use upswing_config::StandstillSettings;
use upswing_model::thresholds::REST_SPEED_ESTIMATE;
use upswing_model::{ActuatedVector, JointVector, N_UNACTUATED, NQ, NU, UnactuatedVector};

/// Time after which a joint whose angle does not change is taken to stand, s: one that turns back stands for less.
const STANDS: f64 = 0.01;
/// Shortest standstill that is not explained, s: a fast joint does not stop at once.
const SHORTEST: f64 = 0.002;
/// Speed that the errors of a model may seem to ask of a heavy joint at rest, rad/s: a small one for a long time hides no run-away.
const CREEP: f64 = 1e-3;
/// Time after which the sensors show a change of the commanded torque, s: more than command and drives need.
const SHOWN: f64 = 0.01;

/// Time for which the arm has to be slower than [`REST_SPEED_ESTIMATE`], s: until the estimate has forgotten the motion before.
const QUIET: f64 = 0.1;

/// What may be wrong with a measured speed: noise, rad/s, and a lag, s.
const NOISE: f64 = 0.1;
const LAG: f64 = 0.03;

/// First joint of the wrist, 0-based: the motion of the others hardly moves the estimate of its torque.
const WRIST: usize = 4;

/// One joint since its last change.
#[derive(Clone, Copy, Debug)]
struct Joint {
    /// Measured angle, rad, and how long it has kept this value, s.
    angle: f64,
    time: f64,
    /// Estimate of other torques at its last change, N m: followed since while the arm was slow, and all the time.
    estimate: [f64; VIEWS],
    /// y and y' per N m of d.
    per_torque: [f64; 2],
    /// If the other joints do as they seem to, if they move as commanded, and if none moves.
    cases: [[Case; CASES]; VIEWS],
}

/// Assumptions about the other joints.
const CASES: usize = 3;
/// Views of the estimate.
const VIEWS: usize = 2;

/// What explains the standstill under one assumption about the other joints.
#[derive(Clone, Copy, Debug)]
struct Case {
    /// y and y' for d = 0, rad and rad/s.
    y: [f64; 2],
    /// The d that are left, N m.
    unknown: [f64; 2],
}

impl Joint {
    /// One that shows `angle` (rad) for the first time, with d in a band about `middle`, N m.
    fn new(angle: f64, middle: f64, band: f64) -> Self {
        let case = Case { y: [0.0; 2], unknown: [middle - band, middle + band] };
        Self {
            angle,
            time: 0.0,
            estimate: [middle; VIEWS],
            per_torque: [0.0; 2],
            cases: [[case; CASES]; VIEWS],
        }
    }
}

/// One step of M_i y'' + d_i y' = torque, implicit in y'.
fn advance(y: &mut [f64; 2], torque: f64, inertia: f64, friction: f64, elapsed: f64) {
    y[1] = (inertia * y[1] + elapsed * torque) / (inertia + elapsed * friction);
    y[0] += elapsed * y[1];
}

/// Torques that drive the joints over a cycle, and their inertia.
#[derive(Clone, Copy, Debug)]
struct DrivingTorque {
    /// T in all cases without the estimate, N m.
    torque: [JointVector; CASES],
    /// M_i, kg m^2.
    inertia: JointVector,
}

/// What was measured last, since when, and what was commanded since.
#[derive(Clone, Copy, Debug)]
struct Unchanged {
    /// Angles, rad, and torques, N m.
    q: JointVector,
    tau: ActuatedVector,
    /// How long nothing of it has changed, s.
    time: f64,
    /// The commanded torques lie between these, N m.
    low: ActuatedVector,
    high: ActuatedVector,
    /// How long they have differed by more than the sensors resolve, s.
    differs: f64,
}

impl Unchanged {
    /// New values.
    fn new(q: &JointVector, tau: &ActuatedVector) -> Self {
        let (low, high) = (ActuatedVector::repeat(f64::INFINITY), ActuatedVector::repeat(f64::NEG_INFINITY));
        Self { q: *q, tau: *tau, time: 0.0, low, high, differs: 0.0 }
    }
}

/// Watches all joints.
#[derive(Clone, Debug)]
pub struct Standstill {
    settings: StandstillSettings,
    /// Changes of the torques that sensors show, N m.
    resolution: ActuatedVector,
    unchanged: Option<Unchanged>,
    /// Angles beyond which a joint may lie on its stop, rad.
    reach: JointVector,
    joints: [Joint; NQ],
    /// How long a jump of an angle still moves the estimate of other torques, s.
    pause: f64,
    /// How long the arm has been slow, s.
    quiet: f64,
    /// The last estimate of other torques, N m.
    estimate: ActuatedVector,
    /// Of the last command; none while the brakes hold.
    drive: Option<DrivingTorque>,
}

impl Standstill {
    /// With the end of the range open to plans (rad), near which a pendulum may lie on its stop, and the 100 % torques (N m).
    pub fn new(settings: &StandstillSettings, q_max: &JointVector, tau_max: &ActuatedVector) -> Self {
        Self {
            settings: *settings,
            resolution: tau_max * settings.torque,
            unchanged: None,
            reach: JointVector::from_fn(|i, _| if i < NU { f64::INFINITY } else { q_max[i] - NEAR_STOP }),
            joints: [Joint::new(f64::NAN, 0.0, 0.0); NQ],
            pause: 0.0,
            quiet: 0.0,
            estimate: ActuatedVector::zeros(),
            drive: None,
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.drive = None;
        self.unchanged = None;
        for joint in &mut self.joints {
            joint.angle = f64::NAN;
        }
    }

    /// An angle jumped: until the estimate of other torques has forgotten it, nothing follows from what stands.
    pub fn jumped(&mut self) {
        self.pause = QUIET;
    }

    /// Takes in the torque of this cycle, which acts until the next measurement: `u` is the input that it is meant for (rad/s^2),
    /// `estimate` the estimate of other torques (N m), `inertia` that of this cycle, `qd` the measured speeds of the arm (rad/s).
    pub fn command(
        &mut self,
        u: &ActuatedVector,
        torque: &Torque,
        estimate: &ActuatedVector,
        Inertia { reduced, unactuated: columns }: &Inertia,
        qd: &ActuatedVector,
    ) {
        if let Some(unchanged) = &mut self.unchanged {
            unchanged.low = unchanged.low.inf(&torque.tau);
            unchanged.high = unchanged.high.sup(&torque.tau);
        }
        let cut = &torque.cut;
        let qdd_u: UnactuatedVector = torque.qdd.fixed_rows::<N_UNACTUATED>(NU).into();
        let m_au = columns.fixed_rows::<NU>(0);
        let m_uu = columns.fixed_rows::<N_UNACTUATED>(NU);
        // Joints that stand do not accelerate, whatever is asked of them.
        let standing = ActuatedVector::from_fn(|i, _| if self.joints[i].time > STANDS { u[i] } else { 0.0 });
        let (carried, full, reaction) = (reduced * standing, reduced * u, m_au.tr_mul(&standing));
        let change = estimate - self.estimate;
        // What the model does not know of fast joints moves the estimates for all.
        if qd.amax() >= REST_SPEED_ESTIMATE {
            self.quiet = 0.0;
        }
        let slow = self.quiet > QUIET;
        let mut inertia = JointVector::zeros();
        let mut torque = [JointVector::zeros(); CASES];
        for i in 0..NU {
            inertia[i] = reduced[(i, i)];
            let joint = &mut self.joints[i];
            if joint.time == 0.0 {
                *joint = Joint::new(joint.angle, estimate[i], self.settings.unknown[i]);
                let speed = (qd[i].abs() - NOISE - LAG * u[i].abs()).max(0.0).copysign(qd[i]);
                joint.cases.as_flattened_mut().iter_mut().for_each(|case| case.y[1] = speed);
            } else {
                joint.estimate[0] += if slow { change[i] } else { 0.0 };
                joint.estimate[1] += if i < WRIST { 0.0 } else { change[i] };
            }
            torque[0][i] = carried[i] + inertia[i] * (u[i] - standing[i]) - cut[i];
            torque[1][i] = inertia[i] * u[i] - cut[i];
            torque[2][i] = full[i] - cut[i];
        }
        self.estimate = *estimate;
        let moving = m_uu * qdd_u;
        for i in 0..N_UNACTUATED {
            inertia[NU + i] = m_uu[(i, i)];
            torque[0][NU + i] = moving[i] + reaction[i];
            torque[1][NU + i] = moving[i];
            torque[2][NU + i] = torque[0][NU + i];
        }
        let drive = DrivingTorque { torque, inertia };
        self.drive = Some(drive);
    }

    /// Takes in the angles `q` (rad) and the measured torques `tau` (N m), `elapsed` (s) after the last ones. Returns whether none
    /// of them shows what was commanded.
    pub fn observe_all(&mut self, q: &JointVector, tau: &ActuatedVector, elapsed: f64) -> Option<Trip> {
        let unchanged = self.unchanged.get_or_insert_with(|| Unchanged::new(q, tau));
        if unchanged.q != *q || unchanged.tau != *tau {
            *unchanged = Unchanged::new(q, tau);
            return None;
        }
        unchanged.time += elapsed;
        let range = unchanged.high - unchanged.low;
        let joint = (0..NU).find(|&i| range[i] > self.resolution[i])?;
        unchanged.differs += elapsed;
        let (cause, value) = (TripCause::FrozenMeasurement, unchanged.time);
        (unchanged.differs > SHOWN).then_some(Trip { cause, joint, value, limit: SHOWN })
    }

    /// Takes in the angles `q` (rad), `elapsed` (s) after the last ones. Returns the first joint that nothing explains.
    pub fn observe(&mut self, q: &JointVector, elapsed: f64) -> Option<Trip> {
        let drive = self.drive?;
        self.quiet += elapsed;
        if self.pause > 0.0 {
            self.pause -= elapsed;
            self.joints.iter_mut().for_each(|joint| joint.angle = f64::NAN);
        }
        let mut first = None;
        for i in 0..NQ {
            let (joint, angle) = (&mut self.joints[i], self.settings.angle[i]);
            if q[i] != joint.angle || q[i].abs() > self.reach[i] {
                *joint = Joint::new(q[i], 0.0, self.settings.unknown[i]);
                continue;
            }
            joint.time += elapsed;
            let limit = angle + if i < WRIST { CREEP * joint.time } else { 0.0 };
            let (inertia, friction) = (drive.inertia[i], self.settings.friction[i]);
            advance(&mut joint.per_torque, 1.0, inertia, friction, elapsed);
            let mut explained = true;
            for (cases, estimate) in joint.cases.iter_mut().zip(joint.estimate) {
                let mut any = false;
                for (case, torque) in cases.iter_mut().zip(&drive.torque) {
                    advance(&mut case.y, torque[i] - estimate, inertia, friction, elapsed);
                    let [low, high] = &mut case.unknown;
                    *low = low.max((-limit - case.y[0]) / joint.per_torque[0]);
                    *high = high.min((limit - case.y[0]) / joint.per_torque[0]);
                    any |= *low <= *high;
                }
                explained &= any;
            }
            if !explained && joint.time > SHORTEST && first.is_none() {
                let value = joint.time;
                first = Some(Trip { cause: TripCause::StuckEncoder, joint: i, value, limit });
            }
        }
        first
    }
}

/// How near to the end of its range a joint of the pendulum may lie on its stop, rad.
const NEAR_STOP: f64 = 0.02;
