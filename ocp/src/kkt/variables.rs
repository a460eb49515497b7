//! The two changes of variables of a sweep. Each is that of double integrators, a few shifts of rows, but for the dense rows of the
//! unactuated velocities, so that T' P T and N' S N cost a symmetric update of rank 2 n_U instead of products of full matrices.
//!
//! All functions take h/2 and the dense rows of T or N as a panel of n_U rows over (s, u) or z.

use crate::dims::kernels;
use crate::kernels::{combine, shift_add, solve_rows, update_lower};
use crate::slab::LARGEST_KNOT;
use upswing_model::Dims;
use upswing_model::{LARGEST_STATE, MOST_JOINTS};

/// First rows of the velocities, of the unactuated velocities, and of the inputs among z = (x, u).
#[inline(always)]
pub(super) fn places(d: impl Dims) -> (usize, usize, usize) {
    (d.joints(), d.joints() + d.actuated(), d.state())
}

/// Memory of the congruences: the two factors of the symmetric update, 2 n_U + n_A rows over z each, and a block of n_U rows and
/// columns.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    left: Vec<f64>,
    right: Vec<f64>,
    block: Vec<f64>,
}

impl Scratch {
    pub(super) fn new(d: impl Dims) -> Self {
        let update = (2 * d.unactuated() + d.actuated()) * d.knot_row();
        Self {
            left: vec![0.0; update],
            right: vec![0.0; update],
            block: vec![0.0; d.unactuated() * d.unactuated()],
        }
    }
}

/// P + sum_i m_i g_i' + g_i m_i' + sum_j sigma_j J_j J_j' in the lower triangle of the panel `p`, for the rows m_i, the rows g_i, which the
/// first rows of `right` hold, and the rows J_j and sigma of `products`.
#[inline(always)]
fn symmetric_update<D: super::Registers>(
    d: D,
    m: &[f64],
    (jacobian, sigma): (&[f64], &[f64]),
    scratch: &mut Scratch,
    p: &mut [f64],
) {
    let row = d.knot_row();
    let half = d.unactuated() * row;
    let rank = 2 * d.unactuated() + sigma.len();
    let (left, right) = (&mut scratch.left[..rank * row], &mut scratch.right[..rank * row]);
    left[..half].copy_from_slice(m);
    left[half..2 * half].copy_from_slice(&right[..half]);
    right[half..2 * half].copy_from_slice(m);
    right[2 * half..].copy_from_slice(jacobian);
    for (j, sigma) in sigma.iter().enumerate() {
        let (left, jacobian) = (&mut left[2 * half + j * row..][..row], &jacobian[j * row..][..row]);
        for i in 0..row {
            left[i] = sigma * jacobian[i];
        }
    }
    update_lower(d, p, row, d.knot(), rank, left, row, right, row);
}

/// The shifts of the double integrators on the columns of one row over (s, u): q + h/2 on qd, qd_A + h/2 on u.
#[inline(always)]
fn shift_columns(d: impl Dims, half_h: f64, out: &mut [f64]) {
    let (n, actuated) = (d.joints(), d.actuated());
    let (q, rest) = out.split_at_mut(n);
    let (v, u) = rest.split_at_mut(n);
    shift_add(v, half_h, q);
    shift_add(&mut u[..actuated], half_h, &v[..actuated]);
}

/// out = T' out for one row over z, where z = T (s, u).
#[inline(always)]
pub(super) fn entering_transposed(d: impl Dims, half_h: f64, m: &[f64], out: &mut [f64]) {
    let (unactuated, row) = (d.unactuated(), d.knot_row());
    let (_, v_u, _) = places(d);
    shift_columns(d, half_h, out);
    let mut on_v = [0.0; MOST_JOINTS];
    for i in 0..unactuated {
        on_v[i] = out[v_u + i];
        out[v_u + i] = 0.0;
    }
    combine(&mut out[..row], unactuated, &on_v, 1, m, row);
}

/// E' line for one row over s, but for the dense rows, where s = N z: the identity and the shifts of the double integrators.
#[inline(always)]
fn shifted(d: impl Dims, half_h: f64, line: &[f64], out: &mut [f64]) {
    let (n, actuated) = (d.joints(), d.actuated());
    let (v, v_u, _) = places(d);
    let (on_q, rest) = out.split_at_mut(n);
    let (on_v, on_u) = rest.split_at_mut(n);
    let (q, v) = (&line[..n], &line[v..v_u]);
    for i in 0..n {
        on_q[i] = q[i];
        on_v[i] = half_h * q[i];
    }
    for i in 0..actuated {
        on_v[i] += v[i];
        on_u[i] = half_h * v[i];
    }
    on_u[actuated..].fill(0.0);
}

/// out = N' p for one row over s, where s = N z.
#[inline(always)]
pub(super) fn leaving_transposed(d: impl Dims, half_h: f64, rows: &[f64], p: &[f64], out: &mut [f64]) {
    let (unactuated, row) = (d.unactuated(), d.knot_row());
    let (_, v_u, _) = places(d);
    shifted(d, half_h, p, out);
    combine(&mut out[..row], unactuated, &p[v_u..], 1, rows, row);
}

/// s = N z
#[inline(always)]
pub(super) fn leaving_apply(d: impl Dims, half_h: f64, rows: &[f64], z: &[f64], s: &mut [f64]) {
    let (n, actuated, row) = (d.joints(), d.actuated(), d.knot_row());
    let (v, v_u, u) = places(d);
    for i in 0..n {
        s[i] = z[i] + half_h * z[v + i];
    }
    for i in 0..actuated {
        s[v + i] = z[v + i] + half_h * z[u + i];
    }
    for i in 0..d.unactuated() {
        s[v_u + i] = super::dot(&rows[i * row..][..row], &z[..row]);
    }
}

/// z = T (s, u), for u in its place in `z`.
#[inline(always)]
pub(super) fn entering_apply(d: impl Dims, half_h: f64, m: &[f64], s: &[f64], z: &mut [f64]) {
    let (n, actuated, row) = (d.joints(), d.actuated(), d.knot_row());
    let (v, v_u, u) = places(d);
    for i in 0..d.unactuated() {
        let m = &m[i * row..][..row];
        z[v_u + i] = super::dot(&m[..u], &s[..u]) + super::dot(&m[u..u + actuated], &z[u..u + actuated]);
    }
    for i in 0..actuated {
        z[v + i] = s[v + i] + half_h * z[u + i];
    }
    for i in 0..n {
        z[i] = s[i] + half_h * z[v + i];
    }
}

kernels! {
    /// The dense rows of T into `m`: dqd_U = m (s, u) for the rows `dynamics` of d qdd_U / dz.
    ///
    /// dx = s + h/2 (A dx + B du) without the actuated joints and the unactuated positions leaves E dqd_U = r (s, u) with the block of
    /// the unactuated velocities E = I - h/2 A_UU - h^2/4 A_Uq.
    pub(super) fn entering(d: D, half_h: f64, dynamics: &[f64], m: &mut [f64], scratch: &mut Scratch) {
        let (n, actuated, unactuated, row) = (d.joints(), d.actuated(), d.unactuated(), d.knot_row());
        let (v, v_u, u) = places(d);
        let (dynamics, m) = (&dynamics[..unactuated * row], &mut m[..unactuated * row]);
        let block = &mut scratch.block[..unactuated * unactuated];
        for i in 0..unactuated {
            let (a, m) = (&dynamics[i * row..][..row], &mut m[i * row..][..row]);
            for j in 0..n {
                m[j] = half_h * a[j];
            }
            for j in 0..actuated {
                m[v + j] = half_h * (a[v + j] + m[j]);
            }
            for j in 0..unactuated {
                let one = if i == j { 1.0 } else { 0.0 };
                m[v_u + j] = one;
                block[i * unactuated + j] = one - half_h * (a[v_u + j] + half_h * a[actuated + j]);
            }
            for j in 0..actuated {
                m[u + j] = half_h * (a[u + j] + m[v + j]);
            }
            m[u + actuated..].fill(0.0);
        }
        solve_rows(block, unactuated, m, row);
    }

    /// The dense rows of N into `rows`: qd_U + h/2 qdd_U, for the rows `dynamics` of d qdd_U / dz.
    pub(super) fn leaving(d: D, half_h: f64, dynamics: &[f64], rows: &mut [f64]) {
        let row = d.knot_row();
        let (_, v_u, _) = places(d);
        let (dynamics, rows) = (&dynamics[..d.unactuated() * row], &mut rows[..d.unactuated() * row]);
        for i in 0..dynamics.len() {
            rows[i] = half_h * dynamics[i];
        }
        for i in 0..d.unactuated() {
            rows[i * row + v_u + i] += 1.0;
        }
    }

    /// T' P T in the lower triangle of the symmetric panel `p` over z.
    ///
    /// With the rows of the unactuated velocities taken out of the shifted P, P_U = [g, B], what they contribute is
    /// m' g + g' m + m' B m, a symmetric update with the rows g + B m / 2.
    pub(super) fn entering_congruence(d: D, half_h: f64, m: &[f64], p: &mut [f64], scratch: &mut Scratch) {
        let (n, actuated, unactuated, z, row) =
            (d.joints(), d.actuated(), d.unactuated(), d.knot(), d.knot_row());
        let (v, v_u, u) = places(d);
        let (m, p) = (&m[..unactuated * row], &mut p[..z * row]);
        for (from, to, count) in [(0, v, n), (v, u, actuated)] {
            let (low, high) = p.split_at_mut(to * row);
            for i in 0..count {
                shift_add(&mut high[i * row..][..row], half_h, &low[(from + i) * row..][..row]);
            }
        }
        for i in 0..z {
            shift_columns(d, half_h, &mut p[i * row..][..row]);
        }
        let block = &mut scratch.block[..unactuated * unactuated];
        let g = &mut scratch.right[..unactuated * row];
        g.copy_from_slice(&p[v_u * row..][..unactuated * row]);
        for i in 0..unactuated {
            for j in 0..unactuated {
                block[i * unactuated + j] = 0.5 * g[i * row + v_u + j];
                g[i * row + v_u + j] = 0.0;
            }
        }
        for i in 0..unactuated {
            combine(&mut g[i * row..][..row], unactuated, &block[i * unactuated..], 1, m, row);
        }
        p[v_u * row..][..unactuated * row].fill(0.0);
        for i in 0..z {
            p[i * row + v_u..][..unactuated].fill(0.0);
        }
        symmetric_update(d, m, (&[], &[]), scratch, p);
    }

    /// N' S N + J' diag(sigma) J into the lower triangle of the panel `p` over z, for a symmetric panel `s` over states, and the rows J
    /// and sigma of `products`.
    ///
    /// With S = E' S E in the shifts alone, what the dense rows contribute is an update as in [`entering_congruence`], with the rows of
    /// S of the unactuated velocities.
    pub(super) fn leaving_congruence(
        d: D,
        half_h: f64,
        rows: &[f64],
        s: &[f64],
        products: (&[f64], &[f64]),
        p: &mut [f64],
        scratch: &mut Scratch,
    ) {
        let (unactuated, z, row, state_row) = (d.unactuated(), d.knot(), d.knot_row(), d.state_row());
        let (v, v_u, u) = places(d);
        let (rows, s, p) = (&rows[..unactuated * row], &s[..u * state_row], &mut p[..z * row]);
        let mut line = [0.0; LARGEST_STATE];
        let line = &mut line[..state_row];
        for j in 0..z {
            if j < v_u {
                line.copy_from_slice(&s[j * state_row..][..state_row]);
            } else {
                line.fill(0.0);
            }
            if (v..u).contains(&j) {
                shift_add(line, half_h, &s[(j - v) * state_row..][..state_row]);
            } else if j >= u {
                shift_add(line, half_h, &s[(j - u + v) * state_row..][..state_row]);
            }
            shifted(d, half_h, line, &mut p[j * row..][..row]);
        }
        for i in 0..unactuated {
            let line = &s[(v_u + i) * state_row..][..state_row];
            let g = &mut scratch.right[i * row..][..row];
            shifted(d, half_h, line, g);
            let mut half = [0.0; MOST_JOINTS];
            for j in 0..unactuated {
                half[j] = 0.5 * line[v_u + j];
            }
            combine(g, unactuated, &half, 1, rows, row);
        }
        symmetric_update(d, rows, products, scratch, p);
    }
}

/// A row over z that a change of variables works on.
pub(super) type KnotRow = [f64; LARGEST_KNOT];
