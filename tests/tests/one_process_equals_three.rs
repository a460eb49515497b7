//! Controller and plant coupled in one process, as in Monte Carlo runs, equal the three processes on the clock `lockstep`
//! bit for bit, in every number of every cycle of a swing-up and balance.

use upswing_config::{Config, PendulumStart};
use upswing_ipc::{Clock, Mode, Telemetry};
use upswing_model::ActuatedVector;
use upswing_planner::replan::Planner;
use upswing_plant::Plant;
use upswing_rig::closed_loop::{Disturbances, RunOptions, swing_up};
use upswing_tests::{System, same_bits};

const START_DEG: &[f64] = &[10.0, 10.0, 0.0, -100.0, 0.0, -20.0, 0.0];
/// Balance time, s.
const SECONDS: f64 = 2.0;

fn moving(records: Vec<Telemetry>) -> Vec<Telemetry> {
    records.into_iter().filter(|r| matches!(r.mode(), Ok(Mode::Track | Mode::Balance))).collect()
}

fn in_one_process() -> Vec<Telemetry> {
    let mut config = Config::embedded().expect("embedded settings");
    config.plant.start.q = ActuatedVector::from_fn(config.model.sizes(), |i| START_DEG[i].to_radians());
    config.plant.start.pendulum = PendulumStart::Rest;
    let plant = Plant::new(&config).expect("a start");
    let planner = Planner::new(config.clone()).expect("the shipped database fits");
    let mut records = Vec::new();
    let report = swing_up(
        &planner,
        &mut planner.solver(),
        &config,
        plant,
        SECONDS,
        |_| Disturbances::default(),
        RunOptions::default(),
        &mut records,
    );
    let report = report.unwrap_or_else(|e| panic!("{e}"));
    assert!(report.success, "{report}");
    moving(records)
}

#[test]
fn bit_for_bit() {
    let mut system = System::start(Clock::Lockstep, START_DEG);
    let report = system.swing_up(SECONDS);
    assert!(report.success, "{report}");
    let three = moving(std::mem::take(&mut system.session.records));
    let one = in_one_process();
    assert!(one.len() > 30_000, "only {} cycles", one.len());
    // The daemon may have run for a different number of cycles when the plan began, and the session may look away
    // before the last ones.
    for (a, b) in one.iter().zip(&three) {
        assert!(same_bits(a, b), "t = {} s:\n{a:?}\n{b:?}", a.t_plan);
    }
    assert!(three.len() + 2 >= one.len(), "{} and {} cycles", one.len(), three.len());
}
