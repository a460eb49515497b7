//! Detects stuck encoders: positions that do not change although the torque must have moved their joints.
//!
//! A stuck encoder shows a robot at rest; a feedback controller then commands a constant or growing torque, of which the model
//! predicts the effect. While the position of joint i keeps its value, the displacement y_i since its last change obeys
//!
//! ```text
//! M_i y'' + d_i y' = T_i + d,    y(0) = y'(0) = 0,
//! ```
//!
//! with the torque T_i commanded beyond the one that the model needs to hold still, and M_i the inertia of joint i
//! alone. The damping d_i is the largest presliding friction, so that y is the least motion to be expected. The torque d is
//! unknown: a payload, an offset of a sensor, static friction. It is constant while nothing moves, and within a
//! band about the last estimate. y is linear in d, so that each cycle leaves an interval of values of d for which |y| stays
//! below the resolution of the encoder; once the interval is empty, the encoder is stuck, or an obstacle blocks the joint. The
//! test needs no noise of the encoder, but a torque that changes.
//!
//! If torques are measured, a frozen measurement is detected without the model: the commanded torque changes, but neither
//! the measured torques nor any angle do.

use crate::law::{JointSpaceInertia, Torque};
use crate::trip::{Trip, TripCause};
use upswing_config::StandstillSettings;
use upswing_model::thresholds::REST_SPEED_ESTIMATE;
use upswing_model::{ActuatedVector, JointVector, UnactuatedVector};

/// Time without a change of its angle after which a joint counts as at rest, s: a joint that reverses rests for less.
const STANDS: f64 = 0.01;
/// Shortest unexplained standstill that trips, s: a fast joint does not stop at once.
const SHORTEST: f64 = 0.002;
/// Speed that errors of the model may suggest for a heavy joint at rest, rad/s: tolerated, as it is too low for a run-away.
const CREEP: f64 = 1e-3;
/// Time after which the torque sensors show a change of the commanded torque, s: longer than command and drives need.
const SHOWN: f64 = 0.01;

/// Time below [`REST_SPEED_ESTIMATE`] after which the arm counts as slow, s: the estimate then no longer depends on faster motion.
const QUIET: f64 = 0.1;

/// Errors of a measured speed: noise, rad/s, and lag, s.
const NOISE: f64 = 0.1;
const LAG: f64 = 0.03;

/// Number of actuated joints before the wrist: motion of the other joints hardly changes the disturbance estimate of the wrist. A machine
/// with fewer actuated joints has no wrist.
const BEFORE_WRIST: usize = 4;

/// State of the test of one joint since the last change of its angle.
#[derive(Clone, Copy, Debug)]
struct JointTest {
    /// Measured position, and the time for which it has kept this value, s.
    angle: f64,
    time: f64,
    /// Disturbance estimates, kept from the last change of the angle on, but updated: one while the arm is slow, the other
    /// always at the wrist and never at the other joints.
    estimate: [f64; VIEWS],
    /// y and y' for d = 1 and T_i = 0.
    per_torque: [f64; 2],
    /// Predictions if joints at rest stay at rest, if all joints move as commanded, and if none moves.
    cases: [[PredictedMotion; CASES]; VIEWS],
}

/// Number of assumptions about the motion of the other joints.
const CASES: usize = 3;
/// Number of disturbance estimates.
const VIEWS: usize = 2;

/// Motion predicted for one joint under one assumption about the other joints.
#[derive(Clone, Copy, Debug)]
struct PredictedMotion {
    /// y and y' for d = 0.
    y: [f64; 2],
    /// Lower and upper end of the interval of d that explains the standstill; empty if lower > upper.
    unknown: [f64; 2],
}

impl JointTest {
    /// Before the first measurement.
    const NONE: Self = Self {
        angle: f64::NAN,
        time: 0.0,
        estimate: [0.0; VIEWS],
        per_torque: [0.0; 2],
        cases: [[PredictedMotion { y: [0.0; 2], unknown: [0.0; 2] }; CASES]; VIEWS],
    };

    /// Begins at the measured angle with the `speed`, and with d in a band about `middle`.
    fn begin(&mut self, middle: f64, band: f64, speed: f64) {
        (self.estimate, self.per_torque) = ([middle; VIEWS], [0.0; 2]);
        let case = PredictedMotion { y: [0.0, speed], unknown: [middle - band, middle + band] };
        self.cases = [[case; CASES]; VIEWS];
    }
}

/// Integrates M_i y'' + d_i y' = torque over one step, implicit in y'.
fn advance(y: &mut [f64; 2], torque: f64, inertia: f64, friction: f64, elapsed: f64) {
    y[1] = (inertia * y[1] + elapsed * torque) / (inertia + elapsed * friction);
    y[0] += elapsed * y[1];
}

/// Torques that drive the joints in a cycle, and the inertias of the joints.
#[derive(Clone, Copy, Debug)]
struct DrivingTorque {
    /// T under each assumption, without the disturbance estimate.
    torque: [JointVector; CASES],
    /// Inertias M_i of single joints.
    inertia: JointVector,
}

/// Last measurement, the time for which it has not changed, and the torques commanded meanwhile.
#[derive(Clone, Copy, Debug)]
struct UnchangedMeasurement {
    q: JointVector,
    tau: ActuatedVector,
    /// Time without any change of the measurement, s.
    time: f64,
    /// Smallest and largest commanded torques meanwhile.
    low: ActuatedVector,
    high: ActuatedVector,
    /// Time for which these have differed by more than the resolution of the sensors, s.
    differs: f64,
}

impl UnchangedMeasurement {
    /// Begins with a changed measurement of positions `q` and torques `tau`.
    fn new(q: &JointVector, tau: &ActuatedVector) -> Self {
        let [low, high] = [f64::INFINITY, f64::NEG_INFINITY].map(|v| ActuatedVector::repeat(q.sizes(), v));
        Self { q: *q, tau: *tau, time: 0.0, low, high, differs: 0.0 }
    }
}

/// Detector of stuck encoders and frozen measurements.
#[derive(Clone, Debug)]
pub struct Standstill {
    settings: StandstillSettings,
    /// Smallest changes of the torques that the sensors show.
    resolution: ActuatedVector,
    unchanged: Option<UnchangedMeasurement>,
    /// Positions beyond which a joint may rest on its mechanical stop.
    reach: JointVector,
    /// One for each joint.
    joints: Vec<JointTest>,
    /// Time for which a jump of an angle still affects the disturbance estimate, s.
    pause: f64,
    /// Time for which the arm has been slow, s.
    quiet: f64,
    /// The last disturbance estimate.
    estimate: ActuatedVector,
    /// Torques of the last command; `None` while the brakes hold.
    drive: Option<DrivingTorque>,
}

impl Standstill {
    /// `q_max`: end of the range open to plans, near which the pendulum may rest on its stop; `tau_max`: 100 % torques.
    pub fn new(settings: &StandstillSettings, q_max: &JointVector, tau_max: &ActuatedVector) -> Self {
        let sizes = tau_max.sizes();
        Self {
            settings: *settings,
            resolution: *tau_max * settings.torque,
            unchanged: None,
            reach: JointVector::joined(
                &ActuatedVector::repeat(sizes, f64::INFINITY),
                &(q_max.unactuated() - UnactuatedVector::repeat(sizes, NEAR_STOP)),
            ),
            joints: vec![JointTest::NONE; sizes.joints()],
            pause: 0.0,
            quiet: 0.0,
            estimate: ActuatedVector::zeros(sizes),
            drive: None,
        }
    }

    /// Resets the detector, for closed brakes.
    pub fn reset(&mut self) {
        self.drive = None;
        self.unchanged = None;
        for joint in &mut self.joints {
            joint.angle = f64::NAN;
        }
    }

    /// Suspends the test after a jump of an angle, until the disturbance estimate no longer depends on the jump.
    pub fn jumped(&mut self) {
        self.pause = QUIET;
    }

    /// Takes the torque of this cycle, which acts until the next measurement. `u`: commanded acceleration, `estimate`: disturbance
    /// estimate, `inertia`: inertia matrices of this cycle, `qd`: measured speeds of the arm.
    #[inline(always)]
    pub fn command(
        &mut self,
        u: &ActuatedVector,
        torque: &Torque,
        estimate: &ActuatedVector,
        JointSpaceInertia { reduced, unactuated }: &JointSpaceInertia,
        qd: &ActuatedVector,
    ) {
        if let Some(unchanged) = &mut self.unchanged {
            unchanged.low = unchanged.low.inf(&torque.tau);
            unchanged.high = unchanged.high.sup(&torque.tau);
        }
        let cut = &torque.cut;
        let (sizes, qdd_u) = (u.sizes(), torque.qdd.unactuated());
        // Joints at rest do not follow u: the torque commanded for their acceleration drives the other joints.
        let standing =
            ActuatedVector::from_fn(sizes, |i| if self.joints[i].time > STANDS { u[i] } else { 0.0 });
        let (carried, full) = (reduced * &standing, reduced * u);
        let single = ActuatedVector::from_fn(sizes, |i| reduced[(i, i)]);
        // A row of M consists of one of M_UA and one of M_UU.
        let row = |c: usize| unactuated.row(c).split_at(sizes.actuated());
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let single_u = UnactuatedVector::from_fn(sizes, |c| row(c).1[c]);
        let moving = UnactuatedVector::from_fn(sizes, |c| dot(row(c).1, &qdd_u));
        let reaction = UnactuatedVector::from_fn(sizes, |c| dot(row(c).0, &standing));
        let change = estimate - self.estimate;
        // Errors of the model for fast joints change the estimates of all joints.
        if qd.amax() >= REST_SPEED_ESTIMATE {
            self.quiet = 0.0;
        }
        let slow = self.quiet > QUIET;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let is_actuated = i < u.len();
            if joint.time == 0.0 {
                let (middle, speed) = if is_actuated {
                    let speed = (qd[i].abs() - NOISE - LAG * u[i].abs()).max(0.0).copysign(qd[i]);
                    (estimate[i], speed)
                } else {
                    (0.0, 0.0)
                };
                joint.begin(middle, self.settings.unknown[i], speed);
            } else if is_actuated {
                joint.estimate[0] += if slow { change[i] } else { 0.0 };
                joint.estimate[1] += if i < BEFORE_WRIST { 0.0 } else { change[i] };
            }
        }
        self.estimate = *estimate;
        self.drive = Some(DrivingTorque {
            torque: [
                JointVector::joined(
                    &(carried + single.component_mul(&(u - standing)) - cut),
                    &(moving + reaction),
                ),
                JointVector::joined(&(single.component_mul(u) - cut), &moving),
                JointVector::joined(&(full - cut), &(moving + reaction)),
            ],
            inertia: JointVector::joined(&single, &single_u),
        });
    }

    /// Takes the positions `q` and the measured torques `tau`, `elapsed` (s) after the previous ones. Returns a trip if none
    /// of them changes although the commanded torque does.
    pub fn observe_all(&mut self, q: &JointVector, tau: &ActuatedVector, elapsed: f64) -> Option<Trip> {
        let unchanged = self.unchanged.get_or_insert_with(|| UnchangedMeasurement::new(q, tau));
        if unchanged.q != *q || unchanged.tau != *tau {
            *unchanged = UnchangedMeasurement::new(q, tau);
            return None;
        }
        unchanged.time += elapsed;
        let range = unchanged.high - unchanged.low;
        let joint = (0..range.len()).find(|&i| range[i] > self.resolution[i])?;
        unchanged.differs += elapsed;
        let (cause, value) = (TripCause::FrozenMeasurement, unchanged.time);
        (unchanged.differs > SHOWN).then_some(Trip { cause, joint, value, limit: SHOWN })
    }

    /// Takes the positions `q`, `elapsed` (s) after the previous ones. Returns a trip for the first joint with an unexplained
    /// standstill.
    #[inline(always)]
    pub fn observe(&mut self, q: &JointVector, elapsed: f64) -> Option<Trip> {
        let drive = self.drive.as_ref()?;
        self.quiet += elapsed;
        if self.pause > 0.0 {
            self.pause -= elapsed;
            self.joints.iter_mut().for_each(|joint| joint.angle = f64::NAN);
        }
        let mut first = None;
        let before_wrist = BEFORE_WRIST.min(q.sizes().actuated());
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let angle = self.settings.angle[i];
            if q[i] != joint.angle || q[i].abs() > self.reach[i] {
                // The test begins with the next command.
                (joint.angle, joint.time) = (q[i], 0.0);
                continue;
            }
            joint.time += elapsed;
            let limit = angle + if i < before_wrist { CREEP * joint.time } else { 0.0 };
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

/// Distance from the end of its range within which a joint of the pendulum may rest on its stop, rad or m.
const NEAR_STOP: f64 = 0.02;
