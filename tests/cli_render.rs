//! `limpid render` and `limpid scene`: files, settings, reports.

mod cli_support;

use cli_support::Cli;
use serde_json::json;

#[test]
fn two_runs_give_the_same_bits() {
    let cli = Cli::new();
    for name in ["a.exr", "b.exr"] {
        cli.render(&["-o", name, "--size", "40x24", "--spp", "5", "--seed", "3"]);
    }
    assert_eq!(cli.bytes("a.exr"), cli.bytes("b.exr"));
    assert_eq!(cli.bytes("a.png"), cli.bytes("b.png"));
    cli.render(&["-o", "b.exr", "--size", "40x24", "--spp", "5", "--seed", "4"]);
    assert_ne!(cli.image("a.exr").channels["R"], cli.image("b.exr").channels["R"]);
}

#[test]
fn a_written_scene_renders_to_the_same_bits() {
    let cli = Cli::new();
    for scene in ["spheres", "spheres:7"] {
        let xml = cli.ok(&["scene", scene]);
        assert_eq!(cli.ok(&["scene", scene, "-o", "s.xml"]), "");
        assert_eq!(String::from_utf8(cli.bytes("s.xml")).expect("UTF-8"), xml);
        for (scene, name) in [(scene, "a.exr"), ("s.xml", "b.exr")] {
            cli.render(&[scene, "-o", name, "--size", "40x24", "--spp", "4"]);
        }
        let (a, b) = (cli.image("a.exr"), cli.image("b.exr"));
        assert_eq!(a.channels, b.channels);
        assert_eq!(a.attributes["sceneHash"], b.attributes["sceneHash"]);
    }
}

#[test]
fn a_scene_with_meshes_is_written_with_their_files() {
    let cli = Cli::new();
    let meshes = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/scenes/meshes.xml");
    cli.fails(&["scene", meshes], 2, &["meshes.xml", "--output"]);
    cli.ok(&["scene", meshes, "-o", "s.xml"]);
    for (scene, name) in [(meshes, "a.exr"), ("s.xml", "b.exr")] {
        cli.render(&[scene, "-o", name, "--size", "40x24", "--spp", "4"]);
    }
    let (a, b) = (cli.image("a.exr"), cli.image("b.exr"));
    assert_eq!(a.channels, b.channels);
    assert_eq!(a.attributes["sceneHash"], b.attributes["sceneHash"]);
}

#[test]
fn the_file_states_settings_and_flags_override_them() {
    let cli = Cli::new();
    let xml = cli.ok(&["scene", "spheres:2", "--size", "20x10"]);
    let xml = xml.replace("name=\"spp\" value=\"16\"", "name=\"spp\" value=\"3\"");
    let xml = xml.replace("name=\"max_depth\" value=\"9\"", "name=\"max_depth\" value=\"5\"");
    std::fs::write(cli.path("s.xml"), xml).expect("written");
    let settings = |args: &[&str]| cli.report(args)["settings"].clone();
    let s = settings(&["s.xml"]);
    assert_eq!([&s["spp"], &s["bounces"], &s["width"], &s["height"]], [3, 4, 20, 10]);
    let s = settings(&["s.xml", "--spp", "2", "--bounces", "1", "--size", "5x6"]);
    assert_eq!([&s["spp"], &s["bounces"], &s["width"], &s["height"]], [2, 1, 5, 6]);
    // Named after the scene.
    assert_eq!(cli.names(), ["s.exr", "s.png", "s.xml"]);
    let image = cli.image("s.exr");
    assert_eq!((image.width, image.height), (5, 6));
    assert_eq!([&image.attributes["spp"], &image.attributes["bounces"]], ["2", "1"]);
}

#[test]
fn every_estimator_and_sampler() {
    let cli = Cli::new();
    for (estimator, sampler) in [("uniform", "pcg"), ("cosine", "sobol"), ("nee", "pcg")] {
        let args = ["-o", "a.exr", "--size", "16x16", "--estimator", estimator, "--sampler", sampler, "--aa"];
        let report = cli.report(&args);
        assert_eq!(report["settings"]["estimator"], estimator);
        assert_eq!(report["settings"]["sampler"], sampler);
        assert_eq!(report["samples"], 16 * 16 * 16);
        let image = cli.image("a.exr");
        assert_eq!([&image.attributes["estimator"], &image.attributes["sampler"]], [estimator, sampler]);
        assert_eq!(image.attributes["aa"], "true");
    }
}

#[test]
fn small_and_odd_sizes() {
    let cli = Cli::new();
    cli.weights();
    for (size, width, height) in [("1x1", 1, 1), ("1x7", 1, 7), ("7x1", 7, 1), ("33x47", 33, 47)] {
        cli.render(&["-o", "a.exr", "--size", size, "--spp", "2", "--denoise", "--weights", "w.safetensors"]);
        let image = cli.image("a.exr");
        assert_eq!((image.width, image.height), (width, height));
        for (name, plane) in &image.channels {
            assert!(plane.iter().all(|v| v.is_finite()), "{size} {name}");
        }
        for png in ["a.png", "a.compare.png"] {
            assert!(cli.bytes(png).starts_with(b"\x89PNG"), "{size} {png}");
        }
    }
    assert_eq!(cli.names(), ["a.compare.png", "a.exr", "a.png", "w.safetensors"]);
}

#[test]
fn the_report_is_one_object_with_everything_in_it() {
    let cli = Cli::new();
    cli.weights();
    let report =
        cli.report(&["--size", "32x32", "--spp", "4", "--denoise", "--weights", "w.safetensors", "--seed", "9"]);
    for name in ["name", "driver", "api_version"] {
        assert!(report["device"][name].is_string(), "{name}");
    }
    assert_eq!(report["limpid"], env!("CARGO_PKG_VERSION"));
    assert_eq!(report["settings"]["seed"], 9);
    assert_eq!(report["settings"]["weights"]["architecture"], "seed");
    for stage in
        ["pipelines", "render_device", "render_wall", "reconstruct_device", "reconstruct_wall", "write", "wall"]
    {
        assert!(report["ms"][stage].as_f64().is_some_and(|ms| ms > 0.0), "{stage}: {}", report["ms"]);
    }
    assert!(report["ms"]["wall"].as_f64() > report["ms"]["render_wall"].as_f64());
    let count = |name: &str| report[name].as_u64().unwrap_or_else(|| panic!("{name}"));
    assert!(count("samples") > 0 && count("samples") <= 32 * 32 * 4);
    assert!(count("rays") > count("samples"));
    assert_eq!(count("invalid_samples"), 0);
    // Four planes of 16 bytes a pixel are the least.
    assert!(count("peak_device_bytes") > 4 * 16 * 32 * 32);
    assert!(!report["skipped"].as_array().expect("a list").is_empty());
    assert!(report["kernels"].is_string());
    assert_eq!(report["outputs"], serde_json::json!(["spheres.exr", "spheres.png", "spheres.compare.png"]));
    assert!(report["interrupted"].is_null());
}

#[test]
fn frames_of_the_animation() {
    let cli = Cli::new();
    let small = ["--size", "24x24", "--spp", "2"];
    cli.render(&[&["spheres:3", "-o", "f.exr", "--frames", "7..9"], &small[..]].concat());
    assert_eq!(cli.names(), ["f.0007.exr", "f.0007.png", "f.0008.exr", "f.0008.png"]);
    let (seventh, eighth) = (cli.image("f.0007.exr"), cli.image("f.0008.exr"));
    assert_ne!(seventh.channels["albedo.R"], eighth.channels["albedo.R"]);
    assert_eq!([&seventh.attributes["frame"], &eighth.attributes["frame"]], ["7", "8"]);
    // A frame does not depend on those before it.
    cli.render(&[&["spheres:3", "-o", "g.exr", "--frames", "8..=8"], &small[..]].concat());
    assert_eq!(cli.bytes("f.0008.exr"), cli.bytes("g.0008.exr"));
    // Frame 0 is the scene.
    cli.render(&[&["spheres:3", "-o", "h.exr", "--frames", "0..1"], &small[..]].concat());
    cli.render(&[&["spheres:3", "-o", "i.exr"], &small[..]].concat());
    assert_eq!(cli.image("h.0000.exr").channels, cli.image("i.exr").channels);
}

#[test]
fn exposure_is_for_the_png_only() {
    let cli = Cli::new();
    for (name, ev) in [("a.exr", "0"), ("b.exr", "-1.5")] {
        cli.render(&["-o", name, "--size", "24x24", "--exposure", ev]);
    }
    assert_eq!(cli.bytes("a.exr"), cli.bytes("b.exr"));
    assert_ne!(cli.bytes("a.png"), cli.bytes("b.png"));
}

#[test]
fn variance_where_asked_for() {
    let cli = Cli::new();
    let args = ["-o", "a.exr", "--size", "16x16", "--sampler", "pcg"];
    cli.render(&[&args[..], &["--variance"]].concat());
    assert!(cli.image("a.exr").channels["variance.G"].iter().any(|v| *v > 0.0));
    cli.render(&args);
    assert!(!cli.image("a.exr").channels.contains_key("variance.G"));
}

#[test]
fn a_render_until_an_error_says_what_it_reached() {
    let cli = Cli::new();
    let args = ["-o", "a.exr", "--size", "32x32", "--until", "0.02"];
    let report = cli.report(&args);
    let frame = &report["frames"][0];
    assert_eq!(frame["reached"], "error");
    let estimate = frame["relmse_estimate"].as_f64().expect("a number");
    assert!(estimate <= 0.02 && estimate > 0.005, "{estimate}");
    let attributes = cli.image("a.exr").attributes;
    // serde_json reads numbers to within a bit.
    let written: f64 = attributes["relmseEstimate"].parse().expect("a number");
    assert!((written / estimate - 1.0).abs() < 1e-12, "{written} {estimate}");
    assert_eq!(attributes["spp"], frame["spp_done"].to_string());
    // Finished for this error and any larger one, not for a smaller one.
    let again = |until: &str| cli.report(&["-o", "a.exr", "--size", "32x32", "--until", until, "--resume"]);
    assert!(again("0.02")["frames"][0]["kept"].is_string());
    assert!(again("0.03")["frames"][0]["kept"].is_string());
    assert_eq!(again("0.01")["frames"][0]["reached"], "error");
    // --spp limits it; a file's own number of samples does not.
    let report = cli.report(&["-o", "b.exr", "--size", "16x16", "--until", "1e-9", "--spp", "9"]);
    assert_eq!([&report["frames"][0]["reached"], &report["frames"][0]["spp_done"]], [&json!("samples"), &json!(9)]);
    std::fs::write(cli.path("s.xml"), cli.ok(&["scene", "spheres"])).expect("written");
    let report = cli.report(&["s.xml", "-o", "c.exr", "--size", "24x24", "--until", "0.004"]);
    assert!(report["frames"][0]["spp_done"].as_u64() > Some(16), "{}", report["frames"][0]);
    let report = cli.report(&["-o", "d.exr", "--size", "16x16", "--time", "50ms"]);
    assert_eq!([&report["frames"][0]["reached"], &report["settings"]["time_s"]], [&json!("time"), &json!(0.05)]);
}

#[test]
fn a_lens_brings_a_camera_ray_a_sample() {
    let cli = Cli::new();
    let lens = "<sensor type=\"thinlens\"><float name=\"aperture_radius\" value=\"0.1\"/><float name=\"focus_distance\" value=\"3\"/>";
    let xml = cli.ok(&["scene", "spheres"]).replace("<sensor type=\"perspective\">", lens);
    std::fs::write(cli.path("s.xml"), xml).expect("written");
    let report = cli.report(&["s.xml", "-o", "a.exr", "--size", "16x16", "--spp", "2"]);
    assert_eq!(report["settings"]["aa"], true);
    assert_eq!(cli.image("a.exr").attributes["aa"], "true");
}
