//! The stage-wise factorisation solves the same system as Gaussian elimination of the full matrix, for all numbers of joints and
//! motors, with the same bits in every instance, and recognises a reduced Hessian that is not positive definite.

use super::*;
use crate::dims::{Avx2, Baseline};
use crate::random::Random;
use nalgebra::{DMatrix, DVector};
use upswing_model::MOST_JOINTS;
use upswing_model::{Dims, Fixed};

/// All numbers of joints and motors of a chain.
fn all_sizes() -> impl Iterator<Item = Sizes> {
    (2..=MOST_JOINTS).flat_map(|n| (1..n).filter_map(move |actuated| Sizes::new(n, actuated)))
}

/// A system of `n` intervals with `targets` target rows, no two of which are orthogonal.
fn system(random: &mut Random, sizes: Sizes, n: usize, targets: usize) -> (Kkt, Rhs) {
    let target: Vec<TargetRow> = (0..targets)
        .map(|i| {
            // Far from each other in scale, too.
            let scale = [1.0, 30.0, 0.01][i % 3];
            let mut row =
                TargetRow { coefficients: State::from_fn(sizes, |_| 0.3 * random.next()), value: 0.0 };
            row.coefficients[i] += 1.0;
            row.coefficients *= scale;
            row
        })
        .collect();
    let mut kkt = Kkt::zeros(sizes, n, &target);
    (kkt.h, kkt.t_t) = (0.1, 3.0);
    let z = sizes.knot();
    for k in 0..=n {
        let seed = DMatrix::from_fn(z, z, |_, _| random.next());
        let hessian = &seed * seed.transpose() * 0.1 + DMatrix::identity(z, z);
        for i in 0..z {
            kkt.hessian.row_mut(k, i).copy_from_slice(hessian.column(i).as_slice());
        }
        kkt.with_t.vector_mut(k).fill_with(|| 0.1 * random.next());
        for i in 0..sizes.unactuated() {
            kkt.dynamics.rows.row_mut(k, i).fill_with(|| 3.0 * random.next());
        }
        kkt.dynamics.f.vector_mut(k).fill_with(|| random.next());
    }
    let mut rhs = kkt.zero_rhs();
    (0..=n).for_each(|k| rhs.g.vector_mut(k).fill_with(|| random.next()));
    (0..n).for_each(|k| rhs.defects.vector_mut(k).fill_with(|| random.next()));
    rhs.target.fill_with(|| random.next());
    rhs.start = State::from_fn(sizes, |_| random.next());
    rhs.g_t = random.next();
    (kkt, rhs)
}

/// [A_k, B_k] in full.
fn dense_dynamics(kkt: &Kkt, k: usize) -> DMatrix<f64> {
    let sizes = kkt.sizes();
    let (n, actuated) = (sizes.joints(), sizes.actuated());
    let mut ab = DMatrix::zeros(sizes.state(), sizes.knot());
    for i in 0..n {
        ab[(i, n + i)] = 1.0;
    }
    for i in 0..actuated {
        ab[(n + i, 2 * n + i)] = 1.0;
    }
    for i in 0..sizes.unactuated() {
        for j in 0..sizes.knot() {
            ab[(n + actuated + i, j)] = kkt.dynamics.rows.row(k, i)[j];
        }
    }
    ab
}

/// dz, dt and multipliers of defects and target rows, by elimination of the full matrix.
fn dense(kkt: &Kkt, rhs: &Rhs, damping: f64, input_damping: f64) -> NewtonStep {
    let (sizes, n) = (kkt.sizes(), kkt.intervals());
    let (x, z) = (sizes.state(), sizes.knot());
    let (t, targets) = ((n + 1) * z, kkt.target.len());
    let rows = n * x + x + targets;
    let mut m = DMatrix::<f64>::zeros(t + 1 + rows, t + 1 + rows);
    let mut b = DVector::<f64>::zeros(t + 1 + rows);
    let mut constraints = DMatrix::<f64>::zeros(rows, t + 1);
    for k in 0..=n {
        for i in 0..z {
            for j in 0..z {
                m[(k * z + i, k * z + j)] = kkt.hessian.row(k, i)[j];
            }
            m[(k * z + i, k * z + i)] += if i < x { damping } else { input_damping };
            m[(k * z + i, t)] = kkt.with_t.vector(k)[i];
            m[(t, k * z + i)] = kkt.with_t.vector(k)[i];
            b[k * z + i] = -rhs.g.vector(k)[i];
        }
    }
    m[(t, t)] = kkt.t_t + damping;
    b[t] = -rhs.g_t;
    for k in 0..n {
        for (knot, sign) in [(k, -1.0), (k + 1, 1.0)] {
            let block = dense_dynamics(kkt, knot) * (-0.5 * kkt.h);
            constraints.view_mut((k * x, knot * z), (x, z)).copy_from(&block);
            for i in 0..x {
                constraints[(k * x + i, knot * z + i)] += sign;
                constraints[(k * x + i, t)] -= kkt.dynamics.f.vector(knot)[i] / (2.0 * n as f64);
            }
        }
        for i in 0..x {
            b[t + 1 + k * x + i] = -rhs.defects.vector(k)[i];
        }
    }
    for i in 0..x {
        constraints[(n * x + i, i)] = 1.0;
        b[t + 1 + n * x + i] = rhs.start[i];
    }
    for (i, row) in kkt.target.iter().enumerate() {
        let at = n * x + x + i;
        for j in 0..x {
            constraints[(at, n * z + j)] = row.coefficients[j];
        }
        b[t + 1 + at] = -rhs.target[i];
    }
    m.view_mut((t + 1, 0), (rows, t + 1)).copy_from(&constraints);
    m.view_mut((0, t + 1), (t + 1, rows)).copy_from(&constraints.transpose());
    let y = m.lu().solve(&b).expect("a regular matrix");
    let mut step = NewtonStep::zeros(sizes, n, targets);
    for k in 0..=n {
        step.z.vector_mut(k).copy_from_slice(&y.as_slice()[k * z..][..z]);
    }
    step.t = y[t];
    for k in 0..n {
        step.lambda.vector_mut(k).copy_from_slice(&y.as_slice()[t + 1 + k * x..][..x]);
    }
    step.lambda_target.copy_from_slice(&y.as_slice()[t + 1 + n * x + x..]);
    step
}

/// Largest difference, relative to the largest entry: of the steps, and of the multipliers.
fn difference(a: &NewtonStep, b: &NewtonStep) -> f64 {
    let largest = |a: &[f64], b: &[f64]| {
        let worst = a.iter().zip(b).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()));
        worst / (1.0 + amax(b))
    };
    largest(a.z.as_slice(), b.z.as_slice())
        .max((a.t - b.t).abs() / (1.0 + b.t.abs()))
        .max(largest(a.lambda.as_slice(), b.lambda.as_slice()))
        .max(largest(&a.lambda_target, &b.lambda_target))
}

#[test]
fn equals_dense_elimination_for_all_sizes_with_and_without_damping() {
    let mut random = Random(1);
    for sizes in all_sizes().chain(all_sizes().step_by(3)) {
        let n = 3 + (random.next().abs() * 4.0) as usize;
        // At most half as many as there are inputs: each takes one degree of freedom.
        let most = sizes.state().min((n + 1) * sizes.actuated() / 2);
        let targets = ((0.5 + 0.5 * random.next()) * (most + 1) as f64) as usize;
        let (kkt, rhs) = system(&mut random, sizes, n, targets);
        let mut factor = Factor::new(sizes, n);
        let mut work = SolveWorkspace::new(sizes, n, targets);
        let mut step = NewtonStep::zeros(sizes, n, targets);
        for (damping, input_damping) in [(0.0, 0.0), (0.5, 0.1)] {
            let want = dense(&kkt, &rhs, damping, input_damping);
            assert!(kkt.factor_into(damping, input_damping, &mut factor), "{sizes:?}");
            kkt.solve_into(&factor, &rhs, (damping, input_damping), (8, 1e-13), &mut work, &mut step);
            let miss = difference(&step, &want);
            assert!(miss <= 1e-8, "{sizes:?}, {n} intervals, {targets} targets, damping {damping}: {miss:e}");
        }
    }
}

#[test]
fn a_hessian_of_products_gives_the_step_of_its_panels_and_a_predictor_and_corrector_the_whole_step() {
    let mut random = Random(5);
    for sizes in all_sizes().step_by(3) {
        let (n, targets) = (6, 1);
        let (mut panels, rhs) = system(&mut random, sizes, n, targets);
        let mut products = Kkt::of_products(sizes, n, &panels.target);
        (products.h, products.t_t) = (panels.h, panels.t_t);
        products.with_t.copy_from(&panels.with_t);
        products.dynamics.copy_from(&panels.dynamics);
        let Products { diagonal, jacobian, sigma } = &mut products.products;
        sigma.fill_with(|| 10.0 * random.next().abs());
        panels.hessian.clear();
        for k in 0..=n {
            diagonal.vector_mut(k).fill_with(|| 1.0 + random.next().abs());
            (0..sizes.actuated()).for_each(|i| jacobian.row_mut(k, i).fill_with(|| random.next()));
            (0..sizes.knot()).for_each(|i| panels.hessian.row_mut(k, i)[i] = diagonal.vector(k)[i]);
            let sigma = &sigma[k * sizes.actuated()..][..sizes.actuated()];
            panels.add_products(k, jacobian, sigma, &mut Slab::zeros(sizes, 1, sizes.actuated()));
        }
        let (d, damping) = (Baseline(sizes), (0.2, 0.1));
        let step = || NewtonStep::zeros(sizes, n, targets);
        let (mut factor, mut work) = (Factor::new(sizes, n), SolveWorkspace::new(sizes, n, targets));
        let (mut want, mut found) = (step(), step());
        for (kkt, out) in [(&panels, &mut want), (&products, &mut found)] {
            assert!(change_variables(d, kkt, &mut factor));
            assert!(factorise(d, kkt, damping.0, damping.1, &mut factor), "{sizes:?}");
            solve(d, kkt, &factor, &rhs, damping, (8, 1e-13), &mut work, out);
        }
        assert!(difference(&found, &want) <= 1e-9, "{sizes:?}: {:e}", difference(&found, &want));

        let mut other = rhs.clone();
        (0..=n).for_each(|k| other.g.vector_mut(k).fill_with(|| random.next()));
        let (mut predicted, mut corrected) = (step(), step());
        predict(d, &products, &factor, &rhs, &mut work, &mut predicted);
        correct(d, &products, &factor, &other, &mut work, &mut corrected);
        solve(d, &products, &factor, &rhs, damping, (0, 0.0), &mut work, &mut want);
        (predicted.lambda, predicted.lambda_target) = (want.lambda.clone(), want.lambda_target.clone());
        // Without refinement, the stiff target costs seven digits.
        assert!(difference(&predicted, &want) <= 1e-6, "{sizes:?}: {:e}", difference(&predicted, &want));
        solve(d, &products, &factor, &other, damping, (0, 0.0), &mut work, &mut want);
        assert!(difference(&corrected, &want) <= 1e-6, "{sizes:?}: {:e}", difference(&corrected, &want));
    }
}

/// The solution of a system in the instance of `d`.
fn solved<D: Registers>(d: D, kkt: &Kkt, rhs: &Rhs) -> NewtonStep {
    let (sizes, n, targets) = (kkt.sizes(), kkt.intervals(), kkt.target.len());
    let mut factor = Factor::new(sizes, n);
    let mut step = NewtonStep::zeros(sizes, n, targets);
    assert!(change_variables(d, kkt, &mut factor));
    assert!(factorise(d, kkt, 0.1, 0.2, &mut factor));
    let mut work = SolveWorkspace::new(sizes, n, targets);
    solve(d, kkt, &factor, rhs, (0.1, 0.2), (3, 0.0), &mut work, &mut step);
    step
}

/// Compares the instances of `fixed` and of the sizes `sizes` read at run time, for all registers.
fn all_instances_agree<D: Dims>(sizes: Sizes, fixed: D) {
    for round in 0..20 {
        let (kkt, rhs) = system(&mut Random(round), sizes, 10, sizes.actuated());
        let want = solved(Baseline(sizes), &kkt, &rhs);
        assert_eq!(solved(Baseline(fixed), &kkt, &rhs), want, "{sizes:?}");
        if let (Some(run), Some(fixed)) = (Avx2::detect(sizes), Avx2::detect(fixed)) {
            assert_eq!(solved(run, &kkt, &rhs), want, "{sizes:?}, AVX2");
            assert_eq!(solved(fixed, &kkt, &rhs), want, "{sizes:?}, AVX2");
        }
    }
}

#[test]
fn sizes_and_registers_leave_the_bits_as_they_are() {
    for sizes in all_sizes().step_by(7) {
        all_instances_agree(sizes, sizes);
    }
    all_instances_agree(Sizes::new(9, 7).expect("a chain"), Fixed::<9, 7>);
    all_instances_agree(Sizes::new(2, 1).expect("a chain"), Fixed::<2, 1>);
}

#[test]
fn a_reduced_hessian_with_a_negative_direction_is_refused() {
    for sizes in [(2, 1), (3, 1), (9, 7), (16, 15)].map(|(n, actuated)| Sizes::new(n, actuated)) {
        let sizes = sizes.expect("a chain");
        let (mut kkt, _) = system(&mut Random(2), sizes, 4, 1);
        let mut factor = Factor::new(sizes, 4);
        assert!(kkt.factor_into(0.0, 0.0, &mut factor));
        let u = sizes.state();
        kkt.hessian.row_mut(2, u)[u] = -1e4;
        assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
        assert!(kkt.factor_into(0.0, 1e5, &mut factor), "enough damping helps");
        kkt.hessian.row_mut(2, u)[u] = f64::NAN;
        assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
        let (kkt, _) = system(&mut Random(2), sizes, 4, 1);
        assert!(kkt.factor_into(0.0, 0.0, &mut factor), "nothing remains of the NaN");
    }
}

#[test]
fn target_rows_that_depend_on_each_other_are_refused() {
    let sizes = Sizes::new(3, 2).expect("a chain");
    let (mut kkt, _) = system(&mut Random(3), sizes, 4, 3);
    let mut factor = Factor::new(sizes, 4);
    assert!(kkt.factor_into(0.0, 0.0, &mut factor));
    let sum = kkt.target[0].coefficients + kkt.target[1].coefficients * 2.0;
    kkt.target[2].coefficients = sum;
    assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
    kkt.target[2].coefficients = State::zeros(sizes);
    assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
    kkt.target = vec![TargetRow::unit(sizes, 0, 0.0); 7];
    assert!(!kkt.factor_into(0.0, 0.0, &mut factor));
}

#[test]
fn products_with_the_dynamics_and_of_condensed_rows() {
    let mut random = Random(4);
    for sizes in all_sizes().step_by(5) {
        let (mut kkt, _) = system(&mut random, sizes, 2, 0);
        let ab = dense_dynamics(&kkt, 1);
        let z = DVector::from_fn(sizes.knot(), |_, _| random.next());
        let forward = kkt.dynamics.apply(1, z.as_slice());
        assert!((&ab * &z - DVector::from_column_slice(&forward)).amax() < 1e-13, "{sizes:?}");
        let w = State::from_fn(sizes, |_| random.next());
        let mut back = DVector::zeros(sizes.knot());
        kkt.dynamics.apply_transposed(1, &w, back.as_mut_slice());
        assert!((ab.transpose() * DVector::from_column_slice(&w) - back).amax() < 1e-13, "{sizes:?}");

        let mut jacobian = Slab::zeros(sizes, 3, sizes.actuated());
        let dense = DMatrix::from_fn(sizes.actuated(), sizes.knot(), |_, _| random.next());
        for i in 0..sizes.actuated() {
            for j in 0..sizes.knot() {
                jacobian.row_mut(2, i)[j] = dense[(i, j)];
            }
        }
        let sigma = DVector::from_fn(sizes.actuated(), |_, _| random.next().abs());
        let square =
            |kkt: &Kkt| DMatrix::from_fn(sizes.knot(), sizes.knot(), |i, j| kkt.hessian.row(2, i)[j]);
        let want = square(&kkt) + dense.transpose() * DMatrix::from_diagonal(&sigma) * &dense;
        kkt.add_products(2, &jacobian, sigma.as_slice(), &mut Slab::zeros(sizes, 1, sizes.actuated()));
        assert!((square(&kkt) - want).amax() < 1e-13, "{sizes:?}");
    }
}
