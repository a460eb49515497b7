//! Simulations of the leaderboards.

use super::DoublePendulum;
use super::machine::{A0, C0, C1, Condition, DT, Joints, Machine, Parameters, State};
use super::scores::Motion;
use crate::montecarlo::RandomStarts;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::sync::atomic::{AtomicBool, Ordering};

/// Steps of a simulation: 10 s.
const STEPS: usize = 5000;
/// Values of each varied quantity.
const VALUES: usize = 21;
/// Simulations of each value of a noise; more than half of them have to succeed.
const REPETITIONS: usize = 10;
/// Simulations with random perturbations.
const PERTURBATIONS: u64 = 50;
/// First number of the random sequences of perturbations, beyond those of the simulations.
const PERTURBED: u64 = 1_000_000;
/// Number of the random sequence of the resets of the uptime board.
const RESETS: u64 = 2_000_000;
/// Duration of the simulation of the uptime board, s.
pub const UPTIME: f64 = 60.0;

/// Version of a leaderboard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// Robustness only: some state has to be within 0.1 rad and 0.5 rad/s of the goal; no perturbations.
    One,
    /// The last state has to be within 0.35 rad and 1 rad/s of the goal. Uptime, of version 3, has this machine, too.
    Two,
}

/// A controller during one simulation: measured state in, torques out (N m, shoulder and elbow), every [`DT`].
pub type Controller<'a> = dyn FnMut(&State) -> Joints + 'a;

/// A leaderboard of one system.
pub struct Benchmark<'a> {
    /// The system.
    pub pendulum: &'a DoublePendulum,
    /// Version of the leaderboard.
    pub version: Version,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// The machine of a version, for a system that drives the shoulder or the elbow.
pub fn machine(version: Version, limits: &Joints) -> Parameters {
    match (version, limits[0] > 0.0) {
        (Version::Two, _) => C1,
        (Version::One, false) => C0,
        (Version::One, true) => A0,
    }
}

/// Simulations of one varied quantity of the robustness score.
struct Varied {
    category: &'static str,
    name: &'static str,
    /// One for each value.
    conditions: Vec<Condition>,
    /// Simulations of each value, of which more than half have to succeed.
    repetitions: usize,
}

/// A varied quantity of the robustness score, and whether each of its values succeeded.
#[derive(Clone, Debug, Serialize)]
pub struct Category {
    /// Category of the score.
    pub category: &'static str,
    /// Name of the quantity.
    pub name: &'static str,
    /// Whether each value succeeded.
    pub succeeded: Vec<bool>,
}

/// Result of the robustness board.
#[derive(Clone, Debug, Serialize)]
pub struct Robustness {
    /// The varied quantities.
    pub quantities: Vec<Category>,
}

impl Robustness {
    /// Names of the categories of the score and the share of the successes in each.
    pub fn categories(&self) -> Vec<(&'static str, f64)> {
        let mut categories: Vec<(&'static str, Vec<bool>)> = Vec::new();
        for quantity in &self.quantities {
            match categories.last_mut() {
                Some((name, all)) if *name == quantity.category => all.extend(&quantity.succeeded),
                _ => categories.push((quantity.category, quantity.succeeded.clone())),
            }
        }
        let share =
            |each: &[bool]| each.iter().filter(|success| **success).count() as f64 / each.len() as f64;
        categories.into_iter().map(|(name, each)| (name, share(&each))).collect()
    }

    /// The score, in [0, 1]: the mean of the categories.
    pub fn score(&self) -> f64 {
        let categories = self.categories();
        categories.iter().map(|(_, share)| share).sum::<f64>() / categories.len() as f64
    }
}

/// Result of the uptime board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Uptime {
    /// Time that the tip was above the line, s.
    pub uptime: f64,
    /// Number of times that it rose above the line.
    pub swing_ups: usize,
}

impl Uptime {
    /// The score, in [0, 1].
    pub fn score(&self) -> f64 {
        self.uptime / UPTIME
    }
}

impl Benchmark<'_> {
    /// Random numbers in [0, 1) of simulation number `flight`.
    fn uniform(&self, flight: u64) -> impl Iterator<Item = f64> + use<> {
        RandomStarts { config: &self.pendulum.config, seed: self.seed }.shares(flight)
    }

    /// The undisturbed machine.
    pub fn nominal(&self) -> Condition {
        Condition::nominal(machine(self.version, &self.pendulum.limits))
    }

    /// The motion of a simulation; in version 1 until the goal is reached.
    pub fn fly(&self, controller: &mut Controller<'_>, condition: Condition, flight: u64) -> Motion {
        let mut machine = Machine::new(condition, self.pendulum.limits, self.uniform(flight));
        let mut motion = Motion { x: vec![*machine.state()], tau: Vec::new() };
        for _ in 0..STEPS {
            let measured = machine.measure();
            motion.tau.push(machine.step(&controller(&measured)));
            motion.x.push(*machine.state());
            if self.version == Version::One && self.reached(&motion) {
                break;
            }
        }
        motion
    }

    /// Whether the last state of a motion is near the goal.
    fn reached(&self, motion: &Motion) -> bool {
        let (angle, speed) = if self.version == Version::One { (0.1, 0.5) } else { (0.35, 1.0) };
        motion.x.last().is_some_and(|[q1, q2, v1, v2]| {
            let shoulder = q1.rem_euclid(TAU) - PI;
            let elbow = (q2 + PI).rem_euclid(TAU) - PI;
            shoulder.abs() < angle && elbow.abs() < angle && v1.abs() < speed && v2.abs() < speed
        })
    }

    /// The simulations of the robustness score.
    fn varied(&self) -> Vec<Varied> {
        let model = PARAMETERS.into_iter().map(|(name, vary)| {
            let condition = |share| {
                let mut condition = self.nominal();
                vary(&mut condition.parameters, share);
                condition
            };
            Varied { category: "model", name, conditions: values().map(condition).collect(), repetitions: 1 }
        });
        let each = |name, repetitions, condition: &dyn Fn(f64) -> Condition| Varied {
            category: name,
            name,
            conditions: values().map(condition).collect(),
            repetitions,
        };
        let nominal = || self.nominal();
        let mut all: Vec<Varied> = model.collect();
        all.extend([
            each("velocity noise", REPETITIONS, &|share| Condition {
                velocity_noise: 0.5 * share,
                ..nominal()
            }),
            each("torque noise", REPETITIONS, &|share| Condition { torque_noise: 1.1 * share, ..nominal() }),
            each("torque response", 1, &|share| Condition { response: 0.1 + 1.9 * share, ..nominal() }),
            each("time delay", 1, &|share| Condition {
                delay: (0.04 * share / DT).round() as usize,
                ..nominal()
            }),
        ]);
        if self.version == Version::Two {
            let perturbed = |number| {
                let perturbation = perturbation(self.uniform(PERTURBED + number));
                Condition { perturbation, ..nominal() }
            };
            let (name, conditions) = ("perturbations", (0..PERTURBATIONS).map(perturbed).collect());
            all.push(Varied { category: name, name, conditions, repetitions: 1 });
        }
        all
    }

    /// Number of simulations of the robustness score.
    pub fn simulations(&self) -> usize {
        self.varied().iter().map(|varied| varied.conditions.len() * varied.repetitions).sum()
    }

    /// The robustness board on all cores, with a new controller for each simulation. `progress` is called after each simulation; setting `stop`
    /// skips the others, and the result is `None`.
    pub fn robustness<'c>(
        &self,
        controller: &(dyn Fn() -> Box<Controller<'c>> + Sync),
        stop: &AtomicBool,
        progress: &(dyn Fn() + Sync),
    ) -> Option<Robustness> {
        let varied = self.varied();
        // In the order of the quantities, counted from 1.
        let conditions = varied.iter().flat_map(|varied| {
            varied.conditions.iter().flat_map(|condition| std::iter::repeat_n(condition, varied.repetitions))
        });
        let flights: Vec<(u64, &Condition)> = (1..).zip(conditions).collect();
        let succeeds = |(flight, condition): &(u64, &Condition)| {
            if stop.load(Ordering::Acquire) {
                return None;
            }
            let motion = self.fly(&mut *controller(), (*condition).clone(), *flight);
            progress();
            Some(self.reached(&motion))
        };
        let succeeded: Vec<bool> = flights.par_iter().map(succeeds).collect::<Option<_>>()?;
        let mut left = &succeeded[..];
        let quantities = varied.into_iter().map(|Varied { category, name, conditions, repetitions }| {
            let (own, rest) = left.split_at(conditions.len() * repetitions);
            left = rest;
            let most = |each: &[bool]| 2 * each.iter().filter(|success| **success).count() > repetitions;
            Category { category, name, succeeded: own.chunks_exact(repetitions).map(most).collect() }
        });
        Some(Robustness { quantities: quantities.collect() })
    }

    /// The uptime board: 60 s, in which at 15 random times a controller of the benchmark drives both joints to a random pose for 0.2 s, while `controller` is
    /// not asked.
    pub fn uptime(&self, controller: &mut Controller<'_>) -> (Uptime, Motion) {
        let parameters = machine(self.version, &self.pendulum.limits);
        // The controller of the resets has a motor on both joints.
        let mut machine = Machine::new(Condition::nominal(parameters), [Resets::TORQUE; 2], self.uniform(0));
        let mut resets = Resets::new(self.uniform(RESETS));
        let mut motion = Motion { x: vec![*machine.state()], tau: Vec::new() };
        let (mut above, mut swing_ups, mut was_up) = (0, 0, false);
        for step in 0..(UPTIME / DT).round() as usize {
            let x = machine.measure();
            let tau = match resets.torque(step as f64 * DT, &x, &parameters) {
                Some(tau) => tau,
                None => {
                    let (tau, limits) = (controller(&x), self.pendulum.limits);
                    [0, 1].map(|i| tau[i].clamp(-limits[i], limits[i]))
                }
            };
            motion.tau.push(machine.step(&tau));
            motion.x.push(*machine.state());
            let up = parameters.upright(machine.state());
            above += usize::from(up);
            swing_ups += usize::from(up && !was_up);
            was_up = up;
        }
        (Uptime { uptime: above as f64 * DT, swing_ups }, motion)
    }
}

/// The resets of the uptime board: a PID controller of both joints that takes over at random times.
struct Resets {
    /// When each begins, s.
    times: Vec<f64>,
    /// Where each drives the joints to, rad.
    poses: Vec<Joints>,
    /// Number of the next one.
    next: usize,
    /// When the present one ends, s; in the past without one.
    until: f64,
    /// Sums of all errors, and the last ones.
    errors: Joints,
    last: Option<Joints>,
}

impl Resets {
    const COUNT: usize = 15;
    /// s
    const LENGTH: f64 = 0.2;
    /// N m
    const TORQUE: f64 = 6.0;
    /// Gains: N m/rad, N m/(rad s), N m s/rad, the latter two with the control period that the benchmark leaves in its controller, s.
    const GAINS: [f64; 3] = [10.0, 0.1, 1.0];
    const PERIOD: f64 = 0.001;

    fn new(mut uniform: impl Iterator<Item = f64>) -> Self {
        let mut between = |from: f64, to: f64| from + (to - from) * uniform.next().unwrap_or_default();
        let poses = (0..Self::COUNT).map(|_| [between(-PI, PI), between(-PI, PI)]).collect();
        let apart = UPTIME / (Self::COUNT + 1) as f64;
        let times = (1..=Self::COUNT).map(|k| apart * k as f64 + between(-1.0, 1.0)).collect();
        Self { times, poses, next: 0, until: f64::NEG_INFINITY, errors: [0.0; 2], last: None }
    }

    /// The torques during a reset, N m, that also carry the weight.
    fn torque(&mut self, t: f64, x: &State, parameters: &Parameters) -> Option<Joints> {
        if t > self.until && self.times.get(self.next).is_some_and(|begin| t >= *begin) {
            self.next += 1;
            self.until = t + Self::LENGTH;
        }
        if t > self.until {
            return None;
        }
        let pose = self.poses.get(self.next.checked_sub(1)?)?;
        let error = [pose[0] - x[0], pose[1] - x[1]];
        let rate = self.last.map_or([0.0; 2], |last| [0, 1].map(|i| (error[i] - last[i]) / Self::PERIOD));
        let gravity = parameters.gravity(x);
        let [p, i_, d] = Self::GAINS;
        self.errors = [0, 1].map(|i| self.errors[i] + error[i] * Self::PERIOD);
        self.last = Some(error);
        Some([0, 1].map(|i| {
            let pid = p * error[i] + i_ * self.errors[i] + d * rate[i];
            pid.clamp(-Self::TORQUE, Self::TORQUE) + gravity[i]
        }))
    }
}

/// The values of a varied quantity, as shares of its range.
fn values() -> impl Iterator<Item = f64> {
    (0..VALUES).map(|n| n as f64 / (VALUES - 1) as f64)
}

type Vary = fn(&mut Parameters, f64);

/// The parameters of the category `model`, and how each depends on the share of its range.
const PARAMETERS: [(&str, Vary); 10] = [
    ("Ir", |p, share| p.ir = 1e-4 * share),
    ("m1 r1", |p, share| p.r[0] *= quarter(share)),
    ("I1", |p, share| p.i[0] *= quarter(share)),
    ("b1", |p, share| p.b[0] = 0.1 * (2.0 * share - 1.0)),
    ("cf1", |p, share| p.cf[0] = 0.2 * (2.0 * share - 1.0)),
    ("m2 r2", |p, share| p.r[1] *= quarter(share)),
    ("m2", |p, share| p.m[1] *= quarter(share)),
    ("I2", |p, share| p.i[1] *= quarter(share)),
    ("b2", |p, share| p.b[1] = 0.1 * (2.0 * share - 1.0)),
    ("cf2", |p, share| p.cf[1] = 0.2 * (2.0 * share - 1.0)),
];

/// A factor from 0.75 to 1.25.
fn quarter(share: f64) -> f64 {
    0.75 + 0.5 * share
}

/// Three bell-shaped torques on each joint, in a random order, at random times at least a second apart.
fn perturbation(mut uniform: impl Iterator<Item = f64>) -> Vec<Joints> {
    const EACH: usize = 3;
    const APART: f64 = 1.0;
    let mut uniform = move || uniform.next().unwrap_or_default();
    let count = 2 * EACH;
    let room = (STEPS as f64 * DT - (count + 1) as f64 * APART) / count as f64;
    let mut time = 0.0;
    let mut times: Vec<f64> = (0..count)
        .map(|_| {
            time += APART + room * uniform();
            time
        })
        .collect();
    for last in (1..count).rev() {
        times.swap(last, (uniform() * (last + 1) as f64) as usize);
    }
    let bells: Vec<(usize, f64, f64, f64)> = (0..count)
        .map(|n| {
            let width = 0.05 + 0.05 * uniform();
            let size = 4.5 * (2.0 * uniform() - 1.0);
            (n / EACH, times[n], width, size + 0.5 * size.signum())
        })
        .collect();
    let torque = |t: f64, joint: usize| -> f64 {
        let of_joint = bells.iter().filter(|(of, ..)| *of == joint);
        of_joint.map(|(_, time, width, size)| size * (-((t - time) / width).powi(2) / 2.0).exp()).sum()
    };
    (0..STEPS).map(|k| [0, 1].map(|joint| torque(k as f64 * DT, joint))).collect()
}
