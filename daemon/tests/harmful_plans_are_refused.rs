//! A mutated plan with a valid checksum is either refused by the daemon, or the robot tracks it from any tolerated start
//! and ends as planned.

mod common;

use common::{Arm, at_rest, config, rest_payload, rest_pose, swing, upright_pose};
use std::collections::BTreeMap;
use upswing_config::Config;
use upswing_ipc::{Mode, PlanMessage};
use upswing_model::{ActuatedVector, NQ, NU, NX, State, Workspace};
use upswing_trajectory::{KNOTS, N};
use upswingd::controller::Controller;
use upswingd::plan::accept;
use upswingd::step::{StepInput, StepRequest};

/// Uniform numbers, the same in every run (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A run of knots of any length.
    fn knots(&mut self) -> std::ops::Range<usize> {
        let first = self.below(KNOTS);
        first..first + 1 + self.below(KNOTS - first)
    }

    /// A size from 10^`from` to 10^`to`, of any sign.
    fn size(&mut self, from: f64, to: f64) -> f64 {
        let sign = if self.below(2) == 0 { 1.0 } else { -1.0 };
        sign * 10_f64.powf(self.between(from, to))
    }
}

fn scale(gain: &mut [[f64; NX]; NU], factor: f64) {
    gain.as_flattened_mut().iter_mut().for_each(|v| *v *= factor);
}

/// f_k of the model at every knot: nobody who wants to be believed forgets that.
fn follow_the_model(plan: &mut PlanMessage, config: &Config) {
    let mut work = Workspace::default();
    for k in 0..KNOTS {
        let (x, u) = (State::from(plan.x[k]), ActuatedVector::from(plan.u[k]));
        plan.f[k] = config.model.f(&x, &u, &mut work).into();
    }
}

type Mutation = fn(&mut PlanMessage, &mut Random);

const MUTATIONS: [(&str, Mutation); 16] = [
    ("gains of the opposite sign", |p, _| p.k.iter_mut().for_each(|k| scale(k, -1.0))),
    ("gains of a few knots of the opposite sign", |p, r| {
        p.k[r.knots()].iter_mut().for_each(|k| scale(k, -1.0));
    }),
    ("gains scaled", |p, r| {
        let factor = r.size(0.0, 8.0);
        p.k.iter_mut().for_each(|k| scale(k, factor));
    }),
    ("gains of a few knots scaled", |p, r| {
        let factor = r.size(-3.0, 6.0);
        p.k[r.knots()].iter_mut().for_each(|k| scale(k, factor));
    }),
    ("gains of every other knot larger, of the others smaller", |p, r| {
        let by = r.between(0.0, 100.0);
        p.k.iter_mut().enumerate().for_each(|(i, k)| scale(k, if i % 2 == 0 { 1.0 + by } else { 1.0 - by }));
    }),
    ("one row of the gains", |p, r| {
        let (row, factor) = (r.below(NU), r.size(-1.0, 4.0));
        p.k.iter_mut().for_each(|k| k[row].iter_mut().for_each(|v| *v *= factor));
    }),
    ("one column of the gains", |p, r| {
        let (column, factor) = (r.below(NX), r.size(-1.0, 4.0));
        p.k.iter_mut().for_each(|k| k.iter_mut().for_each(|row| row[column] *= factor));
    }),
    ("one number of a gain", |p, r| p.k[r.below(KNOTS)][r.below(NU)][r.below(NX)] += r.size(0.0, 8.0)),
    ("gains of other knots", |p, r| p.k.rotate_left(1 + r.below(N))),
    ("gains backwards", |p, _| p.k.reverse()),
    ("no gains", |p, _| p.k.iter_mut().for_each(|k| scale(k, 0.0))),
    ("final gain scaled", |p, r| scale(&mut p.k_final, r.size(-3.0, 6.0))),
    ("one number of the final gain", |p, r| p.k_final[r.below(NU)][r.below(NX)] += r.size(0.0, 6.0)),
    ("another duration", |p, r| p.t_f *= r.size(-1.0, 1.0)),
    ("states elsewhere for a while", |p, r| {
        let (row, by) = (r.below(NX), r.size(-4.0, 0.0));
        p.x[r.knots()].iter_mut().for_each(|x| x[row] += by);
    }),
    ("another input for a while", |p, r| {
        let (row, by) = (r.below(NU), r.size(-3.0, 2.0));
        p.u[r.knots()].iter_mut().for_each(|u| u[row] += by);
    }),
];

/// The robot follows the plan from near its start, another one for each `number`, where its drives are far from their limits
/// with a good plan. The mode in which it ends.
fn fly(config: &Config, plan: &PlanMessage, number: usize) -> Mode {
    let mut random = Random(number as u64);
    let plan = accept(plan, config).expect("accepted before");
    let mut x = plan.trajectory.x[0];
    for i in 0..NQ {
        x[i] += random.between(-1.0, 1.0) * 0.1 * config.daemon.start.position;
    }
    let cycles = ((plan.trajectory.t_f + 0.5) / common::PERIOD) as usize;
    let (mut controller, mut arm) = (Controller::new(config), Arm::new(config, x));
    let mut requests = vec![StepRequest::Start(plan.id), StepRequest::Load(plan), StepRequest::Enable];
    for _ in 0..cycles {
        let output = controller.step(StepInput::new(arm.measure(), 0, requests.pop()));
        if let Some(answer) = output.answer {
            answer.expect("tolerated");
        }
        arm.advance(&output.command);
    }
    controller.mode()
}

#[test]
fn three_thousand_of_them() {
    /// Flights per kind of mutation.
    const FLIGHTS: usize = 4;
    let config = config();
    let (up, down) = swing(&config, &rest_pose(&config));
    let plans = [
        (Box::from(&*up), Mode::Balance),
        (Box::from(&*down), Mode::Hold),
        (rest_payload(&config, &at_rest(&rest_pose(&config)), 1.0), Mode::Hold),
        (rest_payload(&config, &at_rest(&upright_pose()), 1.0), Mode::Balance),
    ];
    for (plan, end) in &plans {
        assert_eq!(fly(&config, plan, 0), *end, "without a mutation");
    }
    let mut random = Random(1);
    // Refused, accepted.
    let mut tally: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
    for number in 0..3000 {
        let (name, mutate) = MUTATIONS[number % MUTATIONS.len()];
        let (plan, end) = &plans[number / MUTATIONS.len() % plans.len()];
        let mut mutant = plan.boxed_copy();
        mutate(&mut mutant, &mut random);
        follow_the_model(&mut mutant, &config);
        mutant.seal();
        let [refused, accepted] = tally.entry(name).or_default();
        if accept(&mutant, &config).is_err() {
            *refused += 1;
            continue;
        }
        *accepted += 1;
        if *accepted <= FLIGHTS {
            assert_eq!(fly(&config, &mutant, number), *end, "{name}, mutant {number}");
        }
    }
    println!("refused, accepted: {tally:?}");
    assert_eq!(tally["gains of the opposite sign"][1], 0);
    // Of the rest, gains that nobody uses or that hold an arm which nothing disturbs are harmless.
    let refused: usize = tally.values().map(|[refused, _]| refused).sum();
    assert!(refused > 1500, "{tally:?}");
}
