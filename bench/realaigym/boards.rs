//! Simulations of the leaderboards.

use crate::machine::{A0, C0, C1, Condition, DT, Joints, Machine, Parameters};
use crate::pilot::Pilot;
use crate::scores::Motion;
use std::f64::consts::{PI, TAU};
use upswing_config::Config;
use upswing_rig::montecarlo::RandomStarts;

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

/// Version of a leaderboard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// Robustness only: some state has to be within 0.1 rad and 0.5 rad/s of the goal; no perturbations.
    One,
    /// The last state has to be within 0.35 rad and 1 rad/s of the goal.
    Two,
}

/// A leaderboard of one system.
pub struct Benchmark<'a> {
    pub config: &'a Config,
    pub version: Version,
    /// Largest torques, N m, shoulder and elbow.
    pub limits: Joints,
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

impl Benchmark<'_> {
    /// Random numbers in [0, 1) of simulation number `flight`.
    fn uniform(&self, flight: u64) -> impl Iterator<Item = f64> + use<> {
        RandomStarts { config: self.config, seed: self.seed }.shares(flight)
    }

    /// The undisturbed machine.
    pub fn nominal(&self) -> Condition {
        Condition::nominal(machine(self.version, &self.limits))
    }

    /// The motion of a simulation; in version 1 until the goal is reached.
    pub fn fly(&self, pilot: &Pilot<'_>, condition: Condition, flight: u64) -> Motion {
        let mut pilot = pilot.clone();
        let mut machine = Machine::new(condition, self.limits, self.uniform(flight));
        let mut motion = Motion { x: vec![*machine.state()], tau: Vec::new() };
        for _ in 0..STEPS {
            let measured = machine.measure();
            motion.tau.push(machine.step(&pilot.step(&measured)));
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

    /// The categories of the robustness score: name and share of the successes. Calls `report` with each varied quantity and whether each of
    /// its values succeeded, as soon as it is complete.
    pub fn robustness(&self, pilot: &Pilot<'_>, report: impl Fn(&str, &[bool])) -> Vec<(&'static str, f64)> {
        let share =
            |each: &[bool]| each.iter().filter(|success| **success).count() as f64 / each.len() as f64;
        let mut flights = 0;
        let mut succeeds = |condition: Condition| {
            flights += 1;
            self.reached(&self.fly(pilot, condition, flights))
        };
        let mut model = Vec::new();
        for (name, vary) in PARAMETERS {
            let each: Vec<bool> = values()
                .map(|share| {
                    let mut condition = self.nominal();
                    vary(&mut condition.parameters, share);
                    succeeds(condition)
                })
                .collect();
            report(name, &each);
            model.extend(each);
        }
        let mut categories = vec![("model", share(&model))];
        let mut add = |name, each: Vec<bool>| {
            report(name, &each);
            categories.push((name, share(&each)));
        };
        let mut most = |condition: Condition| {
            2 * (0..REPETITIONS).filter(|_| succeeds(condition.clone())).count() > REPETITIONS
        };
        let noise = |share: f64| Condition { velocity_noise: 0.5 * share, ..self.nominal() };
        add("velocity noise", values().map(|share| most(noise(share))).collect());
        let noise = |share: f64| Condition { torque_noise: 1.1 * share, ..self.nominal() };
        add("torque noise", values().map(|share| most(noise(share))).collect());
        let response = |share: f64| Condition { response: 0.1 + 1.9 * share, ..self.nominal() };
        add("torque response", values().map(|share| succeeds(response(share))).collect());
        let delay = |share: f64| Condition { delay: (0.04 * share / DT).round() as usize, ..self.nominal() };
        add("time delay", values().map(|share| succeeds(delay(share))).collect());
        if self.version == Version::Two {
            let perturbed = |number| {
                let perturbation = perturbation(self.uniform(PERTURBED + number));
                succeeds(Condition { perturbation, ..self.nominal() })
            };
            add("perturbations", (0..PERTURBATIONS).map(perturbed).collect());
        }
        categories
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
