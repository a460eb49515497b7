//! Enumerations that are numbers, their codes, in shared memory; a code is checked before it becomes an enumeration.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// A code from shared memory that names no variant of its enumeration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("unknown {what} code {got}: expected 0..={max}; both sides must run the same version")]
pub struct UnknownCode {
    /// Name of the enumeration, for example "mode".
    pub what: &'static str,
    /// The code that was read.
    pub got: u64,
    /// The largest valid code.
    pub max: u64,
}

/// Defines an enumeration whose variants are numbered from 0, with its conversions and its texts.
macro_rules! codes {
    ($(#[$meta:meta])* $name:ident is a $what:literal {
        $($(#[$variant_meta:meta])* $variant:ident = $label:literal),+ $(,)?
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[$variant_meta])* $variant),+
        }

        impl $name {
            /// All variants; the index of a variant is its code.
            pub const ALL: &'static [$name] = &[$($name::$variant),+];

            /// The code of this variant.
            pub const fn code(self) -> u64 {
                self as u64
            }

            /// The name of this variant for people.
            pub const fn name(self) -> &'static str {
                match self { $($name::$variant => $label),+ }
            }
        }

        impl TryFrom<u64> for $name {
            type Error = UnknownCode;

            fn try_from(got: u64) -> Result<Self, UnknownCode> {
                usize::try_from(got).ok().and_then(|i| Self::ALL.get(i)).copied().ok_or(UnknownCode {
                    what: $what,
                    got,
                    max: Self::ALL.len() as u64 - 1,
                })
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }
    };
}

codes! {
    /// The clock of a system: how plant and daemon advance in time. Rules: `pacing`.
    Clock is a "clock" {
        /// Daemon and plant each follow CLOCK_MONOTONIC; a late daemon meets a plant that has moved on.
        Wall = "wall",
        /// The plant advances one period per command, not faster than real time.
        Paced = "paced",
        /// The plant advances one period per command, as fast as both can go; deterministic.
        Lockstep = "lockstep",
    }
}

codes! {
    /// Mode of the daemon.
    Mode is a "mode" {
        /// Brakes closed, no torque.
        Idle = "idle",
        /// Gravity-compensated hold of the joints.
        Hold = "hold",
        /// Following a plan.
        Track = "track",
        /// Final gain at the upright equilibrium x_T.
        Balance = "balance",
        /// Decelerating within the limits, then hold.
        Stop = "stop",
        /// Latched fault, brakes; only a reset leaves it.
        Fault = "fault",
    }
}

codes! {
    /// Whether the daemon can be enabled, by its last cycle.
    Readiness is a "readiness" {
        /// Nothing speaks against an enable in mode Idle.
        Ready = "ready",
        /// No measurement has come yet.
        NoMeasurement = "no measurement",
        /// The drives are not powered, or have received no command yet.
        DrivesNotReady = "drives not ready",
        /// The measurement cannot be trusted, or a limit is exceeded.
        Unfit = "unfit",
    }
}

codes! {
    /// A command to the daemon.
    ControlKind is a "control request" {
        /// Release the brakes and hold.
        Enable = "enable",
        /// Hold the joints where they are.
        Hold = "hold",
        /// Decelerate within the limits, then hold.
        Stop = "stop",
        /// Leave a latched fault.
        Reset = "reset",
        /// Change nothing, only answer.
        Status = "status",
        /// Start the loaded plan.
        Start = "start",
    }
}

codes! {
    /// A part of the real-time set-up that the operating system refused; bit `1 << code` of a `degraded` word.
    Degradation is a "degradation" {
        /// Memory is not locked: page faults may come at any time.
        Memory = "memory is not locked",
        /// No SCHED_FIFO: any other thread may take the CPU.
        Scheduler = "no real-time priority",
        /// Not pinned to the CPU of the settings.
        Cpu = "not on its CPU",
        /// Sleeps may last longer than asked.
        TimerSlack = "coarse timer",
        /// The CPU may sleep deeply, and wakes up late.
        DmaLatency = "CPU sleep states allowed",
    }
}

impl Degradation {
    /// The bit of this degradation in a `degraded` word.
    pub const fn bit(self) -> u64 {
        1 << self.code()
    }

    /// The degradations of which a `degraded` word has the bits; unknown bits are ignored.
    pub fn of(degraded: u64) -> impl Iterator<Item = Self> {
        Self::ALL.iter().copied().filter(move |d| degraded & d.bit() != 0)
    }
}

codes! {
    /// A request to the planner.
    PlannerKind is a "planner request" {
        /// A plan of a manoeuvre.
        Plan = "plan",
        /// Change nothing, only answer.
        Status = "status",
    }
}

codes! {
    /// How a request to the planner ended.
    PlannerStatus is a "planner status" {
        /// A plan that keeps every limit was found, and its defect is within the setting.
        Solved = "solved",
        /// The request itself makes no sense (unknown kind, a number that is not finite).
        BadRequest = "bad request",
        /// The start state violates a limit of the robot.
        StartOutsideLimits = "start outside limits",
        /// The solver found no plan that keeps the limits.
        Infeasible = "infeasible",
        /// No fresh telemetry of the daemon, or a mode in which there is no such plan.
        NotReady = "not ready",
        /// The time budget was used up first.
        Deadline = "deadline",
        /// A plan that keeps every limit was found, but its defect is above the setting, as one QP leaves it.
        OpenDefect = "solved with an open defect",
    }
}

codes! {
    /// What is asked of the simulated plant.
    PlantKind is a "plant request" {
        /// Set q and qd.
        ResetState = "reset-state",
        /// Advance to a cycle number (lockstep clock).
        AdvanceTo = "advance-to",
        /// Inject a fault.
        SetFault = "set-fault",
        /// Clear all injected faults.
        ClearFaults = "clear-faults",
        /// Change nothing, only answer.
        Status = "status",
        /// Push the tip of the rod.
        Push = "push",
    }
}

/// A text that is not the name of a clock.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown clock `{got}`: expected wall, paced or lockstep")]
pub struct UnknownClock {
    /// The text.
    pub got: String,
}

impl FromStr for Clock {
    type Err = UnknownClock;

    fn from_str(name: &str) -> Result<Self, UnknownClock> {
        let clock = Clock::ALL.iter().find(|clock| clock.name() == name).copied();
        clock.ok_or_else(|| UnknownClock { got: name.to_owned() })
    }
}
