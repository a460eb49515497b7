//! A mutated plan with a valid checksum is either refused by the daemon, or the robot tracks it from any tolerated start
//! and ends as planned.

mod common;

use common::{Arm, at_rest, config, message, rest_pose, resting, sizes, swing, upright_pose};
use std::collections::BTreeMap;
use std::ops::Range;
use upswing_config::Config;
use upswing_ipc::Mode;
use upswing_trajectory::Plan;
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

    /// A size from 10^`from` to 10^`to`, of any sign.
    fn size(&mut self, from: f64, to: f64) -> f64 {
        let sign = if self.below(2) == 0 { 1.0 } else { -1.0 };
        sign * 10_f64.powf(self.between(from, to))
    }
}

/// Scales the gains of some knots.
fn scale(plan: &mut Plan, knots: Range<usize>, factor: f64) {
    knots.for_each(|k| scale_all(plan.gains.knot_mut(k), factor));
}

fn scale_all(values: &mut [f64], factor: f64) {
    values.iter_mut().for_each(|v| *v *= factor);
}

/// Gives the knots the gains of other knots: that of knot `from(k)` to knot k.
fn reorder(plan: &mut Plan, from: impl Fn(usize) -> usize) {
    let gains = plan.gains.clone();
    all(plan).for_each(|k| plan.gains.knot_mut(k).copy_from_slice(gains.knot(from(k)).as_slice()));
}

/// All knots.
fn all(plan: &Plan) -> Range<usize> {
    0..plan.trajectory.x.len()
}

/// A run of knots of any length.
fn some(plan: &Plan, random: &mut Random) -> Range<usize> {
    let knots = all(plan).len();
    let first = random.below(knots);
    first..first + 1 + random.below(knots - first)
}

/// f_k of the model at every knot: nobody who wants to be believed forgets that.
fn follow_the_model(plan: &mut Plan, config: &Config) {
    plan.f = plan.trajectory.f(&config.model);
}

type Mutation = fn(&mut Plan, &mut Random);

const MUTATIONS: [(&str, Mutation); 16] = [
    ("gains of the opposite sign", |p, _| scale(p, all(p), -1.0)),
    ("gains of a few knots of the opposite sign", |p, r| scale(p, some(p, r), -1.0)),
    ("gains scaled", |p, r| scale(p, all(p), r.size(0.0, 8.0))),
    ("gains of a few knots scaled", |p, r| {
        let factor = r.size(-3.0, 6.0);
        scale(p, some(p, r), factor);
    }),
    ("gains of every other knot larger, of the others smaller", |p, r| {
        let by = r.between(0.0, 100.0);
        all(p).for_each(|k| scale(p, k..k + 1, if k % 2 == 0 { 1.0 + by } else { 1.0 - by }));
    }),
    ("one row of the gains", |p, r| {
        let (row, factor) = (r.below(sizes().actuated()), r.size(-1.0, 4.0));
        let of_row = row * sizes().state()..(row + 1) * sizes().state();
        all(p).for_each(|k| scale_all(&mut p.gains.knot_mut(k)[of_row.clone()], factor));
    }),
    ("one column of the gains", |p, r| {
        let (column, factor) = (r.below(sizes().state()), r.size(-1.0, 4.0));
        let scale_column = |row: &mut [f64]| row[column] *= factor;
        all(p).for_each(|k| p.gains.knot_mut(k).chunks_exact_mut(sizes().state()).for_each(scale_column));
    }),
    ("one number of a gain", |p, r| {
        let gain = p.gains.knot_mut(r.below(all(p).len()));
        gain[r.below(gain.len())] += r.size(0.0, 8.0);
    }),
    ("gains of other knots", |p, r| {
        let by = 1 + r.below(p.gains.intervals());
        let knots = all(p).len();
        reorder(p, |k| (k + by) % knots);
    }),
    ("gains backwards", |p, _| {
        let last = p.gains.intervals();
        reorder(p, |k| last - k);
    }),
    ("no gains", |p, _| scale(p, all(p), 0.0)),
    ("final gain scaled", |p, r| scale_all(p.gains.end_mut(), r.size(-3.0, 6.0))),
    ("one number of the final gain", |p, r| {
        let gain = p.gains.end_mut();
        gain[r.below(gain.len())] += r.size(0.0, 6.0);
    }),
    ("another duration", |p, r| p.trajectory.t_f *= r.size(-1.0, 1.0)),
    ("states elsewhere for a while", |p, r| {
        let (row, by) = (r.below(sizes().state()), r.size(-4.0, 0.0));
        some(p, r).for_each(|k| p.trajectory.x[k][row] += by);
    }),
    ("another input for a while", |p, r| {
        let (row, by) = (r.below(sizes().actuated()), r.size(-3.0, 2.0));
        some(p, r).for_each(|k| p.trajectory.u[k][row] += by);
    }),
];

/// The robot follows the plan from near its start, another one for each `number`, where its drives are far from their limits
/// with a good plan. The mode in which it ends.
fn fly(config: &Config, plan: &Plan, number: usize) -> Mode {
    let mut random = Random(number as u64);
    let plan = accept(&message(plan), config).expect("accepted before");
    let mut x = *plan.trajectory.start();
    for (q, tolerance) in x.q_mut().iter_mut().zip(config.daemon.start.position.iter()) {
        *q += random.between(-1.0, 1.0) * 0.1 * tolerance;
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
        (*up, Mode::Balance),
        (*down, Mode::Hold),
        (resting(&config, &at_rest(&rest_pose(&config)), 1.0), Mode::Hold),
        (resting(&config, &at_rest(&upright_pose()), 1.0), Mode::Balance),
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
        let mut mutant = plan.clone();
        mutate(&mut mutant, &mut random);
        follow_the_model(&mut mutant, &config);
        let [refused, accepted] = tally.entry(name).or_default();
        if accept(&message(&mutant), &config).is_err() {
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
