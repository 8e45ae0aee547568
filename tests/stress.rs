//! The stress suite on the device of the tests, under the validation layer: a test a case.

mod render_support;

use limpid::stress::{Case, Outcome, cases};
use render_support::device;

fn case(number: &str) -> Case {
    cases().into_iter().find(|case| case.number == number).unwrap_or_else(|| panic!("no case {number}"))
}

fn passes(number: &str) {
    let outcome = case(number).run(&device());
    let lines = outcome.lines().join("; ");
    println!("{number}: {lines}");
    assert!(matches!(outcome, Outcome::Passed { .. }), "{number} {}: {lines}", outcome.verdict());
}

fn is_not_run(number: &str, why: &str) {
    match case(number).run(&device()) {
        Outcome::NotRun { reason } => assert_eq!(reason, why, "{number}"),
        outcome => panic!("{number} {}: {:?}: expect it to pass from now on", outcome.verdict(), outcome.lines()),
    }
}

/// A test a case, and the list of their numbers.
macro_rules! tests {
    ($($test:ident $number:literal $(not run: $why:expr)?;)+) => {
        $(#[test]
        fn $test() {
            tests!(@ $number $($why)?);
        })+

        const TESTED: &[&str] = &[$($number),+];
    };
    (@ $number:literal) => { passes($number) };
    (@ $number:literal $why:expr) => { is_not_run($number, $why) };
}

tests! {
    t01_furnace "T1";
    t02_concentric_spheres "T2";
    t03_point_light_in_a_sphere "T3" not run: "there are no point lights yet";
}
