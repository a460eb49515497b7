//! From a plan in shared memory to one that the controller may run.

use nalgebra::{Schur, Vector3};
use thiserror::Error;
use upswing_config::Config;
use upswing_ipc::Plan as Payload;
use upswing_model::{ActuatedVector, Model, NQ, NU, NX, State, Workspace, position, velocity};
use upswing_trajectory::{Certificate, Gain, Plan, Reference, Trajectory};

/// How far knots may be past what `robot.toml` leaves to plans: rad, rad/s and a share of the torque. A solver meets
/// its limits up to a tolerance, and one QP around a database trajectory (14)-(17) meets the torque's linearisation.
const POSITION_TOLERANCE: f64 = 1e-3;
const VELOCITY_TOLERANCE: f64 = 1e-2;
const TORQUE_TOLERANCE: f64 = 0.05;
/// How far f_k may be from f(x_k, u_k) of this daemon's model, relative to 1 + |f|.
const DERIVATIVE_TOLERANCE: f64 = 1e-6;
/// How far the end of a plan may be from rest, rad/s, and its rod from the vertical, rad.
const END_SPEED: f64 = 1e-2;
const END_TILT: f64 = 2e-2;

/// Points of the grid per interval between knots on which limits are checked.
const GRID: usize = Certificate::BETWEEN + 1;

/// What a plan ends in, and so what follows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The rod stands: it has to be balanced.
    Upright,
    /// The rod hangs: the arm is held.
    Hanging,
}

impl Ending {
    /// Whether the rod along `rod` (world frame, z up) stands or hangs.
    pub fn of(rod: &Vector3<f64>) -> Self {
        if rod.z > 0.0 { Self::Upright } else { Self::Hanging }
    }
}

/// Why a plan was refused: the first check that failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanRefusal {
    /// The bytes are not those that the planner sealed.
    #[error("checksum: the plan names {expected:016x}, its contents give {got:016x}")]
    Checksum {
        /// In the plan.
        expected: u64,
        /// Of its contents.
        got: u64,
    },
    /// Made for another robot.
    #[error("fingerprint: the plan was made for the model {got:016x}, the daemon has {expected:016x}")]
    Fingerprint {
        /// Of the daemon's model.
        expected: u64,
        /// In the plan.
        got: u64,
    },
    /// The id that means "no plan".
    #[error("id: expected one above 0")]
    Id,
    /// A number is not finite.
    #[error("{what} at knot {knot} is {got}, expected a finite number")]
    NotFinite {
        /// Which part of the plan.
        what: &'static str,
        /// Number of the knot.
        knot: usize,
        /// What was found.
        got: f64,
    },
    /// t_F out of bounds.
    #[error("t_F is {got} s, expected more than 0 and at most {longest} s", longest = Trajectory::LONGEST)]
    Duration {
        /// t_F, s.
        got: f64,
    },
    /// A knot is beyond what plans may use.
    #[error("{what} of joint {} at knot {knot} is {got:.4}, expected {lowest:.4} to {highest:.4} {unit}", .joint + 1)]
    Limit {
        /// Position, velocity or torque.
        what: &'static str,
        /// Unit of the numbers.
        unit: &'static str,
        /// The joint, 0-based.
        joint: usize,
        /// Number of the knot; with a fraction between two knots.
        knot: f64,
        /// What was found.
        got: f64,
        /// Lower limit.
        lowest: f64,
        /// Upper limit.
        highest: f64,
    },
    /// The plan ends neither standing nor hanging at rest.
    #[error(
        "the plan ends at {speed:.4} rad/s with the rod {upright:.4} rad from upright and {hanging:.4} rad from hanging, \
         expected at most {END_SPEED} rad/s and {END_TILT} rad from one of both"
    )]
    End {
        /// Largest joint velocity at x_N, rad/s.
        speed: f64,
        /// Angle of the rod from upright, rad.
        upright: f64,
        /// Angle of the rod from hanging, rad.
        hanging: f64,
    },
    /// The final gain does not keep the rod upright.
    #[error(
        "the closed loop at the end of the plan is unstable: spectral radius {radius:.6}, expected below 1"
    )]
    Unstable {
        /// Of the discrete closed loop.
        radius: f64,
    },
    /// f_k is not that of the model.
    #[error("f at knot {knot}, row {row} is {got}, the model gives {expected}")]
    Derivative {
        /// Number of the knot.
        knot: usize,
        /// Row of f.
        row: usize,
        /// In the plan.
        got: f64,
        /// Of the model.
        expected: f64,
    },
}

/// Checks a plan in this order: checksum, fingerprint, id, finite numbers (states, inputs, derivatives, gains), t_F,
/// positions, velocities and torque (9) against the limits for plans at the knots and on a grid between them, f_k
/// against the model, an end at rest with the rod standing or hanging, and where it stands a stable closed loop. Time
/// is monotone by construction: the knots are uniform.
/// `payload` must be a copy that nobody else can write to.
///
/// # Errors
/// The first check that failed, with its numbers.
pub fn accept(payload: &Payload, config: &Config) -> Result<Box<Plan>, PlanRefusal> {
    if !payload.is_intact() {
        return Err(PlanRefusal::Checksum { expected: payload.checksum, got: payload.checksum_of() });
    }
    let expected = config.model.fingerprint();
    if payload.fingerprint != expected {
        return Err(PlanRefusal::Fingerprint { expected, got: payload.fingerprint });
    }
    if payload.id == 0 {
        return Err(PlanRefusal::Id);
    }
    finite("x", payload.x.iter().map(|x| x.as_slice()))?;
    finite("u", payload.u.iter().map(|u| u.as_slice()))?;
    finite("f", payload.f.iter().map(|f| f.as_slice()))?;
    finite("K", payload.k.iter().map(|k| k.as_flattened()))?;
    finite("the final K", std::iter::once(payload.k_final.as_flattened()))?;
    // Written so that a NaN is refused.
    if !(payload.t_f > 0.0 && payload.t_f <= Trajectory::LONGEST) {
        return Err(PlanRefusal::Duration { got: payload.t_f });
    }
    let plan = convert(payload);
    check_limits(&plan, config)?;
    check_end(&plan, config)?;
    Ok(plan)
}

fn finite<'a>(what: &'static str, knots: impl Iterator<Item = &'a [f64]>) -> Result<(), PlanRefusal> {
    for (knot, values) in knots.enumerate() {
        if let Some(got) = values.iter().find(|v| !v.is_finite()) {
            return Err(PlanRefusal::NotFinite { what, knot, got: *got });
        }
    }
    Ok(())
}

fn convert(payload: &Payload) -> Box<Plan> {
    let gain = |k: &[[f64; NX]; NU]| Gain::from_fn(|i, j| k[i][j]);
    Box::new(Plan {
        id: payload.id,
        fingerprint: payload.fingerprint,
        trajectory: Trajectory {
            t_f: payload.t_f,
            x: payload.x.iter().map(|x| State::from(*x)).collect(),
            u: payload.u.iter().map(|u| ActuatedVector::from(*u)).collect(),
        },
        f: payload.f.iter().map(|f| State::from(*f)).collect(),
        gains: payload.k.iter().map(gain).collect(),
        final_gain: gain(&payload.k_final),
    })
}

fn check_limits(plan: &Plan, config: &Config) -> Result<(), PlanRefusal> {
    let limits = &config.robot.planning;
    let mut work = Workspace::default();
    let Trajectory { x: knots, u: inputs, t_f } = &plan.trajectory;
    let spline = plan.spline();
    let samples = (knots.len() - 1) * GRID;
    for sample in 0..=samples {
        let knot = sample as f64 / GRID as f64;
        let t = t_f * sample as f64 / samples as f64;
        let at_knot = (sample % GRID == 0).then_some(sample / GRID);
        let (x, u) = at_knot.map_or_else(|| (spline.state(t), spline.input(t)), |k| (knots[k], inputs[k]));
        let within = |what, unit, joint, got, lowest: f64, highest: f64| {
            if (lowest..=highest).contains(&got) {
                Ok(())
            } else {
                Err(PlanRefusal::Limit { what, unit, joint, knot, got, lowest, highest })
            }
        };
        for i in 0..NQ {
            let (lowest, highest) =
                (limits.q_min[i] - POSITION_TOLERANCE, limits.q_max[i] + POSITION_TOLERANCE);
            within("position", "rad", i, x[i], lowest, highest)?;
            let fastest = limits.qd_max[i] + VELOCITY_TOLERANCE;
            within("velocity", "rad/s", i, x[NQ + i], -fastest, fastest)?;
        }
        let (f, tau) = config.model.derivative_and_torque(&x, &u, &mut work);
        for i in 0..NU {
            let strongest = limits.tau_max[i] * (1.0 + TORQUE_TOLERANCE);
            within("torque", "N m", i, tau[i], -strongest, strongest)?;
        }
        let Some(knot) = at_knot else { continue };
        for row in 0..NX {
            let (got, expected) = (plan.f[knot][row], f[row]);
            if (got - expected).abs() > DERIVATIVE_TOLERANCE * (1.0 + expected.abs()) {
                return Err(PlanRefusal::Derivative { knot, row, got, expected });
            }
        }
    }
    Ok(())
}

/// Rest with the rod standing or hanging; where it stands, the final gain has to keep it there.
fn check_end(plan: &Plan, config: &Config) -> Result<(), PlanRefusal> {
    let Reference { x, gain, .. } = plan.end();
    let rod = config.model.rod(&position(&x));
    let upright = rod.xy().norm().atan2(rod.z);
    let hanging = std::f64::consts::PI - upright;
    let speed = velocity(&x).amax();
    if !(speed <= END_SPEED && upright.min(hanging) <= END_TILT) {
        return Err(PlanRefusal::End { speed, upright, hanging });
    }
    if Ending::of(&rod) == Ending::Upright {
        let radius = closed_loop_radius(&config.model, &x, &gain, config.daemon.cycle.period.as_secs_f64());
        if !(radius < 1.0) {
            return Err(PlanRefusal::Unstable { radius });
        }
    }
    Ok(())
}

/// Spectral radius of I + Ts (A + B K), the closed loop (19), (22) of period `ts` (s) at the equilibrium `x`; infinite if
/// it cannot be computed.
fn closed_loop_radius(model: &Model, x: &State, gain: &Gain, ts: f64) -> f64 {
    /// Many times what the QR iteration takes.
    const ITERATIONS: usize = 100_000;
    let d = model.derivatives(x, &ActuatedVector::zeros(), &mut Workspace::default());
    let Some(schur) = Schur::try_new(d.a() + d.b() * gain, f64::EPSILON, ITERATIONS) else {
        return f64::INFINITY;
    };
    // A NaN must not get lost in a maximum.
    let radii = schur.complex_eigenvalues().map(|pole| (pole.re * ts + 1.0).hypot(pole.im * ts));
    radii.iter().fold(0.0, |largest, radius| if *radius <= largest { largest } else { *radius })
}
