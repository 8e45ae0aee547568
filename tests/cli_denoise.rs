//! `limpid denoise` and `limpid compare`.

mod cli_support;

use cli_support::Cli;
use limpid::denoise::exact_pixels;
use limpid::image::{Image, exr};

const DENOISE: [&str; 3] = ["--denoise", "--weights", "w.safetensors"];

fn denoise(cli: &Cli, input: &str, output: &str) {
    cli.ok(&["denoise", input, "-o", output, "--weights", "w.safetensors", "--validation"]);
}

#[test]
fn denoise_equals_render_denoise() {
    let cli = Cli::new();
    cli.weights();
    for camera in [&[][..], &["--aa"][..]] {
        let args = [&["spheres:5", "--size", "45x33", "--spp", "3"], camera].concat();
        cli.render(&[&args[..], &["-o", "noisy.exr"]].concat());
        cli.render(&[&args[..], &DENOISE, &["-o", "whole.exr"]].concat());
        denoise(&cli, "noisy.exr", "a.exr");
        assert_eq!(cli.bytes("a.exr"), cli.bytes("whole.exr"), "{camera:?}");
        assert_eq!(cli.bytes("a.compare.png"), cli.bytes("whole.compare.png"), "{camera:?}");
        // A picture that was reconstructed before begins with its noisy channels.
        denoise(&cli, "whole.exr", "b.exr");
        assert_eq!(cli.bytes("b.exr"), cli.bytes("whole.exr"), "{camera:?}");
        let (noisy, whole) = (cli.image("noisy.exr"), cli.image("whole.exr"));
        assert_eq!(noisy.rgb("").unwrap(), whole.rgb("noisy").unwrap());
        let changed = |i: usize| whole.channels["G"][i] != whole.channels["noisy.G"][i];
        let pixels = exact_pixels(&whole, "noisy").unwrap();
        let exact = |i: usize| pixels[i];
        let count = |f: &dyn Fn(usize) -> bool| (0..whole.pixel_count()).filter(|&i| f(i)).count();
        assert_eq!(count(&|i| exact(i) && changed(i)), 0, "{camera:?}");
        assert!(count(&exact) > 0, "{camera:?}: no exact pixel to speak of");
        assert!(count(&|i| changed(i)) > whole.pixel_count() / 2, "{camera:?}");
        // Next to a surface, what shows nothing is exact with the one ray of a pixel alone.
        let [r, g, b] = whole.rgb("albedo").unwrap();
        let nothing = |i: usize| r[i] + g[i] + b[i] + whole.channels["noisy.G"][i] == 0.0 && !exact(i);
        assert_eq!(count(&|i| nothing(i) && changed(i)) > 0, !camera.is_empty());
    }
}

#[test]
fn where_nothing_is_noisy_nothing_is_reconstructed() {
    let cli = Cli::new();
    cli.weights();
    let report = cli.report(&[&DENOISE[..], &["-o", "a.exr", "--size", "24x24", "--bounces", "0"]].concat());
    let skipped = report["skipped"].to_string();
    assert!(skipped.contains("reconstruction"), "{skipped}");
    assert_eq!(report["ms"]["reconstruct_device"], 0.0);
    let image = cli.image("a.exr");
    assert_eq!(image.rgb("").unwrap(), image.rgb("noisy").unwrap());
    denoise(&cli, "a.exr", "b.exr");
    assert_eq!(cli.bytes("a.exr"), cli.bytes("b.exr"));
}

/// Whatever another program left in a file: counted, and gone; in pixels that count as exact too.
#[test]
fn bad_pixels_are_repaired_and_counted() {
    let cli = Cli::new();
    cli.weights();
    cli.render(&["-o", "a.exr", "--size", "40x24", "--spp", "1"]);
    let count = |image: &Image, name: &str| image.channels[name].iter().filter(|v| !v.is_finite() || **v < 0.0).count();
    for (bounces, expected) in [("8", 7), ("0", 7), ("8", 0)] {
        let mut image = cli.image("a.exr");
        image.attributes.insert("bounces".into(), bounces.into());
        for (i, value) in
            [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, -0.0].into_iter().enumerate().take(expected)
        {
            image.channels.get_mut("G").unwrap()[17 + 100 * i] = value;
        }
        // The first pixels are outside of the box: nothing, so exact.
        for pixel in 0..expected.min(3) {
            image.channels.get_mut("R").unwrap()[pixel] = f32::NAN;
        }
        exr::write(&image, cli.path("bad.exr")).unwrap();
        let report =
            cli.json(&["denoise", "bad.exr", "-o", "b.exr", "--weights", "w.safetensors", "--validation", "--json"]);
        assert_eq!(report["repaired_pixels"], expected, "{bounces} bounces");
        let clean = cli.image("b.exr");
        assert_eq!(["R", "G", "B"].map(|name| count(&clean, name)), [0; 3]);
        if expected > 0 || bounces == "8" {
            assert_eq!(clean.attributes["repairedPixels"], expected.to_string());
        }
    }
    let report = cli.report(&[&DENOISE[..], &["-o", "c.exr", "--size", "24x24", "--spp", "1"]].concat());
    assert_eq!((report["repaired_pixels"].as_u64(), &*cli.image("c.exr").attributes["repairedPixels"]), (Some(0), "0"));
}

#[test]
fn what_cannot_be_denoised() {
    let cli = Cli::new();
    cli.weights();
    cli.render(&["-o", "a.exr", "--size", "8x8", "--spp", "1"]);
    let mut image = cli.image("a.exr");
    image.channels.remove("Z");
    image.channels.remove("albedo.G");
    exr::write(&image, cli.path("b.exr")).unwrap();
    let run = |input: &str, weights: &str, parts: &[&str]| {
        cli.fails(&["denoise", input, "-o", "c.exr", "--weights", weights], 2, parts);
    };
    run("b.exr", "w.safetensors", &["b.exr", "albedo.G, Z", "limpid render"]);
    run("none.exr", "w.safetensors", &["none.exr"]);
    run("a.exr", "none.safetensors", &["none.safetensors"]);
    let bytes = cli.bytes("w.safetensors");
    std::fs::write(cli.path("cut.safetensors"), &bytes[..bytes.len() / 2]).unwrap();
    run("a.exr", "cut.safetensors", &["cut.safetensors", "not a whole safetensors file"]);
    let bytes = cli.bytes("a.exr");
    for length in [0, 3, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(cli.path("cut.exr"), &bytes[..length]).unwrap();
        run("cut.exr", "w.safetensors", &["cut.exr"]);
    }
    std::fs::write(cli.path("cut.exr"), cli.bytes("a.png")).unwrap();
    run("cut.exr", "w.safetensors", &["cut.exr", "not an OpenEXR file"]);
}

#[test]
fn weights_of_other_inputs_are_refused() {
    use limpid::net::{architecture::Architecture, weights::Weights};
    let cli = Cli::new();
    let mut weights = Weights::glorot(&Architecture::seed(), 1);
    weights.save(&cli.path("a.safetensors")).unwrap();
    weights.metadata.insert("inputs".into(), "smell".into());
    weights.save(&cli.path("b.safetensors")).unwrap();
    let run = |file: &str, found: &str| {
        cli.fails(&["render", "--size", "8x8", "--denoise", "--weights", file], 2, &[file, "inputs", found]);
    };
    run("a.safetensors", "none");
    run("b.safetensors", "smell");
}

/// Shipped weights go by their names, whatever lies in the folder; a path is always a file.
#[test]
fn shipped_weights_go_by_name() {
    let cli = Cli::new();
    cli.ok(&["render", "--size", "16x16", "--spp", "1", "-o", "a.exr"]);
    let described = |weights: &[&str]| -> serde_json::Value {
        let args = [&["denoise", "a.exr", "-o", "b.exr", "--json"], weights].concat();
        serde_json::from_str::<serde_json::Value>(&cli.ok(&args)).expect("JSON")["settings"]["weights"].clone()
    };
    let base = described(&["--weights", "base"]);
    assert_eq!((&base["file"], &base["architecture"]), (&"base".into(), &"base".into()));
    let [kpn, seed, default] = [&["--weights", "kpn"][..], &["--weights", "seed"], &[]].map(described);
    assert_eq!((&kpn["architecture"], &kpn["sha256"]), (&"kpn".into(), &default["sha256"]));
    assert_eq!(seed["architecture"], "seed");
    assert!(seed["sha256"] != base["sha256"] && kpn["sha256"] != base["sha256"]);
    cli.fails(&["denoise", "a.exr", "-o", "b.exr", "--weights", "./base"], 2, &["./base"]);
    std::fs::copy(cli.path("a.exr"), cli.path("base")).unwrap();
    assert_eq!(described(&["--weights", "base"]), base);
    cli.fails(&["denoise", "a.exr", "-o", "b.exr", "--weights", "./base"], 2, &["./base", "safetensors"]);
}

#[test]
fn comparisons() {
    let cli = Cli::new();
    cli.weights();
    cli.render(&[&["-o", "a.exr", "--size", "40x40", "--spp", "2"], &DENOISE[..]].concat());
    cli.render(&["-o", "r.exr", "--size", "40x40", "--spp", "64", "--seed", "1"]);
    let report: serde_json::Value =
        serde_json::from_str(&cli.ok(&["compare", "a.exr", "r.exr", "--json"])).expect("JSON");
    let expected = limpid::metrics::compare(&cli.image("a.exr"), &cli.image("r.exr")).unwrap();
    assert_eq!(report["all"], printed(&expected.all));
    assert_eq!(report["surface"], printed(&expected.surface));
    let noisy = limpid::metrics::compare_channels(&cli.image("a.exr"), "noisy", &cli.image("r.exr"), "").unwrap();
    assert_eq!(report["noisy"], printed(&noisy));
    let text = cli.ok(&["compare", "a.exr", "r.exr"]);
    assert!(text.contains(&format!("{:.6}", expected.all.mae01)) && text.contains("noisy surface"), "{text}");
    let same: serde_json::Value =
        serde_json::from_str(&cli.ok(&["compare", "r.exr", "r.exr", "--json"])).expect("JSON");
    assert_eq!(same["all"]["mae01"], 0.0);
    assert!(same["all"]["psnr"].is_null());
    let help = cli.ok(&["compare", "--help"]);
    for figure in ["mae01", "relmse", "psnr", "ssim", "flip"] {
        assert!(help.contains(&format!("  {figure}")), "{figure}: {help}");
    }
    exr::write(&Image { width: 2, ..image_of_one(2) }, cli.path("s.exr")).unwrap();
    for (flag, parts) in [("--second", ["second reference", "40x40"]), ("--defects", ["40x40", "2x1"])] {
        let args: &[&str] =
            if flag == "--second" { &["a.exr", "r.exr", flag, "s.exr"] } else { &["a.exr", "s.exr", flag] };
        cli.fails(&[&["compare"], args].concat(), 2, &parts);
    }
    cli.fails(&["compare", "a.exr", "r.exr", "--seams", "40"], 2, &["--seams 40", "40x40", "2 to 39"]);
    cli.fails(&["compare", "a.exr", "r.exr", "--seams", "1"], 2, &["--seams", "2.."]);
    cli.fails(&["compare", "a.exr", "s.exr"], 2, &["40x40", "2x1"]);
    cli.fails(&["compare", "a.exr", "none.exr"], 2, &["none.exr"]);
}

#[test]
fn comparisons_of_suites() {
    let cli = Cli::new();
    for (name, seed) in [("a", "0"), ("r", "1"), ("s", "2")] {
        cli.render(&["-o", &format!("{name}.exr"), "--size", "40x30", "--spp", "4", "--seed", seed]);
    }
    let args = ["compare", "a.exr", "r.exr", "--second", "s.exr", "--seams", "16", "--defects"];
    let report = cli.json(&[&args[..], &["--json"]].concat());
    let [a, r, s] = ["a.exr", "r.exr", "s.exr"].map(|name| cli.image(name));
    let expected = limpid::metrics::compare_halves(&a, "", [&r, &s]).unwrap();
    assert_eq!((&report["all"], &report["surface"]), (&printed(&expected.all), &printed(&expected.surface)));
    let noise = limpid::metrics::reference_noise([&r, &s]).unwrap();
    assert_eq!((&report["noise"], &report["second"]), (&printed(&noise), &"s.exr".into()));
    let mean = limpid::metrics::mean_reference([&r, &s]).unwrap();
    let energy = limpid::metrics::seam_energy(a.rgb("").unwrap(), mean.rgb("").unwrap(), 40, 16).unwrap();
    assert_eq!((&report["seam_energy"], &report["chunk"]), (&printed(&energy), &16.into()));
    assert_eq!(report["defects"]["non_finite"], 0);
    let text = cli.ok(&args);
    for part in [format!("{:.6}", noise.mae01), format!("seam energy: {energy:.4}"), "fireflies: ".into()] {
        assert!(text.contains(&part), "{part}: {text}");
    }
    // A pixel that is no number is counted, and leaves no figures; without --defects it is an error.
    let mut broken = a;
    broken.channels.get_mut("G").unwrap()[7] = f32::NAN;
    exr::write(&broken, cli.path("nan.exr")).unwrap();
    let report = cli.json(&["compare", "nan.exr", "r.exr", "--seams", "16", "--defects", "--json"]);
    assert_eq!(report["defects"]["non_finite"], 1);
    assert!(report["all"].is_null() && report["seam_energy"].is_null(), "{report}");
    assert!(cli.ok(&["compare", "nan.exr", "r.exr", "--defects"]).contains("not finite: 1"));
    cli.fails(&["compare", "nan.exr", "r.exr"], 2, &["the image", "(7, 0)"]);
}

/// Numbers as they are after printing and reading.
fn printed(value: &impl serde::Serialize) -> serde_json::Value {
    serde_json::from_str(&serde_json::to_string(value).expect("text")).expect("JSON")
}

fn image_of_one(width: u32) -> Image {
    let mut image = Image::new(width, 1);
    image.set_rgb("", [0.0, 0.5, 1.0].map(|v| vec![v; width as usize]));
    image
}
