//! The messages of every control cycle: measurement, command and telemetry.

use super::codes::{Clock, Mode, UnknownCode};
use super::words::{WORD, Zeroable, batch, words};
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{NQ, NU};

/// Measurement of encoders and drives, from plant to daemon.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Measurement.v1")]
pub struct Measurement {
    /// Cycle number of the plant since it started, counts from 1; 0: nothing measured yet.
    pub seq: u64,
    /// Time of the measurement, ns: CLOCK_MONOTONIC on the wall clock, `seq * period_ns` on the others.
    pub t_ns: u64,
    /// q, joint positions, joint frames, rad, not wrapped.
    pub q: [f64; NQ],
    /// tau, torques measured at the actuated joints, joint frames, N m.
    pub tau_measured: [f64; NU],
    /// Bits [`Measurement::BRAKES_CLOSED`] .. [`Measurement::LOAD_SENSED`]; all others 0.
    pub status: u64,
    /// Code of the plant's [`Clock`].
    pub clock: u64,
    /// Period of the plant's cycle, ns, above 0.
    pub period_ns: u64,
}

const _: () = assert!(size_of::<Measurement>() == WORD * (5 + NQ + NU));

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
#[type_name("upswing.Command.v1")]
pub struct Command {
    /// Cycle number of the daemon since it started, counts from 1; 0: nothing commanded yet.
    pub seq: u64,
    /// ns; `wall`: planned start of the cycle, CLOCK_MONOTONIC; else `t_ns` of the measurement.
    pub t_ns: u64,
    /// `seq` of the measurement that this command answers.
    pub measurement_seq: u64,
    /// tau, commanded torques of the actuated joints, joint frames, N m.
    pub tau: [f64; NU],
    /// 1: close the brakes, 0: release them.
    pub brake: u64,
}

const _: () = assert!(size_of::<Command>() == WORD * (4 + NU));

/// Record of one control cycle, published by the daemon.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Telemetry.v3")]
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
    /// q, measured joint positions, joint frames, rad; q8 without the whole turns that it made while it was not
    /// controlled.
    pub q: [f64; NQ],
    /// qd, estimated joint velocities, joint frames, rad/s.
    pub qd: [f64; NQ],
    /// q_d, reference positions, joint frames, rad.
    pub q_d: [f64; NQ],
    /// qd_d, reference velocities, joint frames, rad/s.
    pub qd_d: [f64; NQ],
    /// u_d, reference input (accelerations of the actuated joints), rad/s^2.
    pub u_d: [f64; NU],
    /// u = u_d + K dx, input after feedback, rad/s^2.
    pub u: [f64; NU],
    /// tau, commanded torques after the limiter, joint frames, N m.
    pub tau: [f64; NU],
    /// tau, measured torques, joint frames, N m.
    pub tau_measured: [f64; NU],
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

const _: () = assert!(size_of::<Telemetry>() == WORD * (15 + 4 * NQ + 4 * NU));

impl Telemetry {
    /// Flag: the cycle ended after the next one should have begun.
    pub const OVERRUN: u64 = 1 << 0;
    /// Flag: no new measurement since the last cycle.
    pub const STALE: u64 = 1 << 1;
    /// Flag: the torque limiter cut the command.
    pub const LIMITED: u64 = 1 << 2;
    /// Flag: the command closes the brakes.
    pub const BRAKE: u64 = 1 << 3;

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
#[type_name("upswing.TelemetryBatch.v3")]
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
