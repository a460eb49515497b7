//! The factorisation, a sweep from the target to the start, and the solution of one right-hand side with it: a sweep back
//! and one forth.

use super::orthonormal::OrthonormalTarget;
use super::variables::{
    KnotRow, Scratch, entering, entering_apply, entering_congruence, entering_transposed, leaving,
    leaving_apply, leaving_congruence, leaving_transposed, places,
};
use super::{Kkt, NewtonStep, Products, Rhs, add_products};
use crate::dims::{Registers, kernels};
use crate::kernels::{
    backward, combine, divide_negative, dot, eliminate, mirror, shift_add, solve_negative, update_lower,
};
use crate::slab::{Knots, LARGEST_KNOT, Slab};
use upswing_model::{Dims, Sizes};
use upswing_model::{LARGEST_STATE, MOST_JOINTS, States};

/// Stiffness of the orthonormal target rows in the factorised matrix. Large against the curvature of the problem, small enough that
/// its products keep seven digits of that curvature. With 3e6 the slowest QP whose bounds yield takes a third more iterations, with 1e8
/// as many.
const TARGET_STIFFNESS: f64 = 1e7;

/// The factorised matrix: what the backward sweep leaves for each interval.
#[derive(Clone, Debug)]
pub struct Factor {
    /// The dense rows of s_k = N dz_k and of dz_{k+1} = T (s_k, du_{k+1}): panels of n_U rows.
    leaving: Slab<Knots>,
    entering: Slab<Knots>,
    /// (f_k + f_{k+1}) / (2 N)
    along_t: Slab<States>,
    /// Value function of stages k+1..N as one of s_k: its matrix S, and the product with dt.
    value: Slab<States>,
    value_t: Slab<States>,
    /// L and the inverse of D of each pivot block L D L', n_A rows of n_A entries and n_A entries; the last ones are those of u_0.
    lower: Vec<f64>,
    inverse: Vec<f64>,
    /// du_{k+1} = K s_k + k_t dt + ...: panels of n_A rows, and n_A entries each; the last k_t is that of u_0.
    gain: Slab<States>,
    gain_t: Vec<f64>,
    /// d^2 / du_0 dx_0 of the whole problem's value function, one panel of n_A rows, and its products with dt.
    value_ux: Slab<States>,
    value_xt: Slab<States>,
    pivot_t: f64,
    target: OrthonormalTarget,
    /// The quadratic in dz_k or (s_k, du_{k+1}) that the sweep has come to, one panel of which the lower triangle is kept; and the
    /// rows of symmetric updates.
    p: Slab<Knots>,
    update: Slab<States>,
    scaled: Slab<Knots>,
    scratch: Scratch,
}

impl Factor {
    /// Memory for a factor of `n` intervals.
    pub fn new(sizes: Sizes, n: usize) -> Self {
        let actuated = sizes.actuated();
        Self {
            leaving: Slab::zeros(sizes, n, sizes.unactuated()),
            entering: Slab::zeros(sizes, n, sizes.unactuated()),
            along_t: Slab::zeros(sizes, n, 1),
            value: Slab::zeros(sizes, n, sizes.state()),
            value_t: Slab::zeros(sizes, n, 1),
            lower: vec![0.0; (n + 1) * actuated * actuated],
            inverse: vec![0.0; (n + 1) * actuated],
            gain: Slab::zeros(sizes, n, actuated),
            gain_t: vec![0.0; (n + 1) * actuated],
            value_ux: Slab::zeros(sizes, 1, actuated),
            value_xt: Slab::zeros(sizes, 1, 1),
            pivot_t: 0.0,
            target: OrthonormalTarget::new(sizes),
            p: Slab::zeros(sizes, 1, sizes.knot()),
            update: Slab::zeros(sizes, 1, sizes.state()),
            scaled: Slab::zeros(sizes, 1, actuated),
            scratch: Scratch::new(sizes),
        }
    }
}

/// What a solution is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    /// A solution by itself.
    Whole,
    /// A predictor, of which nobody needs the multipliers: a quarter of the work less.
    Predictor,
    /// A corrector with the defects of the predictor before it, whose products with the value functions are known: as much less.
    Corrector,
}

/// Memory of [`solve`].
#[derive(Clone, Debug)]
pub(super) struct SweepWorkspace {
    /// Gradient of the value function of stages k+1..N at s_k = 0.
    gradient: Slab<States>,
    /// The input there, n_A entries for each interval.
    feedforward: Vec<f64>,
    /// -S_k r_k of the last predictor.
    on_defects: Slab<States>,
}

impl SweepWorkspace {
    pub(super) fn new(sizes: Sizes, n: usize) -> Self {
        let vectors = Slab::zeros(sizes, n, 1);
        Self { gradient: vectors.clone(), feedforward: vec![0.0; n * sizes.actuated()], on_defects: vectors }
    }
}

/// Copies the first entries of the rows of `from`, over z, into those of `to`, over states.
#[inline(always)]
fn copy_states(d: impl Dims, from: &[f64], to: &mut [f64]) {
    let state = d.state();
    for (to, from) in to.chunks_exact_mut(d.state_row()).zip(from.chunks_exact(d.knot_row())) {
        to[..state].copy_from_slice(&from[..state]);
        to[state..].fill(0.0);
    }
}

/// Adds H_k, but for its products, and the damping to the lower triangle of P.
#[inline(always)]
fn add_knot<D: Registers>(d: D, kkt: &Kkt, k: usize, damping: (f64, f64), p: &mut [f64]) {
    let (knot, row) = (d.knot(), d.knot_row());
    if let Some(hessian) = kkt.hessian.as_slice().get(k * knot * row..(k + 1) * knot * row) {
        for i in 0..knot {
            let columns = (i + 1).next_multiple_of(4).min(row);
            shift_add(&mut p[i * row..][..columns], 1.0, &hessian[i * row..][..columns]);
        }
    }
    if let Some(diagonal) = kkt.products.diagonal.as_slice().get(k * row..(k + 1) * row) {
        for i in 0..knot {
            p[i * row + i] += diagonal[i];
        }
    }
    for i in 0..knot {
        p[i * row + i] += if i < d.state() { damping.0 } else { damping.1 };
    }
}

/// J_k and sigma_k of a knot; empty if there are none.
#[inline(always)]
fn products<D: Registers>(d: D, products: &Products, k: usize) -> (&[f64], &[f64]) {
    let (actuated, row) = (d.actuated(), d.knot_row());
    let sigma = products.sigma.get(k * actuated..(k + 1) * actuated).unwrap_or_default();
    (
        products.jacobian.as_slice().get(k * actuated * row..(k + 1) * actuated * row).unwrap_or_default(),
        sigma,
    )
}

kernels! {
    /// Lower triangle of S + sum_l left_l right_l', for n_A rows in `left` and `right`.
    fn add_gain(d: D, left: &[f64], right: &[f64], value: &mut [f64]) {
        let row = d.state_row();
        update_lower(d, value, row, d.state(), d.actuated(), left, row, right, row);
    }

    /// [`Kkt::change_variables`](super::Kkt::change_variables)
    pub(crate) fn change_variables(d: D, kkt: &Kkt, factor: &mut Factor) -> bool {
        let (state_row, dense) = (d.state_row(), d.unactuated() * d.knot_row());
        let n = kkt.intervals();
        let half_h = 0.5 * kkt.h;
        let dynamics = |k: usize| &kkt.dynamics.rows.as_slice()[k * dense..][..dense];
        let f = |k: usize| &kkt.dynamics.f.as_slice()[k * state_row..][..state_row];
        for k in 0..n {
            let m = &mut factor.entering.as_mut_slice()[k * dense..][..dense];
            entering(d, half_h, dynamics(k + 1), m, &mut factor.scratch);
            leaving(d, half_h, dynamics(k), &mut factor.leaving.as_mut_slice()[k * dense..][..dense]);
            let along_t = &mut factor.along_t.as_mut_slice()[k * state_row..][..state_row];
            let (near, far) = (f(k), f(k + 1));
            for l in 0..state_row {
                along_t[l] = (near[l] + far[l]) / (2.0 * n as f64);
            }
        }
        factor.target.set(d, &kkt.target).is_ok()
    }

    /// [`Kkt::factorise`](super::Kkt::factorise)
    pub(crate) fn factorise(d: D, kkt: &Kkt, damping: f64, input_damping: f64, factor: &mut Factor) -> bool {
        let (actuated, state, state_row) = (d.actuated(), d.state(), d.state_row());
        let (knot, row, dense) = (d.knot(), d.knot_row(), d.unactuated() * d.knot_row());
        let (_, _, u) = places(d);
        let n = kkt.intervals();
        let half_h = 0.5 * kkt.h;
        let with_t = |k: usize| &kkt.with_t.as_slice()[k * row..][..row];
        let Factor { scratch, .. } = factor;
        let p = &mut factor.p.as_mut_slice()[..knot * row];
        let update = &mut factor.update.as_mut_slice()[..state * state_row];
        let damping = (damping, input_damping);

        p.fill(0.0);
        let rows = factor.target.rows(d);
        let targets = rows.len() / state_row;
        for i in 0..rows.len() {
            update[i] = TARGET_STIFFNESS * rows[i];
        }
        // The states' part of the panel: its rows are longer than those of the target.
        for i in 0..state {
            let columns = (i + 1).next_multiple_of(4).min(state_row);
            combine(&mut p[i * row..][..columns], targets, &update[i..], state_row, rows, state_row);
        }
        add_knot(d, kkt, n, damping, p);
        let (jacobian, sigma) = products(d, &kkt.products, n);
        if !sigma.is_empty() {
            add_products(d, jacobian, sigma, p, &mut factor.scaled.as_mut_slice()[..actuated * row]);
        }
        let mut p_t: KnotRow = [0.0; LARGEST_KNOT];
        let p_t = &mut p_t[..row];
        p_t.copy_from_slice(with_t(n));
        let mut t_t = kkt.t_t + damping.0;
        for k in (0..n).rev() {
            let m = &factor.entering.as_slice()[k * dense..][..dense];
            let leave = &factor.leaving.as_slice()[k * dense..][..dense];
            let along_t = &factor.along_t.as_slice()[k * state_row..][..state_row];
            // In (s_k, du_{k+1}).
            mirror(d, p, row, knot);
            entering_congruence(d, half_h, m, p, scratch);
            entering_transposed(d, half_h, m, p_t);
            // Without du_{k+1}.
            let lower = &mut factor.lower[k * actuated * actuated..][..actuated * actuated];
            let inverse = &mut factor.inverse[k * actuated..][..actuated];
            if !eliminate(d, &mut p[u * row..], row, u, actuated, lower, inverse) {
                return false;
            }
            let gain = &mut factor.gain.as_mut_slice()[k * actuated * state_row..][..actuated * state_row];
            copy_states(d, &p[u * row..], gain);
            let value = &mut factor.value.as_mut_slice()[k * state * state_row..][..state * state_row];
            copy_states(d, p, value);
            let negative = &mut update[..actuated * state_row];
            divide_negative(inverse, actuated, gain, negative, state_row);
            add_gain(d, negative, gain, value);
            mirror(d, value, state_row, state);
            gain.copy_from_slice(negative);
            backward(lower, actuated, gain, state_row);
            let gain_t = &mut factor.gain_t[k * actuated..][..actuated];
            solve_negative(lower, inverse, actuated, &p_t[u..], gain_t);
            let value_t = &mut factor.value_t.as_mut_slice()[k * state_row..][..state_row];
            copy_states(d, p_t, value_t);
            combine(value_t, actuated, &p_t[u..], 1, gain, state_row);
            for l in 0..actuated {
                t_t += p_t[u + l] * gain_t[l];
            }
            // In dz_k.
            let mut on_s = [0.0; LARGEST_STATE];
            let on_s = &mut on_s[..state_row];
            on_s.copy_from_slice(value_t);
            combine(on_s, state, along_t, 1, value, state_row);
            t_t += dot(along_t, on_s) + dot(along_t, value_t);
            leaving_congruence(d, half_h, leave, value, products(d, &kkt.products, k), p, scratch);
            add_knot(d, kkt, k, damping, p);
            leaving_transposed(d, half_h, leave, on_s, p_t);
            shift_add(p_t, 1.0, with_t(k));
        }
        // At the start dx_0 is given: u_0 and t are left.
        let lower = &mut factor.lower[n * actuated * actuated..];
        let inverse = &mut factor.inverse[n * actuated..];
        copy_states(d, &p[u * row..], factor.value_ux.as_mut_slice());
        if !eliminate(d, &mut p[u * row..], row, u, actuated, lower, inverse) {
            return false;
        }
        copy_states(d, p_t, factor.value_xt.as_mut_slice());
        let gain_t = &mut factor.gain_t[n * actuated..];
        solve_negative(lower, inverse, actuated, &p_t[u..], gain_t);
        factor.pivot_t = t_t + dot(gain_t, &p_t[u..]);
        factor.pivot_t.is_finite() && factor.pivot_t > 0.0
    }

    /// One solve with the factorised matrix; its target rows hold to 1 / stiffness only.
    pub(super) fn solve(
        d: D,
        kkt: &Kkt,
        factor: &Factor,
        rhs: &Rhs,
        pass: Pass,
        work: &mut SweepWorkspace,
        step: &mut NewtonStep,
    ) {
        let (actuated, state, state_row) = (d.actuated(), d.state(), d.state_row());
        let (row, dense) = (d.knot_row(), d.unactuated() * d.knot_row());
        let (_, _, u) = places(d);
        let n = kkt.intervals();
        let half_h = 0.5 * kkt.h;
        let (gradient, feedforward) = (work.gradient.as_mut_slice(), work.feedforward.as_mut_slice());
        let on_defects = work.on_defects.as_mut_slice();
        let lower = |k: usize| &factor.lower[k * actuated * actuated..][..actuated * actuated];
        let inverse = |k: usize| &factor.inverse[k * actuated..][..actuated];
        let gain_t = |k: usize| &factor.gain_t[k * actuated..][..actuated];
        let gain = |k: usize| &factor.gain.as_slice()[k * actuated * state_row..][..actuated * state_row];
        let value = |k: usize| &factor.value.as_slice()[k * state * state_row..][..state * state_row];
        let value_t = |k: usize| &factor.value_t.as_slice()[k * state_row..][..state_row];
        let along_t = |k: usize| &factor.along_t.as_slice()[k * state_row..][..state_row];
        let m = |k: usize| &factor.entering.as_slice()[k * dense..][..dense];
        let leave = |k: usize| &factor.leaving.as_slice()[k * dense..][..dense];
        let defects = |k: usize| &rhs.defects.as_slice()[k * state_row..][..state_row];
        let g = |k: usize| &rhs.g.as_slice()[k * row..][..row];

        let mut p: KnotRow = [0.0; LARGEST_KNOT];
        let p = &mut p[..row];
        p.copy_from_slice(g(n));
        let rows = factor.target.rows(d);
        let mut residual = [0.0; LARGEST_STATE];
        factor.target.forward(&rhs.target, &mut residual);
        for (q, r) in rows.chunks_exact(state_row).zip(residual) {
            shift_add(&mut p[..state], TARGET_STIFFNESS * r, q);
        }
        let mut p_t = rhs.g_t;
        for k in (0..n).rev() {
            entering_transposed(d, half_h, m(k), p);
            solve_negative(lower(k), inverse(k), actuated, &p[u..], &mut feedforward[k * actuated..]);
            let on_s = &mut gradient[k * state_row..][..state_row];
            copy_states(d, p, on_s);
            combine(on_s, actuated, &p[u..], 1, gain(k), state_row);
            p_t += dot(gain_t(k), &p[u..]);
            let mut beyond = [0.0; LARGEST_STATE];
            let beyond = &mut beyond[..state_row];
            beyond.copy_from_slice(on_s);
            let mut negative = [0.0; LARGEST_STATE];
            for l in 0..state_row {
                negative[l] = -defects(k)[l];
            }
            let on_defects = &mut on_defects[k * state_row..][..state_row];
            match pass {
                Pass::Whole => combine(beyond, state, &negative, 1, value(k), state_row),
                Pass::Predictor => {
                    on_defects.fill(0.0);
                    combine(on_defects, state, &negative, 1, value(k), state_row);
                    shift_add(beyond, 1.0, on_defects);
                }
                Pass::Corrector => shift_add(beyond, 1.0, on_defects),
            }
            p_t += dot(along_t(k), beyond) - dot(value_t(k), defects(k));
            leaving_transposed(d, half_h, leave(k), beyond, p);
            shift_add(p, 1.0, g(k));
        }

        let dx0 = &rhs.start;
        let mut on_u = [0.0; MOST_JOINTS];
        for (l, line) in factor.value_ux.as_slice().chunks_exact(state_row).enumerate() {
            on_u[l] = p[u + l] + dot(dx0, line);
        }
        let on_t = p_t + dot(dx0, factor.value_xt.as_slice()) + dot(gain_t(n), &on_u);
        let t = -on_t / factor.pivot_t;
        step.t = t;
        let z = step.z.as_mut_slice();
        z[..state].copy_from_slice(dx0);
        solve_negative(lower(n), inverse(n), actuated, &on_u, &mut z[u..]);
        shift_add(&mut z[u..u + actuated], t, gain_t(n));
        let step_lambda = step.lambda.as_mut_slice();
        for k in 0..n {
            let (near, far) = z.split_at_mut((k + 1) * row);
            let (z, next) = (&near[k * row..], &mut far[..row]);
            let mut s = [0.0; LARGEST_STATE];
            let s = &mut s[..state_row];
            leaving_apply(d, half_h, leave(k), z, s);
            shift_add(s, -1.0, defects(k));
            shift_add(s, t, along_t(k));
            if pass != Pass::Predictor {
                let lambda = &mut step_lambda[k * state_row..][..state_row];
                lambda.copy_from_slice(&gradient[k * state_row..][..state_row]);
                shift_add(lambda, t, value_t(k));
                combine(lambda, state, s, 1, value(k), state_row);
                for l in 0..state_row {
                    lambda[l] = -lambda[l];
                }
            }
            for (l, gain) in gain(k).chunks_exact(state_row).enumerate() {
                next[u + l] = feedforward[k * actuated + l] + gain_t(k)[l] * t + dot(gain, s);
            }
            entering_apply(d, half_h, m(k), s, next);
        }
        if pass == Pass::Predictor {
            return;
        }
        let last = &z[n * row..];
        for (i, q) in rows.chunks_exact(state_row).enumerate() {
            step.lambda_target[i] = TARGET_STIFFNESS * (dot(&q[..state], last) + residual[i]);
        }
        factor.target.backward(&mut step.lambda_target);
    }
}
