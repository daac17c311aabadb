//! The active-set solver against Clarabel on random problems.

mod qp_oracle;

use posed_body::qp::{Problem, Solver, Status};
use proptest::prelude::*;
use qp_oracle::{Verdict, judge};

/// Numbers in ±1 for a seed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// A problem with `m` random constraints, most of which a point near the origin satisfies.
fn random_problem(seed: u64, n: usize, m: usize, slack: f64) -> Problem {
    let mut noise = Noise(seed);
    let mut problem = Problem::with_capacity(n, m);
    problem.reset(n);
    let factor: Vec<f64> = (0..n * n).map(|_| noise.next()).collect();
    for column in 0..n {
        for row in 0..n {
            let dot: f64 = (0..n)
                .map(|k| factor[row * n + k] * factor[column * n + k])
                .sum();
            let ridge = if row == column { 0.1 } else { 0.0 };
            problem.hessian_mut()[column * n + row] = dot + ridge;
        }
        problem.gradient_mut()[column] = 5.0 * noise.next();
    }
    let inside: Vec<f64> = (0..n).map(|_| noise.next()).collect();
    for _ in 0..m {
        let row: Vec<f64> = (0..n).map(|_| noise.next()).collect();
        let there: f64 = row.iter().zip(&inside).map(|(a, x)| a * x).sum();
        let bound = there - slack * (0.1 + noise.next().abs());
        problem.constrain(bound).copy_from_slice(&row);
    }
    problem
}

fn relative(a: f64, b: f64) -> f64 {
    (a - b).abs() / (1.0 + b.abs())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn minima_agree_with_clarabel(seed in any::<u64>(), n in 2_usize..40, per in 0.2_f64..3.0) {
        let m = (n as f64 * per) as usize + 1;
        let problem = random_problem(seed, n, m, 1.0);
        let mut solver = Solver::new(n, m);
        prop_assert_eq!(solver.solve(&problem, &[]), Status::Solved);
        prop_assert!(problem.violation(solver.x()) < 1e-8);
        prop_assert!(solver.multipliers().all(|u| u >= 0.0));
        let Verdict::Minimum(theirs) = judge(&problem) else { return Ok(()) };
        let ours = problem.objective(solver.x());
        prop_assert!(relative(ours, theirs) < 1e-7, "{} against {}", ours, theirs);
    }

    #[test]
    fn any_guess_gives_the_same_minimum(
        seed in any::<u64>(),
        n in 2_usize..30,
        guess in prop::collection::vec(0_usize..80, 0..40),
    ) {
        let m = 2 * n;
        let problem = random_problem(seed, n, m, 0.5);
        let mut solver = Solver::new(n, m);
        prop_assert_eq!(solver.solve(&problem, &[]), Status::Solved);
        let cold = solver.x().to_vec();
        prop_assert_eq!(solver.solve(&problem, &guess), Status::Solved);
        for (a, b) in cold.iter().zip(solver.x()) {
            prop_assert!((a - b).abs() < 1e-6 * (1.0 + a.abs()), "{} against {}", a, b);
        }
    }

    #[test]
    fn infeasible_problems_are_recognised(seed in any::<u64>(), n in 2_usize..20) {
        let mut problem = random_problem(seed, n, n, 1.0);
        let row: Vec<f64> = problem.constraint(0).0.to_vec();
        let bound = problem.constraint(0).1;
        // The opposite of the first constraint, with no room between the two.
        for (to, from) in problem.constrain(-bound + 0.5).iter_mut().zip(&row) {
            *to = -from;
        }
        let mut solver = Solver::new(n, n + 1);
        prop_assert_eq!(solver.solve(&problem, &[]), Status::Infeasible);
        prop_assert!(solver.x().iter().all(|x| x.is_finite()));
        prop_assert_eq!(judge(&problem), Verdict::Infeasible);
    }
}

#[test]
fn the_last_active_set_solves_at_once() {
    let problem = random_problem(3, 60, 90, 0.3);
    let mut solver = Solver::new(60, 90);
    assert_eq!(solver.solve(&problem, &[]), Status::Solved);
    let active = solver.active().to_vec();
    assert!(active.len() > 5 && solver.iterations() >= active.len());
    assert_eq!(solver.solve(&problem, &active), Status::Solved);
    assert_eq!(solver.iterations(), 0);
}

#[test]
fn repeated_and_dependent_rows_do_no_harm() {
    let mut problem = random_problem(11, 8, 6, 0.2);
    for index in 0..6 {
        let (row, bound) = problem.constraint(index);
        let (row, bound): (Vec<f64>, f64) = (row.iter().map(|a| 3.0 * a).collect(), 3.0 * bound);
        problem.constrain(bound).copy_from_slice(&row);
    }
    let mut solver = Solver::new(8, 12);
    assert_eq!(solver.solve(&problem, &[0, 6, 1, 7, 11, 5]), Status::Solved);
    let Verdict::Minimum(theirs) = judge(&problem) else {
        panic!("Clarabel cannot tell")
    };
    assert!(relative(problem.objective(solver.x()), theirs) < 1e-7);
}

#[test]
fn unsound_problems_are_refused() {
    let mut problem = random_problem(5, 4, 2, 1.0);
    problem.hessian_mut()[0] = -1.0;
    let mut solver = Solver::new(4, 2);
    assert_eq!(solver.solve(&problem, &[]), Status::Unsound);
    let mut problem = random_problem(5, 4, 2, 1.0);
    problem.gradient_mut()[1] = f64::NAN;
    assert_eq!(solver.solve(&problem, &[]), Status::Unsound);
    assert_eq!(solver.x(), &[0.0; 4]);
}
