//! The stage-wise factorisation solves the same system as Gaussian elimination of the full matrix, into memory of
//! its own or of the caller, and recognises a reduced Hessian that is not positive definite.

use nalgebra::SVector;
use nalgebra::{DMatrix, DVector, SMatrix};
use upswing_model::Sizes;
use upswing_ocp::kkt::{
    Factor, Kkt, KnotDynamics, KnotMatrix, KnotVector, NewtonStep, Rhs, SolveWorkspace, TargetRow,
};

const NU: usize = 7;
const N_UNACTUATED: usize = 2;
const NX: usize = 2 * (NU + N_UNACTUATED);
const NZ: usize = NX + NU;
type State = SVector<f64, NX>;

/// Intervals of the test system.
const N: usize = 4;

/// SplitMix64 (Steele, Lea, Flood 2014), mapped to -1..1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

fn system(random: &mut Random) -> (Kkt, Rhs) {
    let mut hessian = || {
        let seed = KnotMatrix::from_fn(|_, _| random.next());
        seed * seed.transpose() * 0.1 + KnotMatrix::identity()
    };
    let hessian = (0..=N).map(|_| hessian()).collect();
    let dynamics = (0..=N)
        .map(|_| KnotDynamics {
            qdd_u_x: SMatrix::<f64, N_UNACTUATED, NX>::from_fn(|_, _| 10.0 * random.next()),
            qdd_u_u: SMatrix::<f64, N_UNACTUATED, NU>::from_fn(|_, _| random.next()),
            f: State::from_fn(|_, _| random.next()),
        })
        .collect();
    let target = [0, 3, 11]
        .map(|i| {
            let mut row = TargetRow::unit(Sizes::new(NU + N_UNACTUATED, NU).expect("a chain"), i, 0.0);
            row.coefficients[i + 1] = -0.5;
            row
        })
        .to_vec();
    let with_t = (0..=N).map(|_| KnotVector::from_fn(|_, _| 0.1 * random.next())).collect();
    let kkt = Kkt { h: 0.1, hessian, with_t, t_t: 3.0, dynamics, target };
    let mut rhs = kkt.zero_rhs();
    rhs.g.iter_mut().for_each(|g| *g = KnotVector::from_fn(|_, _| random.next()));
    rhs.defects.iter_mut().for_each(|d| *d = State::from_fn(|_, _| random.next()));
    rhs.target.iter_mut().for_each(|t| *t = random.next());
    rhs.start = State::from_fn(|_, _| random.next());
    rhs.g_t = random.next();
    (kkt, rhs)
}

/// dz, dt and multipliers of defects and target rows, by elimination of the full matrix.
fn dense(kkt: &Kkt, rhs: &Rhs, damping: f64, input_damping: f64) -> NewtonStep {
    const T: usize = (N + 1) * NZ;
    let targets = kkt.target.len();
    let rows = N * NX + NX + targets;
    let size = T + 1 + rows;
    let mut m = DMatrix::<f64>::zeros(size, size);
    let mut b = DVector::<f64>::zeros(size);
    for k in 0..=N {
        let mut h = kkt.hessian[k];
        for i in 0..NZ {
            h[(i, i)] += if i < NX { damping } else { input_damping };
        }
        m.view_mut((k * NZ, k * NZ), (NZ, NZ)).copy_from(&h);
        m.view_mut((k * NZ, T), (NZ, 1)).copy_from(&kkt.with_t[k]);
        m.view_mut((T, k * NZ), (1, NZ)).copy_from(&kkt.with_t[k].transpose());
        b.rows_mut(k * NZ, NZ).copy_from(&-rhs.g[k]);
    }
    m[(T, T)] = kkt.t_t + damping;
    b[T] = -rhs.g_t;
    let mut constraints = DMatrix::<f64>::zeros(rows, T + 1);
    for k in 0..N {
        for (knot, sign) in [(k, -1.0), (k + 1, 1.0)] {
            for j in 0..NZ {
                let mut unit = KnotVector::zeros();
                unit[j] = 1.0;
                let column = kkt.dynamics[knot].apply(&unit) * (-0.5 * kkt.h);
                constraints.view_mut((k * NX, knot * NZ + j), (NX, 1)).copy_from(&column);
                if j < NX {
                    constraints[(k * NX + j, knot * NZ + j)] += sign;
                }
            }
        }
        let along_t = (kkt.dynamics[k].f + kkt.dynamics[k + 1].f) / (-2.0 * N as f64);
        constraints.view_mut((k * NX, T), (NX, 1)).copy_from(&along_t);
        b.rows_mut(T + 1 + k * NX, NX).copy_from(&-rhs.defects[k]);
    }
    for i in 0..NX {
        constraints[(N * NX + i, i)] = 1.0;
        b[T + 1 + N * NX + i] = rhs.start[i];
    }
    for (i, row) in kkt.target.iter().enumerate() {
        let at = N * NX + NX + i;
        constraints.view_mut((at, N * NZ), (1, NX)).copy_from_slice(&row.coefficients);
        b[T + 1 + at] = -rhs.target[i];
    }
    m.view_mut((T + 1, 0), (rows, T + 1)).copy_from(&constraints);
    m.view_mut((0, T + 1), (T + 1, rows)).copy_from(&constraints.transpose());
    let y = m.lu().solve(&b).expect("a regular matrix");
    NewtonStep {
        z: (0..=N).map(|k| KnotVector::from_fn(|i, _| y[k * NZ + i])).collect(),
        t: y[T],
        lambda: (0..N).map(|k| State::from_fn(|i, _| y[T + 1 + k * NX + i])).collect(),
        lambda_target: (0..targets).map(|i| y[T + 1 + N * NX + NX + i]).collect(),
    }
}

fn difference(a: &NewtonStep, b: &NewtonStep) -> f64 {
    let z = a.z.iter().zip(&b.z).map(|(a, b)| (a - b).amax()).fold((a.t - b.t).abs(), f64::max);
    let lambda = a.lambda.iter().zip(&b.lambda).map(|(a, b)| (a - b).amax()).fold(z, f64::max);
    a.lambda_target.iter().zip(&b.lambda_target).map(|(a, b)| (a - b).abs()).fold(lambda, f64::max)
}

#[test]
fn with_and_without_damping() {
    let mut random = Random(1);
    let mut factor = Factor::new(N);
    let mut work = SolveWorkspace::new(N, 3);
    let mut step = NewtonStep::zeros(N, 3);
    for round in 0..20 {
        let (kkt, rhs) = system(&mut random);
        for (damping, input_damping) in [(0.0, 0.0), (0.5, 0.1)] {
            let want = dense(&kkt, &rhs, damping, input_damping);
            assert!(kkt.factor_into(damping, input_damping, &mut factor));
            kkt.solve_into(&factor, &rhs, (damping, input_damping), (8, 1e-12), &mut work, &mut step);
            let miss = difference(&step, &want);
            assert!(miss <= 1e-8, "round {round}, damping {damping}: {miss:e}");
        }
    }
}

#[test]
fn a_reduced_hessian_with_a_negative_direction_is_refused() {
    let (mut kkt, _) = system(&mut Random(2));
    let mut factor = Factor::new(N);
    assert!(kkt.factor_into(0.0, 0.0, &mut factor));
    kkt.hessian[2][(NX, NX)] = -1e4;
    assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
    assert!(kkt.factor_into(0.0, 1e5, &mut factor), "enough damping helps");
    kkt.hessian[2][(NX, NX)] = f64::NAN;
    assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
}
