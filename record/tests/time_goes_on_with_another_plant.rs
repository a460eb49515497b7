//! The clock of each plant begins at 0. If a recording continues with another plant, no cycle is omitted, time continues,
//! and the summary is that of the new plant.

use upswing_config::Config;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::Posture;
use upswing_record::evaluation::MotionStatisticsCounter;
use upswing_record::{Recorder, Window, read};

/// Number of cycles of each plant: more than the last second, which the summary evaluates.
const CYCLES: u64 = 10_000;
const PERIOD_NS: u64 = 125_000;
const PERIOD: f64 = 125e-6;

/// Cycles of two plants in balance with different positions of the pendulum; the cycle numbers of the daemon continue.
fn cycles() -> Vec<Telemetry> {
    let cycle = |seq: u64| {
        let t_ns = (seq - 1) % CYCLES * PERIOD_NS;
        let mut t = Telemetry { seq, t_ns, joints: 9, actuated: 7, ..Telemetry::default() };
        t.mode = Mode::Balance.code();
        t.q[7] = if seq <= CYCLES { 1.0 } else { 0.5 };
        t
    };
    (1..=2 * CYCLES).map(cycle).collect()
}

#[test]
fn in_a_recording() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("run.mcap");
    let config = Config::embedded().expect("the settings load");
    let cycles = cycles();
    let mut recorder = Recorder::create(&path, &config, []).expect("the file is made");
    cycles.chunks(64).for_each(|batch| recorder.write(batch).expect("written"));
    let tally = recorder.finish().expect("finished");
    let total = 2.0 * (CYCLES - 1) as f64 * PERIOD;
    assert!((tally.seconds - total).abs() < 1e-9, "{} s", tally.seconds);
    assert_eq!((tally.cycles, tally.lost, tally.restarts), (2 * CYCLES, 0, 0));

    assert_eq!(read(&path, Window::ALL).expect("it reads").0, cycles);
    let half = Window { from: total / 2.0 - 0.5 * PERIOD, to: f64::INFINITY };
    // The last cycle of the old plant and the first cycle of the new plant have the same time.
    assert_eq!(read(&path, half).expect("it reads").0, cycles[CYCLES as usize - 1..]);
}

#[test]
fn in_the_figures() {
    let config = Config::embedded().expect("the settings load");
    let mut counter = MotionStatisticsCounter::new(Posture::Standing);
    let cycles = cycles();
    cycles.iter().for_each(|cycle| counter.count(&config.model, &config.robot.limits, cycle));
    let figures = counter.statistics(PERIOD, 0);
    let away = |cycle: &Telemetry| {
        let vectors = cycle.vectors(config.model.order()).expect("nine joints");
        (vectors.x.q_u() - vectors.x_d.q_u()).amax()
    };
    let away = [&cycles[0], &cycles[cycles.len() - 1]].map(away);
    assert!(away[0] > away[1], "{away:?}");
    assert!(
        (figures.motion.final_error_deg - away[1].to_degrees()).abs() < 1e-9,
        "{}",
        figures.motion.final_error_deg
    );
}
