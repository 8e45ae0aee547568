//! `limpid bench`: what it reports, not how fast anything is.

mod cli_support;

use cli_support::Cli;
use limpid::net::architecture::Architecture;
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;
use serde_json::Value;

fn rows(report: &Value) -> &Vec<Value> {
    report["rows"].as_array().expect("rows")
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Every convolution stands in the table of every plan, with the operations of the direct convolution.
#[test]
fn layers_add_up_to_the_network() {
    let cli = Cli::new();
    let seed = Architecture::seed();
    let convs = seed.nodes().iter().filter(|n| n.parameters.is_some()).count();
    for plan in ["fused", "unfused"] {
        let args = ["--size", "64x33", "--repeat", "2", "--plan", plan, "--validation", "--json"];
        let layers = cli.json(&[&["bench", "layers"], &args[..]].concat());
        let net = cli.json(&[&["bench", "net"], &args[..]].concat());
        // 33 rows are padded to 64.
        let expected = 2.0 * seed.macs_per_pixel() * 64.0 * 64.0;
        let operations: Vec<f64> = rows(&layers).iter().map(|r| number(&r["operations"])).collect();
        assert_eq!(operations.iter().filter(|o| **o > 0.0).count(), convs, "{plan}");
        assert!((operations.iter().sum::<f64>() / expected - 1.0).abs() < 1e-9, "{plan}");
        assert!((number(&rows(&net)[0]["operations"]) / expected - 1.0).abs() < 1e-9, "{plan}");
        for row in rows(&layers).iter().chain(rows(&net)) {
            let ms = &row["ms"];
            let ordered = number(&ms["min"]) <= number(&ms["median"]) && number(&ms["median"]) <= number(&ms["max"]);
            assert!(ordered && number(&ms["min"]) > 0.0, "{row}");
            assert!(number(&row["bytes"]) > 0.0, "{row}");
        }
        assert!(number(&net["peak_gflops"]) > 0.0);
        let concats = rows(&layers).iter().filter(|r| r["name"].as_str().unwrap().starts_with("concat")).count();
        assert!(if plan == "fused" { concats <= 5 } else { concats == 5 }, "{plan}: {concats}");
    }
}

/// The values that `--values` writes are those of the network: the plain plan's and the fastest plan's agree.
#[test]
fn values_are_what_the_network_makes() {
    let cli = Cli::new();
    cli.weights();
    let values = |plan: &str| -> [Tensor<f32>; 2] {
        let file = format!("{plan}.safetensors");
        let args = ["bench", "net", "--size", "32x32", "--repeat", "1", "--weights", "w.safetensors"];
        cli.ok(&[&args[..], &["--plan", plan, "--values", &file]].concat());
        let bytes = cli.bytes(&file);
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        ["input", "output"].map(|name| {
            let view = file.tensor(name).unwrap();
            let data = view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            Tensor::new(view.shape().try_into().unwrap(), data)
        })
    };
    let (fused, unfused) = (values("fused"), values("unfused"));
    assert_eq!(fused[0], unfused[0]);
    assert_eq!((fused[0].shape, fused[1].shape), ([1, 6, 32, 32], [1, 3, 32, 32]));
    let weights = Weights::load(&cli.path("w.safetensors")).unwrap();
    let outputs = limpid::net::reference::forward(&weights.architecture, &weights.to_f64(), &fused[0].to_f64());
    let expected = outputs.last().unwrap();
    for [_, output] in [&fused, &unfused] {
        let error: f64 = output.data.iter().zip(&expected.data).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum();
        let norm: f64 = expected.data.iter().map(|b| b * b).sum();
        assert!((error / norm).sqrt() < 1e-5, "{}", (error / norm).sqrt());
    }
}

const ERROR: [&str; 12] = [
    "bench",
    "error",
    "-o",
    "e",
    "--size",
    "16x12",
    "--spp",
    "1,4",
    "--only",
    "nee+pcg,cosine+sobol",
    "--reference-spp",
    "64",
];

/// What a run is told to have erred is what its picture errs, against the halves that the folder keeps.
#[test]
fn an_error_benchmark_tells_the_errors_of_the_renders() {
    let cli = Cli::new();
    let report = cli.json(&[&ERROR[..], &["--runs", "2", "--json"]].concat());
    let halves = ["e/reference1.exr", "e/reference2.exr"].map(|name| cli.image(name));
    assert_ne!(halves[0].rgb("").unwrap(), halves[1].rgb("").unwrap());
    let lines = String::from_utf8(cli.bytes("e/runs.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 2 * 2 * 2);
    for run in lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()) {
        let word = |key: &str| run[key].as_str().unwrap().to_owned();
        let (spp, seed) = (run["spp"].to_string(), run["seed"].to_string());
        let args = ["render", "spheres", "--denoise", "--size", "16x12", "-o", "a.exr", "--spp", &spp, "--seed", &seed];
        cli.ok(&[&args[..], &["--estimator", &word("estimator"), "--sampler", &word("sampler")]].concat());
        let image = cli.image("a.exr");
        for (prefix, key) in [("noisy", "noisy"), ("", "reconstructed")] {
            let expected =
                limpid::metrics::compare_halves(&image, prefix, [&halves[0], &halves[1]]).unwrap().all.relmse;
            // Reading JSON may cost the last bit.
            assert!((number(&run[key]["relmse"]) / expected - 1.0).abs() < 1e-15, "{run}: {expected}");
            assert!(number(&run[key]["device_ms"]) > 0.0 && number(&run["rays"]) > 0.0);
        }
    }
    let summary = &report["summary"];
    assert_eq!(summary["lines"].as_array().unwrap().len(), 4);
    let noise = limpid::metrics::reference_noise([&halves[0], &halves[1]]).unwrap().relmse;
    assert!((number(&summary["reference_noise"]) / noise - 1.0).abs() < 1e-15);
    assert_eq!(serde_json::from_slice::<Value>(&cli.bytes("e/summary.json")).unwrap()["summary"], *summary);
    assert!(String::from_utf8(cli.bytes("e/error.svg")).unwrap().contains("cosine+sobol, reconstructed"));
}

/// Runs that are there are kept to the letter, a line that was cut off is taken again, and other settings are refused.
#[test]
fn an_error_benchmark_goes_on() {
    let cli = Cli::new();
    let args = [&ERROR[..], &["--no-denoise"]].concat();
    cli.ok(&[&args[..], &["--runs", "1"]].concat());
    let first = cli.bytes("e/runs.jsonl");
    std::fs::write(cli.path("e/runs.jsonl"), &first[..first.len() - 9]).unwrap();
    let text = cli.ok(&[&args[..], &["--runs", "2"]].concat());
    assert!(text.contains("nee+pcg") && text.contains("relMSE after equal times"), "{text}");
    let whole = first[..first.len() - 1].iter().rposition(|b| *b == b'\n').unwrap() + 1;
    let second = cli.bytes("e/runs.jsonl");
    assert_eq!(second[..whole], first[..whole]);
    let keys = |bytes: &[u8]| -> Vec<String> {
        let runs = bytes.split(|b| *b == b'\n').filter(|line| !line.is_empty());
        let runs = runs.map(|line| serde_json::from_slice::<Value>(line).unwrap());
        let mut keys: Vec<_> =
            runs.map(|r| format!("{} {} {} {}", r["estimator"], r["sampler"], r["spp"], r["seed"])).collect();
        keys.sort();
        keys
    };
    let all = keys(&second);
    assert_eq!(all.len(), 2 * 2 * 2);
    assert!(all.windows(2).all(|pair| pair[0] != pair[1]), "{all:?}");
    let before = cli.bytes("e/reference1.exr");
    for other in [["--size", "16x16"], ["--reference-spp", "32"]] {
        let name = other[0].trim_start_matches("--").replace("size", "height").replace('-', "_");
        let at = args.iter().position(|arg| *arg == other[0]).unwrap();
        let changed = [&args[..at], &other[..], &args[at + 2..]].concat();
        cli.fails(&changed, 2, &["other settings", &name, "another folder"]);
    }
    cli.fails(&ERROR, 2, &["other settings", "weights"]);
    assert_eq!((cli.bytes("e/reference1.exr"), cli.bytes("e/runs.jsonl")), (before, second));
    std::fs::write(cli.path("e/runs.jsonl"), "{}\n").unwrap();
    cli.fails(&args, 2, &["runs.jsonl, line 1", "remove the line"]);
    std::fs::write(cli.path("e/settings.json"), "x").unwrap();
    cli.fails(&args, 2, &["settings.json", "another folder"]);
    cli.fails(&["bench", "error", "-o", "f", "--only", "nee+dice"], 2, &["nee+dice", "cosine+sobol"]);
}

#[test]
fn a_training_step_by_kernel() {
    let cli = Cli::new();
    let args = ["bench", "train", "--batch", "1", "--crop", "32", "--repeat", "1", "--validation", "--json"];
    let report = cli.json(&args);
    let names: Vec<_> = rows(&report).iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(names[0], "training step");
    assert!(["adam", "l1_loss", "pack_weights"].iter().all(|n| names.contains(n)), "{names:?}");
    let expected = 6.0 * Architecture::seed().macs_per_pixel() * 32.0 * 32.0;
    assert!((number(&rows(&report)[0]["operations"]) / expected - 1.0).abs() < 1e-9);
}
