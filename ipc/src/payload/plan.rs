//! A plan as a message from planner to daemon, and its conversion to and from the plan that the controller follows.

use super::chain::{self, OtherChain};
use super::words::WORD;
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{ActuatedVector, MOST_JOINTS, Order, Sizes, State};
use upswing_trajectory::{Gains, INTERVALS, Plan, Trajectory};
use xxhash_rust::xxh3::Xxh3;

/// What comes before the numbers of a [`PlanMessage`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("upswing.Plan.v4")]
pub struct PlanHeader {
    /// Identity of the plan, unique per planner, above 0.
    pub id: u64,
    /// Fingerprint of the model that the plan was made for.
    pub fingerprint: u64,
    /// Moment of t = 0, for which x_0 was predicted: ns on the daemon's clock, as `t_ns` of its telemetry. 0: the plan
    /// begins whenever it is started, because the robot stays at x_0.
    pub activation_ns: u64,
    /// Id of the running plan that this plan replaces at `activation_ns`; 0: the plan is started by a request.
    pub replaces: u64,
    /// t_F, duration, s, above 0.
    pub t_f: f64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// N, number of intervals.
    pub intervals: u64,
    /// XXH3 (64 bit) over all bytes of the header before this field, and those of the numbers.
    pub checksum: u64,
}

/// Number of words of a header.
const HEADER: usize = size_of::<PlanHeader>() / WORD;

const _: () = assert!(size_of::<PlanHeader>() == WORD * 9);
// The checksum covers all that lies before it, so it must be last.
const _: () = assert!(std::mem::offset_of!(PlanHeader, checksum) == size_of::<PlanHeader>() - WORD);

impl PlanHeader {
    /// The number of numbers that follow the header.
    ///
    /// # Errors
    /// [`DamagedPlan::Sizes`] if there is no such chain, or no such number of intervals.
    pub fn length(&self) -> Result<usize, DamagedPlan> {
        let (sizes, intervals) = self.sizes()?;
        Ok(PlanMessage::length(sizes, intervals))
    }

    /// Numbers of joints and N.
    fn sizes(&self) -> Result<(Sizes, usize), DamagedPlan> {
        let number = |word: u64| usize::try_from(word).unwrap_or(usize::MAX);
        let intervals = number(self.intervals);
        let sizes = Sizes::new(number(self.joints), number(self.actuated));
        sizes.filter(|_| INTERVALS.contains(&intervals)).map(|sizes| (sizes, intervals)).ok_or(
            DamagedPlan::Sizes { joints: self.joints, actuated: self.actuated, intervals: self.intervals },
        )
    }

    fn words(&self) -> [u64; HEADER] {
        // SAFETY: `repr(C)` of 8-byte numbers without padding (size assertion above); any bits are a valid `u64`.
        unsafe { std::mem::transmute(*self) }
    }

    fn from_words(words: [u64; HEADER]) -> Self {
        // SAFETY: as in `words`; any bits are a valid number of 8 bytes.
        unsafe { std::mem::transmute(words) }
    }
}

/// A trajectory xi with its gain schedule, planner -> daemon: a header and as many numbers as the plan has.
///
/// The numbers are, joints in the chain's order:
///
/// | number of numbers | |
/// |---|---|
/// | (N + 1) 2n | x_k = [q, qd], states at the knots, which are uniform over [0, t_F] |
/// | (N + 1) n_A | u_k, inputs at the knots |
/// | (N + 1) 2n | f_k = f(x_k, u_k), time derivative of the state at the knots |
/// | (N + 1) n_A 2n | K_k, feedback gains at the knots, u = u_d + K dx, by rows: 1/s^2 (positions) and 1/s (velocities) |
/// | n_A 2n | gain at the final equilibrium x_T, after t_F |
#[derive(Clone, Debug, PartialEq)]
pub struct PlanMessage {
    /// Sizes, identity and checksum.
    pub header: PlanHeader,
    /// The numbers.
    pub values: Vec<f64>,
}

impl PlanMessage {
    /// Number of numbers of a plan with N = `intervals`.
    pub const fn length(sizes: Sizes, intervals: usize) -> usize {
        (intervals + 1) * (2 * sizes.state() + sizes.actuated()) + Gains::entries(sizes, intervals)
    }

    /// The sealed message of a plan.
    pub fn new(plan: &Plan, order: &Order) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        let intervals = plan.trajectory.intervals();
        let mut values = Vec::with_capacity(Self::length(order.sizes(), intervals));
        plan.trajectory.x.iter().for_each(|x| values.extend(in_chain(order, x)));
        plan.trajectory.u.iter().for_each(|u| values.extend_from_slice(u));
        plan.f.iter().for_each(|f| values.extend(in_chain(order, f)));
        values.extend(in_chain(order, plan.gains.as_slice()));
        let header = PlanHeader {
            id: plan.id,
            fingerprint: plan.fingerprint,
            activation_ns: plan.activation_ns.unwrap_or(0),
            replaces: plan.replaces.unwrap_or(0),
            t_f: plan.trajectory.t_f,
            joints,
            actuated,
            intervals: intervals as u64,
            checksum: 0,
        };
        let mut message = Self { header, values };
        message.seal();
        message
    }

    /// The plan in a message, of which nothing else is checked.
    ///
    /// # Errors
    /// [`DamagedPlan`]
    pub fn plan(&self, order: &Order) -> Result<Plan, DamagedPlan> {
        let header = &self.header;
        let (sizes, intervals) = header.sizes()?;
        let (expected, got) = (Self::length(sizes, intervals), self.values.len());
        if got != expected {
            return Err(DamagedPlan::Length { expected, got });
        }
        if !self.is_intact() {
            return Err(DamagedPlan::Checksum { expected: header.checksum, got: self.checksum() });
        }
        chain::check("plan", (header.joints, header.actuated), order.sizes())?;
        if header.id == 0 {
            return Err(DamagedPlan::Id);
        }
        let knots = intervals + 1;
        let (x, rest) = self.values.split_at(knots * sizes.state());
        let (u, rest) = rest.split_at(knots * sizes.actuated());
        let (f, gains) = rest.split_at(knots * sizes.state());
        let input = |row: &[f64]| ActuatedVector::from_fn(sizes, |i| row[i]);
        let gains = Gains::from_slab(sizes, intervals, sorted(order, gains).collect());
        Ok(Plan {
            id: header.id,
            fingerprint: header.fingerprint,
            activation_ns: Some(header.activation_ns).filter(|ns| *ns != 0),
            replaces: Some(header.replaces).filter(|id| *id != 0),
            trajectory: Trajectory {
                t_f: header.t_f,
                x: states(order, x),
                u: u.chunks_exact(sizes.actuated()).map(input).collect(),
            },
            f: states(order, f),
            gains: gains.ok_or(DamagedPlan::Length { expected, got })?,
        })
    }

    /// The message in shared memory, which another process can change meanwhile: the header is a copy already.
    ///
    /// # Errors
    /// [`DamagedPlan::Sizes`], [`DamagedPlan::Length`]; then `values` are not read.
    pub(crate) fn copied(header: PlanHeader, values: &[f64]) -> Result<Self, DamagedPlan> {
        let (expected, got) = (header.length()?, values.len());
        if got != expected {
            return Err(DamagedPlan::Length { expected, got });
        }
        Ok(Self { header, values: values.to_vec() })
    }

    /// Header and numbers as plain words (numbers with a fraction: their bits), for files.
    pub fn words(&self) -> impl Iterator<Item = u64> {
        self.header.words().into_iter().chain(self.values.iter().map(|value| value.to_bits()))
    }

    /// The message that [`Self::words`] gave; `None` if there are fewer words than a header has.
    pub fn from_words(words: &[u64]) -> Option<Self> {
        let (header, values) = words.split_first_chunk()?;
        let values = values.iter().map(|bits| f64::from_bits(*bits)).collect();
        Some(Self { header: PlanHeader::from_words(*header), values })
    }

    /// The checksum that belongs to the contents; that in the header does not enter.
    pub fn checksum(&self) -> u64 {
        let mut hash = Xxh3::new();
        let header = self.header.words();
        header[..HEADER - 1].iter().for_each(|word| hash.update(&word.to_ne_bytes()));
        // SAFETY: the bytes of plain numbers, all of them initialized.
        hash.update(unsafe {
            std::slice::from_raw_parts(self.values.as_ptr().cast(), size_of_val(&self.values[..]))
        });
        hash.digest()
    }

    /// Sets the checksum to that of the contents.
    pub fn seal(&mut self) {
        self.header.checksum = self.checksum();
    }

    /// Whether the contents are those that were sealed.
    pub fn is_intact(&self) -> bool {
        self.header.checksum == self.checksum()
    }
}

/// Rows over the states, [q, qd] each, in the chain's order.
fn in_chain(order: &Order, rows: &[f64]) -> impl Iterator<Item = f64> {
    let halves = rows.chunks_exact(order.sizes().joints());
    halves.flat_map(|half| (0..half.len()).map(|joint| half[order.coordinate(joint)]))
}

/// Rows over the states in the chain's order, sorted.
fn sorted(order: &Order, rows: &[f64]) -> impl Iterator<Item = f64> {
    let halves = rows.chunks_exact(order.sizes().joints());
    halves.flat_map(|half| (0..half.len()).map(|c| half[order.joint(c)]))
}

/// The states in the chain's order, sorted.
fn states(order: &Order, values: &[f64]) -> Vec<State> {
    let sizes = order.sizes();
    let state = |row| {
        let mut x = State::zeros(sizes);
        x.iter_mut().zip(sorted(order, row)).for_each(|(to, value)| *to = value);
        x
    };
    values.chunks_exact(sizes.state()).map(state).collect()
}

/// Why a message is not a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DamagedPlan {
    /// There is no chain or no trajectory of the sizes in the header.
    #[error(
        "sizes: expected 2 to {MOST_JOINTS} joints, of which some but not all are actuated, and {} to {} intervals; got {joints} \
         joints, {actuated} of them actuated, and {intervals} intervals", INTERVALS.start(), INTERVALS.end()
    )]
    Sizes {
        /// Number of joints.
        joints: u64,
        /// Number of actuated joints.
        actuated: u64,
        /// Number of intervals.
        intervals: u64,
    },
    /// There are more or fewer numbers than the sizes in the header say.
    #[error("length: the header says {expected} numbers, got {got}")]
    Length {
        /// Number of numbers by the header.
        expected: usize,
        /// Number of numbers.
        got: usize,
    },
    /// The bytes are not those that the planner sealed.
    #[error("checksum: the plan names {expected:016x}, its contents give {got:016x}")]
    Checksum {
        /// The checksum in the message.
        expected: u64,
        /// The checksum of its contents.
        got: u64,
    },
    /// The plan is for another chain.
    #[error(transparent)]
    Chain(#[from] OtherChain),
    /// The id is 0, which means "no plan".
    #[error("id: expected one above 0")]
    Id,
}
