//! Scores of a recorded motion, by the definitions of the leaderboards.

use super::machine::{DT, Joints, Parameters, State};
use serde::Serialize;
use std::f64::consts::PI;
use std::fmt::Write as _;

/// A motion: the states before each step and after the last one, and the torques in each step.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// rad and rad/s
    pub x: Vec<State>,
    /// N m
    pub tau: Vec<Joints>,
}

/// Criteria and score of the performance leaderboard, version 2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Performance {
    /// Whether the tip stays above the line in the end.
    pub success: bool,
    /// Time from which on the tip stays above the line, s.
    pub time: f64,
    /// Mechanical energy: sum of |tau dq|, J.
    pub energy: f64,
    /// Integral of tau^2, N^2 m^2 s.
    pub cost: f64,
    /// Standard deviation of the changes of the torque, N m.
    pub smoothness: f64,
    /// Integral of qd^2, rad^2/s.
    pub velocity: f64,
}

impl Performance {
    /// The criteria of a motion.
    pub fn of(motion: &Motion, machine: &Parameters) -> Self {
        let Motion { x, tau } = motion;
        // The leaderboards leave out the state after the last step.
        let last = tau.len() - 1;
        // Neither the first nor the last state is asked for.
        let below = (1..last).rev().find(|k| !machine.upright(&x[*k]));
        let begin = below.map_or(1, |below| below + 1);
        let sum =
            |f: &dyn Fn(usize, usize) -> f64| -> f64 { (0..last).flat_map(|k| [f(k, 0), f(k, 1)]).sum() };
        let deviation = |i: usize| {
            let changes: Vec<f64> = tau.windows(2).map(|pair| pair[1][i] - pair[0][i]).collect();
            let n = changes.len() as f64;
            let mean = changes.iter().sum::<f64>() / n;
            (changes.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / n).sqrt()
        };
        Self {
            success: begin < last,
            time: begin as f64 * DT,
            energy: sum(&|k, i| (tau[k][i] * (x[k + 1][i] - x[k][i])).abs()),
            cost: sum(&|k, i| tau[k][i].powi(2) * DT),
            smoothness: deviation(0) + deviation(1),
            velocity: sum(&|k, i| x[k][2 + i].powi(2) * DT),
        }
    }

    /// The score, in [0, 1].
    pub fn score(&self) -> f64 {
        let shares = [
            self.time / 20.0,
            self.energy / 60.0,
            self.cost / 20.0,
            self.smoothness / 0.1,
            self.velocity / 400.0,
        ];
        let lost = shares.map(|share| (PI * share).tanh()).iter().sum::<f64>() / shares.len() as f64;
        if self.success { 1.0 - lost } else { 0.0 }
    }
}

/// The motion as a file that the leaderboards' own scripts read.
pub fn csv(motion: &Motion) -> String {
    let mut text = "time,pos_meas1,pos_meas2,vel_meas1,vel_meas2,tau_con1,tau_con2\n".to_owned();
    for (k, (x, tau)) in motion.x.iter().zip(&motion.tau).enumerate() {
        let [q1, q2, v1, v2] = x;
        // A String takes everything.
        let _ = writeln!(text, "{},{q1},{q2},{v1},{v2},{},{}", k as f64 * DT, tau[0], tau[1]);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::Performance;

    /// Rows of the leaderboards of version 2 on 2026-11-29: time, energy, torque cost, smoothness, velocity cost, score.
    const PUBLISHED: [[f64; 6]; 5] = [
        [1.39, 8.32, 1.52, 0.008, 117.96, 0.633],
        [1.0, 8.08, 1.8, 0.01, 88.5, 0.655],
        [4.05, 10.43, 1.87, 0.016, 105.83, 0.504],
        [1.15, 7.67, 2.36, 0.007, 62.07, 0.682],
        [0.71, 9.83, 4.37, 0.014, 58.15, 0.596],
    ];

    #[test]
    fn published_criteria_have_the_published_scores() {
        for [time, energy, cost, smoothness, velocity, expected] in PUBLISHED {
            let figures = Performance { success: true, time, energy, cost, smoothness, velocity };
            // The smoothness is rounded to 0.0005 of 0.1, which is 0.0032 of the score, the score to 0.0005.
            assert!((figures.score() - expected).abs() < 0.004, "{figures:?}: {}", figures.score());
            assert_eq!(Performance { success: false, ..figures }.score(), 0.0);
        }
    }
}
