//! The QPs of replans, whole replans, LQR syntheses; times of one thread.

use crate::qps::QpFile;
use crate::{config, print, starts};
use std::path::Path;
use std::time::{Duration, Instant};
use upswing_model::{State, Workspace};
use upswing_ocp::lqr;
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus};
use upswing_planner::offline::{lqr_recursion, lqr_weights, qp_weights, target};
use upswing_planner::replan::{Effort, Planner, Replan};

/// As in a replan (`planner/src/replan.rs`).
const OPTIONS: QpOptions<'_> = QpOptions {
    tolerance: 1e-9,
    complementarity: 1e-12,
    max_iterations: 100,
    deadline: None,
    cancelled: None,
};

/// Of the reference, Clarabel's solution: a tenth of the complementarity, so that its own error hardly counts.
const REFERENCE: QpOptions<'_> = QpOptions { complementarity: 1e-13, ..OPTIONS };

/// Duration of a computation.
#[derive(Clone, Copy)]
pub struct MeasuredTime {
    /// Of this thread.
    pub cpu: Duration,
    /// On the clock.
    pub wall: Duration,
}

/// `work`, timed.
fn timed<T>(work: impl FnOnce() -> T) -> (T, MeasuredTime) {
    let (cpu, wall) = (thread_cpu(), Instant::now());
    let result = work();
    let (wall, cpu) = (wall.elapsed(), thread_cpu() - cpu);
    (result, MeasuredTime { cpu, wall })
}

/// CPU time of this thread.
fn thread_cpu() -> Duration {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: plain system call that writes into `now`.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut now) };
    assert_eq!(status, 0, "CLOCK_THREAD_CPUTIME_ID");
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

fn print_both(name: &str, times: &[MeasuredTime]) {
    print(&format!("{name}, CPU"), times.iter().map(|t| t.cpu));
    print(&format!("{name}, wall"), times.iter().map(|t| t.wall));
}

/// Times everything from `count` starts and writes `qps.bin` into `folder`.
pub fn run(folder: &Path, count: u64) {
    let planner = Planner::new(config()).unwrap_or_else(|e| panic!("{e}"));
    let starts = starts(planner.config(), count);
    println!("{count} random starts, {} database entries", planner.entries(0));
    two_qps(&planner, &starts, folder);
    replans(&planner, &starts);
}

/// The first two QPs of each replan: the first one from cold, the second one from the multipliers of the first.
fn two_qps(planner: &Planner, starts: &[State], folder: &Path) {
    let (sizes, intervals) = (planner.config().model.sizes(), planner.config().planner.offline.intervals);
    let backends = [Backend::Structured, Backend::Clarabel];
    let mut solvers = backends.map(|backend| QpSolver::new(backend, sizes, intervals));
    let mut reference = QpSolver::new(Backend::Clarabel, sizes, intervals);
    let mut files = [QpFile::default(), QpFile::default()];
    let mut infeasible = 0;
    for start in starts {
        let nearest = planner.nearest(0, &[], start)[0];
        let entry = &planner.entry(0, nearest.index).expect("an entry").trajectory;
        let weights = qp_weights(&planner.config().planner.replan);
        let target = target(planner.config(), 0, &[]).expect("a target");
        let problem = planner.problem(target, start);
        let mut at = entry.clone();
        for (again, file) in files.iter_mut().enumerate() {
            let qp = Qp::new(&problem, entry, &at, &weights);
            let results = solvers.each_mut().map(|solver| {
                let (status, took) = timed(|| match again {
                    0 => solver.solve(&qp, &OPTIONS),
                    _ => solver.solve_again(&qp, &OPTIONS),
                });
                (status, took, solver.solution())
            });
            match results.each_ref().map(|(status, ..)| *status) {
                [QpStatus::Solved, QpStatus::Solved] => {}
                [QpStatus::Infeasible(_), QpStatus::Infeasible(_)] => {
                    infeasible += 1;
                    break;
                }
                other => panic!("the back ends do not agree: {other:?}"),
            }
            let status = reference.solve(&qp, &REFERENCE);
            assert_eq!(status, QpStatus::Solved, "the reference");
            file.push(&qp, results.map(|(_, took, solution)| (took, solution)), reference.solution());
            let solution = solvers[0].solution();
            at.t_f += solution.t;
            for (k, (x, u)) in at.x.iter_mut().zip(&mut at.u).enumerate() {
                *x += solution.z.x(k);
                *u += solution.z.u(k);
            }
        }
    }
    if infeasible > 0 {
        println!("{infeasible} QPs are infeasible and left out; a replan then takes the next entry");
    }
    for (name, file) in ["first.bin", "second.bin"].into_iter().zip(files) {
        let path = folder.join(name);
        std::fs::write(&path, file.bytes()).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    }
}

fn replans(planner: &Planner, starts: &[State]) {
    let config = planner.config();
    let mut solver = planner.solver();
    let mut times = Vec::new();
    let plans: Vec<Replan> = starts
        .iter()
        .map(|start| {
            let effort = Effort::iterations(config.planner.replan.iterations);
            let (replan, took) = timed(|| planner.replan_with(&mut solver, 0, &[], start, &effort));
            times.push(took);
            replan.unwrap_or_else(|e| panic!("{e}"))
        })
        .collect();
    print_both("whole replan", &times);
    print("  its linearisations and QPs, wall", plans.iter().map(|p| p.statistics.qp));
    print("  its checks, wall", plans.iter().map(|p| p.statistics.check));
    print("  its gains, wall", plans.iter().map(|p| p.statistics.lqr));
    let mut iterations: Vec<usize> = plans.iter().map(|p| p.iterations).collect();
    iterations.sort_unstable();
    println!(
        "linearisations: median {}, most {}",
        iterations[iterations.len() / 2],
        iterations.last().unwrap_or(&0)
    );

    let (weights, ts) =
        (lqr_weights(&config.planner, config.model.sizes()), config.daemon.cycle.period.seconds());
    let recursion = lqr_recursion(&config.planner);
    let mut work = Workspace::default();
    let times: Vec<MeasuredTime> = plans
        .iter()
        .map(|plan| {
            let (gains, took) = timed(|| {
                lqr::synthesize(&config.model, &plan.trajectory, &weights, ts, recursion, &mut work)
            });
            assert!(gains.is_ok(), "{gains:?}");
            took
        })
        .collect();
    print_both("LQR synthesis", &times);
    let mut steps: Vec<usize> = plans.iter().map(|p| (p.trajectory.t_f / ts) as usize).collect();
    steps.sort_unstable();
    println!("periods per synthesis: median {}", steps[steps.len() / 2]);
}
