//! Times the stage-wise numerics for chains of several sizes; `bench/stages/run` calls it.
//!
//! For each chain of links that hang from the first joint: one factorisation, one iteration of a QP, and one period of the recursion (23).
//! Sizes that the compiler knows are marked. CPU times of one thread, the sizes in turns, medians: only ratios of one run count.

mod chain;

use chain::{Chain, DURATION, cpu_us};
use std::hint::black_box;
use upswing_model::{State, Workspace};
use upswing_ocp::kkt::{Factor, Kkt};
use upswing_ocp::lqr::{self, LqrWeights, Recursion};
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus};

/// Joints and actuated joints of the chains, and whether the numerics are compiled for them.
const CHAINS: [(usize, usize, bool); 6] =
    [(2, 1, true), (3, 2, false), (5, 3, false), (9, 7, true), (10, 8, false), (16, 14, false)];
/// Intervals of a trajectory.
const N: usize = 100;
/// Period of the recursion (23), s.
const PERIOD: f64 = 125e-6;
/// Turns, and factorisations in each.
const TURNS: usize = 15;
const FACTORISATIONS: usize = 20;

fn main() {
    let chains = CHAINS.map(|(n, actuated, known)| (Timed::new(n, actuated), known));
    let mut times = vec![[const { Vec::new() }; 3]; chains.len()];
    for _ in 0..TURNS {
        for ((chain, _), times) in chains.iter().zip(&mut times) {
            for (times, time) in times.iter_mut().zip(chain.times()) {
                times.push(time);
            }
        }
    }
    println!("joints, actuated   factorisation, us   QP iteration, us   period of (23), us");
    for ((chain, known), mut times) in chains.iter().zip(times) {
        let [factorisation, iteration, period] = times.each_mut().map(|times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        });
        let mark = if *known { "*" } else { " " };
        let sizes = chain.qp.sizes();
        let (n, actuated) = (sizes.joints(), sizes.actuated());
        println!("{n:>6}, {actuated:>8} {mark} {factorisation:>18.1} {iteration:>18.1} {period:>20.3}");
    }
    println!("* compiled for these sizes");
}

/// What is timed for a chain.
struct Timed {
    chain: Chain,
    qp: Qp,
    kkt: Kkt,
}

impl Timed {
    fn new(n: usize, actuated: usize) -> Self {
        let chain = Chain::new(n, actuated, N);
        let (qp, sizes) = (chain.qp(), chain.model.sizes());
        let mut kkt = Kkt::zeros(sizes, N, &qp.target);
        (kkt.h, kkt.t_t, kkt.dynamics) = (qp.h, 1.0, qp.dynamics.clone());
        for k in 0..=N {
            for i in 0..sizes.knot() {
                kkt.hessian.row_mut(k, i)[i] = 1.0;
            }
        }
        Self { chain, qp, kkt }
    }

    /// Times of a factorisation, an iteration of a QP from cold and a period of (23), us.
    fn times(&self) -> [f64; 3] {
        let Chain { model, hanging } = &self.chain;
        let sizes = model.sizes();
        let mut factor = Factor::new(sizes, N);
        let mut solver = QpSolver::new(Backend::Structured, sizes, N);
        let weights = LqrWeights { q: State::repeat(sizes, 1.0), q_end: State::repeat(sizes, 1.0), r: 1e-2 };
        let mut work = Workspace::default();
        let factorisation = cpu_us(|| {
            for _ in 0..FACTORISATIONS {
                assert!(black_box(&self.kkt).factor_into(0.0, 0.0, &mut factor));
            }
        });
        let qp = cpu_us(|| assert_eq!(solver.solve(&self.qp, &QpOptions::new(1e-9)), QpStatus::Solved));
        let gains = cpu_us(|| {
            let gains = lqr::synthesize(model, hanging, &weights, PERIOD, Recursion::Periods, &mut work);
            assert!(gains.is_ok(), "{gains:?}");
        });
        [
            factorisation / FACTORISATIONS as f64,
            qp / solver.solution().iterations as f64,
            gains * PERIOD / DURATION,
        ]
    }
}
