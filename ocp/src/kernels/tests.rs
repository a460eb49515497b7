//! Each kernel against the plain formula, for all sizes of chains.

use super::*;
use crate::dims::{Avx2, Baseline, Registers};
use crate::random::Random;
use nalgebra::DMatrix;
use std::cmp::Ordering;
use upswing_model::Sizes;

/// A panel of `rows` rows of random numbers, `columns` of which are not padding.
fn panel(random: &mut Random, rows: usize, columns: usize) -> Vec<f64> {
    let stride = columns.next_multiple_of(4);
    let mut panel = vec![0.0; rows * stride];
    for row in panel.chunks_exact_mut(stride) {
        row[..columns].fill_with(|| random.next());
    }
    panel
}

fn matrix(panel: &[f64], rows: usize, columns: usize) -> DMatrix<f64> {
    let stride = columns.next_multiple_of(4);
    DMatrix::from_fn(rows, columns, |i, j| panel[i * stride + j])
}

/// What `run` returns with the registers of every CPU; with those of AVX2 it must be the same.
fn with_all_registers<T: PartialEq + std::fmt::Debug>(
    baseline: impl FnOnce(Baseline<Sizes>) -> T,
    avx2: impl FnOnce(Avx2<Sizes>) -> T,
) -> T {
    let sizes = Sizes::new(2, 1).expect("a chain");
    let out = baseline(Baseline(sizes));
    if let Some(d) = Avx2::detect(sizes) {
        assert_eq!(avx2(d), out);
    }
    out
}

#[test]
fn combinations_of_rows() {
    let mut random = Random(1);
    for columns in 1..50 {
        for rank in 0..17 {
            let (a, s, c) = (
                panel(&mut random, rank, columns),
                panel(&mut random, rank, 3),
                panel(&mut random, 1, columns),
            );
            let mut out = c.clone();
            combine(&mut out, rank, &s, 4, &a, columns.next_multiple_of(4));
            let want = matrix(&c, 1, columns)
                + matrix(&s, rank, 3).columns(0, 1).transpose() * matrix(&a, rank, columns);
            assert!((matrix(&out, 1, columns) - want).amax() < 1e-14, "{columns} columns, rank {rank}");
            assert!(out[columns..].iter().all(|v| *v == 0.0));
            let mut one = c.clone();
            shift_add(&mut one[..columns], 0.5, &c);
            assert!(one.iter().zip(&c).all(|(a, b)| (a - 1.5 * b).abs() < 1e-15));
            let plain: f64 = c.iter().map(|v| v * v).sum();
            assert!((dot(&c[..columns], &c) - plain).abs() < 1e-13);
            assert_eq!(amax(&c[..columns]), c.iter().fold(0.0, |most: f64, v| most.max(v.abs())));
        }
    }
}

fn updated<D: Registers>(d: D, out: &[f64], n: usize, rank: usize, left: &[f64], right: &[f64]) -> Vec<f64> {
    let stride = n.next_multiple_of(4);
    let mut out = out.to_vec();
    rank_update(d, &mut out, stride, n, rank, left, stride, right, stride);
    mirror(d, &mut out, stride, n);
    out
}

#[test]
fn symmetric_updates() {
    let mut random = Random(2);
    for n in 1..48 {
        for rank in [1, 2, 3, 7, 15] {
            let half = panel(&mut random, rank, n);
            let other = panel(&mut random, rank, n);
            // left = [a; b] and right = [b; a], so that the update is symmetric.
            let (left, right) = ([half.clone(), other.clone()].concat(), [other, half].concat());
            let mut before = panel(&mut random, n, n);
            mirror(Baseline(Sizes::new(2, 1).expect("a chain")), &mut before, n.next_multiple_of(4), n);
            let out = with_all_registers(
                |d| updated(d, &before, n, 2 * rank, &left, &right),
                |d| updated(d, &before, n, 2 * rank, &left, &right),
            );
            let want =
                matrix(&before, n, n) + matrix(&left, 2 * rank, n).transpose() * matrix(&right, 2 * rank, n);
            assert!((matrix(&out, n, n) - want).amax() < 1e-13, "{n} rows, rank {rank}");
        }
    }
}

/// The rows after their elimination, and the factors of their block.
fn elimination<D: Registers>(
    d: D,
    rows: &[f64],
    stride: usize,
    at: usize,
    n: usize,
) -> Option<(Vec<f64>, Vec<f64>, Vec<f64>)> {
    let (mut rows, mut lower, mut inverse) = (rows.to_vec(), vec![0.0; n * n], vec![0.0; n]);
    eliminate(d, &mut rows, stride, at, n, &mut lower, &mut inverse).then_some((rows, lower, inverse))
}

#[test]
fn elimination_and_its_solutions() {
    let mut random = Random(3);
    for n in 1..16_usize {
        let (at, stride) = (n + 1, (2 * n + 1).next_multiple_of(4));
        let seed = DMatrix::from_fn(n, n, |_, _| random.next());
        let block = &seed * seed.transpose() + DMatrix::identity(n, n) * 0.1;
        // The block within rows, its upper triangle without a meaning.
        let mut rows: Vec<f64> = (0..n * stride).map(|_| random.next()).collect();
        for i in 0..n {
            for j in 0..=i {
                rows[i * stride + at + j] = block[(i, j)];
            }
        }
        let (eliminated, lower, inverse) = with_all_registers(
            |d| elimination(d, &rows, stride, at, n).expect("positive definite"),
            |d| elimination(d, &rows, stride, at, n).expect("positive definite"),
        );
        let l = DMatrix::from_fn(n, n, |i, j| match i.cmp(&j) {
            Ordering::Less => 0.0,
            Ordering::Equal => 1.0,
            Ordering::Greater => lower[i * n + j],
        });
        let d = DMatrix::from_fn(n, n, |i, j| if i == j { 1.0 / inverse[i] } else { 0.0 });
        assert!((&l * &d * l.transpose() - &block).amax() < 1e-14);
        let other = |rows: &[f64]| DMatrix::from_fn(n, at, |i, j| rows[i * stride + j]);
        assert!((&l * other(&eliminated) - other(&rows)).amax() < 1e-12);
        let b = panel(&mut random, n, 5);
        let mut y = b.clone();
        backward(&lower, n, &mut y, 8);
        assert!((l.transpose() * matrix(&y, n, 5) - matrix(&b, n, 5)).amax() < 1e-12);
        let mut y = vec![0.0; b.len()];
        divide_negative(&inverse, n, &b, &mut y, 8);
        assert!((d * matrix(&y, n, 5) + matrix(&b, n, 5)).amax() < 1e-12);
        let column: Vec<f64> = (0..n).map(|_| random.next()).collect();
        let mut x = vec![0.0; n];
        solve_negative(&lower, &inverse, n, &column, &mut x);
        let x = DMatrix::from_column_slice(n, 1, &x);
        assert!((&block * x + DMatrix::from_column_slice(n, 1, &column)).amax() < 1e-12);
        for bad in [-1.0, 0.0, f64::NAN, f64::INFINITY] {
            rows[(n - 1) * stride + at + n - 1] = bad;
            let d = Baseline(Sizes::new(2, 1).expect("a chain"));
            assert_eq!(elimination(d, &rows, stride, at, n), None, "{bad}");
        }
    }
}

#[test]
fn elimination_with_pivots() {
    let mut random = Random(4);
    for n in 1..16 {
        let mut e: Vec<f64> = (0..n * n).map(|_| random.next()).collect();
        // A first pivot of 0.
        if n > 1 {
            e[0] = 0.0;
        }
        let rows = panel(&mut random, n, 9);
        let (mut rest, mut x) = (e.clone(), rows.clone());
        solve_rows(&mut rest, n, &mut x, 12);
        let miss = (DMatrix::from_row_slice(n, n, &e) * matrix(&x, n, 9) - matrix(&rows, n, 9)).amax();
        assert!(miss < 1e-10, "{n} rows: {miss:e}");
        let (mut singular, mut x) = (vec![0.0; n * n], rows);
        solve_rows(&mut singular, n, &mut x, 12);
        assert!(x.iter().any(|v| !v.is_finite()));
    }
}
