//! Small dense kernels on column-major storage, written so that the compiler vectorises them.

/// Dot product.
#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four running sums: a single one would wait for each addition.
    let mut sums = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = a4
        .remainder()
        .iter()
        .zip(b4.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in a4.zip(b4) {
        for lane in 0..4 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}

/// `y += factor * x`.
#[inline]
pub(super) fn axpy(factor: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// Replaces the lower triangle of the column-major `n`×`n` matrix by its Cholesky factor.
/// False where the matrix is not positive definite.
pub(super) fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    for k in 0..n {
        let pivot = matrix[k * n + k];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let (left, right) = matrix.split_at_mut((k + 1) * n);
        let column = &mut left[k * n..];
        let scale = 1.0 / pivot.sqrt();
        for value in &mut column[k..n] {
            *value *= scale;
        }
        for (j, other) in (k + 1..n).zip(right.chunks_exact_mut(n)) {
            axpy(-column[j], &column[j..n], &mut other[j..n]);
        }
    }
    true
}

/// Writes the inverse transpose of the lower triangular factor, upper triangular, column-major.
pub(super) fn inverse_transpose(factor: &[f64], n: usize, inverse: &mut [f64]) {
    inverse[..n * n].fill(0.0);
    // Row j of L⁻¹ is column j of its transpose: L⁻ᵀ eⱼ by back substitution.
    for j in 0..n {
        let column = &mut inverse[j * n..(j + 1) * n];
        column[j] = 1.0 / factor[j * n + j];
        for i in (0..j).rev() {
            let sum = dot(&factor[i * n + i + 1..i * n + j + 1], &column[i + 1..=j]);
            column[i] = -sum / factor[i * n + i];
        }
    }
}

/// Solves `L Lᵀ x = b` in place.
pub(super) fn solve(factor: &[f64], n: usize, x: &mut [f64]) {
    for k in 0..n {
        x[k] /= factor[k * n + k];
        let value = x[k];
        axpy(
            -value,
            &factor[k * n + k + 1..(k + 1) * n],
            &mut x[k + 1..n],
        );
    }
    for k in (0..n).rev() {
        let sum = dot(&factor[k * n + k + 1..(k + 1) * n], &x[k + 1..n]);
        x[k] = (x[k] - sum) / factor[k * n + k];
    }
}
