//! The stress suite on the device of the tests, under the validation layer: a test a case.

mod render_support;

use limpid::gpu::list_devices;
use limpid::net::kernel::Family;
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

/// A test a case, and the list of their numbers. A case that is not run says why, and where that depends on the machine, unless
/// what is there.
macro_rules! tests {
    ($($test:ident $number:literal $(not run: $why:literal $(unless $there:expr)?)?;)+) => {
        $(#[test]
        fn $test() {
            tests!(@ $number $($why $($there)?)?);
        })+

        const TESTED: &[&str] = &[$($number),+];
    };
    (@ $number:literal) => { passes($number) };
    (@ $number:literal $why:literal) => { is_not_run($number, $why) };
    (@ $number:literal $why:literal $there:expr) => { if $there { passes($number) } else { is_not_run($number, $why) } };
}

fn two_devices() -> bool {
    list_devices().expect("devices").iter().filter(|info| info.unusable.is_empty()).count() > 1
}

fn has_coop() -> bool {
    Family::all(device().info()).iter().any(|family| family.name() == "coop")
}

tests! {
    t01_furnace "T1";
    t02_concentric_spheres "T2";
    t03_point_light_in_a_sphere "T3";
    t04_sphere_light_on_a_patch "T4";
    t05_tiny_and_huge_lights "T5";
    t06_faces_of_a_cube "T6";
    t07_reflections_add_light "T7";
    t08_estimators_agree "T8";
    t09_brighter "T9";
    t10_larger "T10";
    t11_order_of_shapes "T11";
    t12_permuted_colours "T12";
    t13_interrupted "T13";
    t14_chunks "T14";
    t15_tiles "T15";
    t16_densities_of_directions "T16";
    t17_uniform_numbers "T17";
    t18_sobol_nets "T18";
    t19_convergence "T19";
    t20_rays_and_spheres "T20";
    t21_self_hits_and_leaks "T21";
    t22_watertight_meshes "T22";
    t23_far_from_the_origin "T23";
    t24_degenerate_scenes "T24";
    t25_axes_wall_planes_corners "T25";
    t26_magnitudes "T26";
    t27_samples_that_are_no_number "T27";
    t28_first_hits "T28";
    t29_many_equal_samples "T29";
    t30_heavy_tail "T30";
    t31_variance_of_the_mean "T31";
    t32_noise_of_references "T32";
    t33_limit_of_loops "T33";
    t34_length_of_dispatches "T34";
    t35_same_bits_again "T35";
    t36_another_device "T36" not run: "there is no second usable Vulkan device" unless two_devices();
    t37_no_memory "T37";
    n01_constant_pictures "N1";
    n02_bad_pixels "N2";
    n03_bad_guides "N3";
    n04_beyond_f16_in_fp32 "N4";
    n05_beyond_f16_in_halves "N5" not run: "the device has no kernels that round to f16" unless has_coop();
}

/// None is forgotten, here or there, and each says what it claims.
#[test]
fn every_case_is_tested() {
    let numbers: Vec<&str> = cases().iter().map(|case| case.number).collect();
    assert_eq!(numbers, TESTED);
    let rendering: Vec<String> = (1..=37).map(|i| format!("T{i}")).collect();
    assert_eq!(numbers[..37], rendering);
    assert!(cases().iter().all(|case| !case.name.is_empty() && case.claim.len() > 20));
}
