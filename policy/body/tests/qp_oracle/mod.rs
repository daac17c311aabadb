//! Clarabel, an interior-point solver, as the judge of the active-set solver.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{
    DefaultSettingsBuilder, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus,
};
use posed_body::qp::Problem;

/// What Clarabel says of a problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Verdict {
    /// The least objective.
    Minimum(f64),
    /// No point satisfies the constraints.
    Infeasible,
    /// It could not tell to full accuracy.
    Unsure,
}

/// A dense column-major matrix as a sparse one, without its zeros.
fn sparse(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f64) -> CscMatrix<f64> {
    let (mut starts, mut indices, mut values) = (vec![0], Vec::new(), Vec::new());
    for column in 0..columns {
        for row in 0..rows {
            let value = value(row, column);
            if value != 0.0 {
                indices.push(row);
                values.push(value);
            }
        }
        starts.push(values.len());
    }
    CscMatrix::new(rows, columns, starts, indices, values)
}

/// Solves to the tightest tolerance that it reaches.
pub fn judge(problem: &Problem) -> Verdict {
    let (n, m) = (problem.unknowns(), problem.constraints());
    // Clarabel wants the upper triangle; the problem has the lower one.
    let hessian = sparse(n, n, |row, column| {
        if row <= column {
            problem.hessian()[row * n + column]
        } else {
            0.0
        }
    });
    // A x >= b as b - A x + s = 0 with s >= 0 turned round: -A x + s = -b.
    let rows = sparse(m, n, |row, column| -problem.constraint(row).0[column]);
    let bounds: Vec<f64> = (0..m).map(|row| -problem.constraint(row).1).collect();
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-9)
        .tol_gap_rel(1e-9)
        .tol_feas(1e-9)
        .max_iter(200)
        .build()
        .expect("sound settings");
    let cones = [NonnegativeConeT(m)];
    let mut solver = DefaultSolver::new(
        &hessian,
        problem.gradient(),
        &rows,
        &bounds,
        &cones,
        settings,
    )
    .expect("a sound problem");
    solver.solve();
    match solver.solution.status {
        SolverStatus::Solved => Verdict::Minimum(problem.objective(&solver.solution.x)),
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => {
            Verdict::Infeasible
        }
        _ => Verdict::Unsure,
    }
}
