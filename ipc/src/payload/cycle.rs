//! The messages of every control cycle: measurement, command and telemetry.

use super::chain::{self, OtherChain, PerJoint};
use super::codes::{Clock, Mode, UnknownCode};
use super::words::{WORD, Zeroable, batch, words};
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{ActuatedVector, JointVector, Order, Sizes, State};

/// Measurement of encoders and drives, from plant to daemon.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Measurement.v2")]
pub struct Measurement {
    /// Cycle number of the plant since it started, counts from 1; 0: nothing measured yet.
    pub seq: u64,
    /// Time of the measurement, ns: CLOCK_MONOTONIC on the wall clock, `seq * period_ns` on the others.
    pub t_ns: u64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// q, joint positions, not wrapped.
    pub q: PerJoint,
    /// tau, torques measured at the actuated joints.
    pub tau_measured: PerJoint,
    /// Bits [`Measurement::BRAKES_CLOSED`] .. [`Measurement::LOAD_SENSED`]; all others 0.
    pub status: u64,
    /// Code of the plant's [`Clock`].
    pub clock: u64,
    /// Period of the plant's cycle, ns, above 0.
    pub period_ns: u64,
}

const _: () = assert!(size_of::<Measurement>() == WORD * 7 + 2 * size_of::<PerJoint>());

impl Measurement {
    /// Status bit: the brakes hold the actuated joints.
    pub const BRAKES_CLOSED: u64 = 1 << 0;
    /// Status bit: every drive is powered and follows torque commands; not before the first command has come, so that no robot is
    /// enabled that does not receive commands yet.
    pub const DRIVES_READY: u64 = 1 << 1;
    /// Status bit: at least one drive cut the last command to its torque limit.
    pub const SATURATED: u64 = 1 << 2;
    /// Status bit: at least one drive reports a fault.
    pub const DRIVE_FAULT: u64 = 1 << 3;
    /// Status bit: the brakes hold the arm at rest, and `tau_measured` is the load that sensors on the side of the links
    /// show meanwhile. Never set by a robot that measures the torque of its motors, which is none then.
    pub const LOAD_SENSED: u64 = 1 << 4;

    /// A measurement of the positions `q` and the torques `tau`; all else is 0.
    pub fn new(order: &Order, q: &JointVector, tau: &ActuatedVector) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        Self { joints, actuated, q: order.in_chain(q), tau_measured: *tau.padded(), ..Self::default() }
    }

    /// q and tau.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are those of `order`.
    pub fn vectors(&self, order: &Order) -> Result<(JointVector, ActuatedVector), OtherChain> {
        chain::check("measurement", (self.joints, self.actuated), order.sizes())?;
        Ok((chain::sorted(order, &self.q), chain::actuated(order.sizes(), &self.tau_measured)))
    }

    /// The plant's clock.
    ///
    /// # Errors
    /// [`UnknownCode`] if `clock` names none.
    pub fn clock(&self) -> Result<Clock, UnknownCode> {
        Clock::try_from(self.clock)
    }
}

/// Command to drives and brakes, from daemon to plant.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Command.v2")]
pub struct Command {
    /// Cycle number of the daemon since it started, counts from 1; 0: nothing commanded yet.
    pub seq: u64,
    /// ns; `wall`: planned start of the cycle, CLOCK_MONOTONIC; else `t_ns` of the measurement.
    pub t_ns: u64,
    /// `seq` of the measurement that this command answers.
    pub measurement_seq: u64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// tau, commanded torques of the actuated joints.
    pub tau: PerJoint,
    /// 1: close the brakes, 0: release them.
    pub brake: u64,
}

const _: () = assert!(size_of::<Command>() == WORD * 6 + size_of::<PerJoint>());

impl Command {
    /// A command of the torques `tau` with open brakes; all else is 0.
    pub fn new(tau: &ActuatedVector) -> Self {
        let (joints, actuated) = chain::numbers(tau.sizes());
        Self { joints, actuated, tau: *tau.padded(), ..Self::default() }
    }

    /// tau.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are `sizes`.
    pub fn torque(&self, sizes: Sizes) -> Result<ActuatedVector, OtherChain> {
        chain::check("command", (self.joints, self.actuated), sizes)?;
        Ok(chain::actuated(sizes, &self.tau))
    }
}

/// The vectors in a record of telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CycleVectors {
    /// x = [q, qd], measured positions and estimated velocities.
    pub x: State,
    /// x_d = [q_d, qd_d], reference.
    pub x_d: State,
    /// u_d, reference input.
    pub u_d: ActuatedVector,
    /// u = u_d + K dx, input after feedback.
    pub u: ActuatedVector,
    /// tau, commanded torques after the limiter.
    pub tau: ActuatedVector,
    /// tau, measured torques.
    pub tau_measured: ActuatedVector,
}

/// Record of one control cycle, published by the daemon.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Telemetry.v4")]
pub struct Telemetry {
    /// Cycle number of the daemon since it started, counts from 1.
    pub seq: u64,
    /// ns; `wall`: planned start of the cycle, CLOCK_MONOTONIC; else `t_ns` of the measurement.
    pub t_ns: u64,
    /// `seq` of the measurement used.
    pub measurement_seq: u64,
    /// Code of the [`Mode`] at the end of the cycle.
    pub mode: u64,
    /// Code of the daemon's latched fault, 0: none.
    pub fault: u64,
    /// Limits whose warning level this cycle exceeded: bit `1 << (code - 1)` for each code that `fault` can have.
    pub warnings: u64,
    /// Parts of the real-time set-up that the operating system refused: bits of [`crate::Degradation`]; 0: none.
    pub degraded: u64,
    /// Id of the running plan, 0: none.
    pub plan_id: u64,
    /// Bits [`Telemetry::OVERRUN`] .. [`Telemetry::BRAKE`]; all others 0.
    pub flags: u64,
    /// t, time since the plan started, s; 0 without a plan.
    pub t_plan: f64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// q, measured joint positions; of a joint that turns over without the whole turns that it made while it was not
    /// controlled.
    pub q: PerJoint,
    /// qd, estimated joint velocities.
    pub qd: PerJoint,
    /// q_d, reference positions.
    pub q_d: PerJoint,
    /// qd_d, reference velocities.
    pub qd_d: PerJoint,
    /// u_d, reference input (accelerations of the actuated joints).
    pub u_d: PerJoint,
    /// u = u_d + K dx, input after feedback.
    pub u: PerJoint,
    /// tau, commanded torques after the limiter.
    pub tau: PerJoint,
    /// tau, measured torques.
    pub tau_measured: PerJoint,
    /// From the planned start of the cycle to the actual one, ns; measured on the clock `wall`, else 0.
    pub wake_ns: u64,
    /// Reading the measurement, ns; measured on the clock `wall`, else 0.
    pub read_ns: u64,
    /// Filter, supervisor, control and torque law, ns; measured on the clocks `wall` and `paced`, 0 on `lockstep`.
    pub compute_ns: u64,
    /// Writing the command, ns; measured on the clocks `wall` and `paced`, 0 on `lockstep`.
    pub write_ns: u64,
    /// Code of the plant's [`Clock`], as the measurement used names it: what `t_ns` and the phase times count by.
    pub clock: u64,
}

const _: () = assert!(size_of::<Telemetry>() == WORD * 17 + 8 * size_of::<PerJoint>());

impl Telemetry {
    /// Flag: the cycle ended after the next one should have begun.
    pub const OVERRUN: u64 = 1 << 0;
    /// Flag: no new measurement since the last cycle.
    pub const STALE: u64 = 1 << 1;
    /// Flag: the torque limiter cut the command.
    pub const LIMITED: u64 = 1 << 2;
    /// Flag: the command closes the brakes.
    pub const BRAKE: u64 = 1 << 3;

    /// A record with these vectors; all else is 0.
    #[inline]
    pub fn new(order: &Order, vectors: &CycleVectors) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        Self {
            joints,
            actuated,
            q: order.in_chain(&vectors.x.q()),
            qd: order.in_chain(&vectors.x.qd()),
            q_d: order.in_chain(&vectors.x_d.q()),
            qd_d: order.in_chain(&vectors.x_d.qd()),
            u_d: *vectors.u_d.padded(),
            u: *vectors.u.padded(),
            tau: *vectors.tau.padded(),
            tau_measured: *vectors.tau_measured.padded(),
            ..Self::default()
        }
    }

    /// The vectors of the record.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are those of `order`.
    pub fn vectors(&self, order: &Order) -> Result<CycleVectors, OtherChain> {
        chain::check("telemetry", (self.joints, self.actuated), order.sizes())?;
        let actuated = |values| chain::actuated(order.sizes(), values);
        Ok(CycleVectors {
            x: chain::state(order, &self.q, &self.qd),
            x_d: chain::state(order, &self.q_d, &self.qd_d),
            u_d: actuated(&self.u_d),
            u: actuated(&self.u),
            tau: actuated(&self.tau),
            tau_measured: actuated(&self.tau_measured),
        })
    }

    /// The values in use of one of the arrays `q`, `qd`, `q_d` and `qd_d` of this record, in the chain's order.
    pub fn of_joints<'a>(&self, values: &'a PerJoint) -> &'a [f64] {
        chain::used(values, self.joints)
    }

    /// The values in use of one of the arrays `u_d`, `u`, `tau` and `tau_measured` of this record, in the chain's order.
    pub fn of_actuated<'a>(&self, values: &'a PerJoint) -> &'a [f64] {
        chain::used(values, self.actuated)
    }

    /// The plant's clock.
    ///
    /// # Errors
    /// [`UnknownCode`] if `clock` names none.
    pub fn clock(&self) -> Result<Clock, UnknownCode> {
        Clock::try_from(self.clock)
    }

    /// The daemon's mode.
    ///
    /// # Errors
    /// [`UnknownCode`] if `mode` names none.
    pub fn mode(&self) -> Result<Mode, UnknownCode> {
        Mode::try_from(self.mode)
    }

    /// The daemon's mode as text; an unknown code gives the text of the error.
    pub fn mode_text(&self) -> String {
        self.mode().map_or_else(|e| e.to_string(), |mode| mode.to_string())
    }
}

words!(Telemetry);

/// Records in one [`TelemetryBatch`].
const TELEMETRY_BATCH: usize = 64;

/// Records of consecutive cycles in one sample: a sample per cycle would cost more than the cycle itself.
#[repr(C)]
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[type_name("upswing.TelemetryBatch.v4")]
pub struct TelemetryBatch {
    /// Records in use, 0 to the length of `records`; not to be trusted, read with [`TelemetryBatch::used`].
    pub count: u64,
    /// Records that the daemon lost before this batch, since its start.
    pub dropped: u64,
    /// The records, oldest first; meaningless from `count` on.
    pub records: [Telemetry; TELEMETRY_BATCH],
}

const _: () = assert!(size_of::<TelemetryBatch>() == WORD * 2 + TELEMETRY_BATCH * size_of::<Telemetry>());

batch!(TelemetryBatch of Telemetry, TELEMETRY_BATCH);
