//! Times one control cycle and the torque law (24); `bench/cycle/run` calls it.
//!
//! - `cycle`: a swing-up in closed loop with the plant's equations; timed from reading the measurement out of shared
//!   memory to the command in shared memory, each cycle by itself.
//! - `law`: the torque law at random states, in blocks; with `--states FILE` the numbers of joints, then states, inputs and
//!   torques go to a file of doubles for a peer.

#[path = "../../daemon/tests/common/mod.rs"]
mod common;

use common::{Arm, at_rest, config, rest_pose, swing};
use std::hint::black_box;
use std::time::Instant;
use upswing_config::Config;
use upswing_ipc::{Command, Measurement, Mode, TempDomain};
use upswing_model::{ActuatedVector, State, Workspace};
use upswingd::controller::Controller;
use upswingd::step::{StepInput, StepRequest};

/// Swing-ups, about 17 000 cycles each.
const SWINGS: usize = 12;
/// Random states, calls per block and blocks of the torque law.
const STATES: usize = 256;
const ROUNDS: usize = 4;
const BLOCKS: usize = 2000;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let states = match arguments.as_slice() {
        [] => None,
        [option, file] if option == "--states" => Some(file),
        _ => {
            eprintln!("error: expected nothing or --states FILE, got {arguments:?}");
            std::process::exit(2);
        }
    };
    let config = config();
    print("cycle, read to write, Track", cycles(&config));
    print("torque law (24)", law(&config, states.map(String::as_str)));
}

/// Prints percentiles of times in ns.
fn print(name: &str, mut ns: Vec<f64>) {
    ns.sort_by(f64::total_cmp);
    let at = |share: f64| ns[((share * ns.len() as f64) as usize).min(ns.len() - 1)] * 1e-3;
    println!(
        "{name:<28} p50 {:.3} us, p99 {:.3} us, p99.9 {:.3} us, max {:.3} us ({} samples)",
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0),
        ns.len()
    );
}

fn cycles(config: &Config) -> Vec<f64> {
    let domain = TempDomain::new("bench").expect("valid domain");
    let node = domain.join("bench").expect("shared memory");
    let (measurements, commands) =
        (node.writer::<Measurement>().expect("writer"), node.writer::<Command>().expect("writer"));
    let reader = node.finder::<Measurement>().poll().expect("shared memory").expect("the writer above");
    let q = rest_pose(config);
    let (plan, _) = swing(config, &q);
    let mut times = Vec::new();
    for _ in 0..SWINGS {
        let (mut controller, mut arm) = (Controller::new(config), Arm::new(config, at_rest(&q)));
        let mut requests =
            [StepRequest::Enable, StepRequest::Load(plan.clone()), StepRequest::Start(plan.id)].into_iter();
        loop {
            measurements.write(arm.measure());
            let request = requests.next();
            let begin = Instant::now();
            let output = controller.step(StepInput::new(reader.read(), 0, request));
            commands.write(output.command);
            let time = begin.elapsed();
            arm.advance(&output.command);
            match controller.mode() {
                Mode::Track => times.push(time.as_nanos() as f64),
                Mode::Hold => {}
                Mode::Balance => break,
                mode => panic!("{mode}: {:?}", controller.trip()),
            }
        }
    }
    times
}

fn law(config: &Config, file: Option<&str>) -> Vec<f64> {
    let limits = &config.robot.limits;
    let mut random = random();
    let samples: Vec<(State, ActuatedVector)> = (0..STATES)
        .map(|_| {
            let x = State::new(&limits.q_max.map(|q| q * random()), &limits.qd_max.map(|qd| qd * random()));
            (x, ActuatedVector::from_fn(x.sizes(), |_| 10.0 * random()))
        })
        .collect();
    let mut work = Workspace::default();
    if let Some(file) = file {
        let sizes = config.model.sizes();
        let mut bytes = [sizes.joints(), sizes.actuated()].map(|n| (n as f64).to_le_bytes()).concat();
        for (x, u) in &samples {
            let tau = config.model.torque(x, u, &mut work);
            bytes.extend(x.iter().chain(u.iter()).chain(tau.iter()).flat_map(|v| v.to_le_bytes()));
        }
        std::fs::write(file, bytes).unwrap_or_else(|e| panic!("{file}: {e}"));
    }
    let calls = (STATES * ROUNDS) as f64;
    (0..BLOCKS)
        .map(|_| {
            let begin = Instant::now();
            for _ in 0..ROUNDS {
                for (x, u) in &samples {
                    black_box(config.model.torque(black_box(x), black_box(u), &mut work));
                }
            }
            begin.elapsed().as_nanos() as f64 / calls
        })
        .collect()
}

/// Numbers in [-1, 1) that are the same in each run (splitmix64).
fn random() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}
