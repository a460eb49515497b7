//! Rows of the target condition (8).

use super::orthonormal::OrthonormalTarget;
use crate::kernels::combine;
use upswing_model::{Dims, LARGEST_STATE, Sizes, State};

/// One row of the target condition: `coefficients` . x_N = `value` (8).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetRow {
    /// Of x_N.
    pub coefficients: State,
    /// What the product shall be.
    pub value: f64,
}

impl TargetRow {
    /// The i-th entry of x_N shall be `value`.
    pub fn unit(sizes: Sizes, i: usize, value: f64) -> Self {
        let mut coefficients = State::zeros(sizes);
        coefficients[i] = 1.0;
        Self { coefficients, value }
    }

    /// The index of the joint whose position the row fixes at `value`, if it is such a row.
    pub fn joint(&self) -> Option<usize> {
        let mut entries = self.coefficients.iter().enumerate().filter(|(_, c)| **c != 0.0);
        match (entries.next(), entries.next()) {
            (Some((i, 1.0)), None) if i < self.coefficients.sizes().joints() => Some(i),
            _ => None,
        }
    }

    /// What is missing in `x`: `coefficients` . `x` - `value`.
    pub fn residual(&self, x: &State) -> f64 {
        self.coefficients.dot(x) - self.value
    }
}

/// A row of a target follows from the rows before it, or contradicts them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("row {} of the target depends on the rows before it", row + 1)]
pub struct DependentTargetRow {
    /// The row, counted from 0.
    pub row: usize,
}

/// Checks that no row of a target depends on the others.
///
/// # Errors
/// [`DependentTargetRow`] with the first row that does.
pub fn check_target_rows(rows: &[TargetRow]) -> Result<(), DependentTargetRow> {
    let Some(first) = rows.first() else { return Ok(()) };
    let sizes = first.coefficients.sizes();
    OrthonormalTarget::new(sizes).set(sizes, rows)
}

/// The state closest to `x` that meets all rows; `x` if they depend on each other.
pub(crate) fn nearest_state(rows: &[TargetRow], x: &State) -> State {
    let sizes = x.sizes();
    let mut target = OrthonormalTarget::new(sizes);
    if target.set(sizes, rows).is_err() {
        return *x;
    }
    // x - T' (T T')^-1 (T x - b) = x - Q' L^-1 (T x - b)
    let (mut residual, mut step) = ([0.0; LARGEST_STATE], [0.0; LARGEST_STATE]);
    let along: Vec<f64> = rows.iter().map(|row| row.residual(x)).collect();
    target.forward(&along, &mut residual);
    let length = sizes.state_row();
    combine(&mut step[..length], rows.len(), &residual, 1, target.rows(sizes), length);
    State::from_fn(sizes, |i| x[i] - step[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sizes() -> Sizes {
        Sizes::new(3, 2).expect("a chain")
    }

    fn row(coefficients: [f64; 6], value: f64) -> TargetRow {
        TargetRow { coefficients: State::from_fn(sizes(), |i| coefficients[i]), value }
    }

    #[test]
    fn the_nearest_state_meets_rows_that_are_not_orthogonal() {
        let rows = [
            row([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], 0.5),
            row([0.0, 1.0, -2.0, 0.0, 0.3, 0.0], -1.0),
            TargetRow::unit(sizes(), 5, 0.25),
        ];
        let x = State::from_fn(sizes(), |i| i as f64 - 1.5);
        let nearest = nearest_state(&rows, &x);
        for row in &rows {
            assert!(row.residual(&nearest).abs() < 1e-14, "{row:?} misses by {}", row.residual(&nearest));
        }
        // The step is a combination of the rows: nothing along their common kernel.
        let kernel = State::from_fn(sizes(), |i| [-1.0, 1.0, 0.5, 0.0, 0.0, 0.0][i]);
        assert!((nearest - x).dot(&kernel).abs() < 1e-14);
        assert_eq!((nearest - x)[3], 0.0);
    }

    #[test]
    fn rows_that_depend_on_each_other_are_named() {
        let mut rows = vec![
            row([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], 0.5),
            row([1.0, -1.0, 0.0, 0.0, 0.0, 0.0], 0.0),
            TargetRow::unit(sizes(), 1, 0.25),
        ];
        assert_eq!(check_target_rows(&rows), Err(DependentTargetRow { row: 2 }));
        rows.pop();
        assert_eq!(check_target_rows(&rows), Ok(()));
        rows.extend(
            (0..5).map(|i| row([i as f64, 2.0, 1.0, (i * i) as f64, 0.0, 1.0 / (i + 1) as f64], 0.0)),
        );
        assert!(matches!(check_target_rows(&rows), Err(DependentTargetRow { row }) if row >= 4));
    }
}
