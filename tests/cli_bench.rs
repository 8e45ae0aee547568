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

#[test]
fn a_training_step_by_kernel() {
    let cli = Cli::new();
    let args = ["bench", "train", "--batch", "1", "--crop", "32", "--repeat", "1", "--validation", "--json"];
    let report = cli.json(&args);
    let names: Vec<_> = rows(&report).iter().map(|r| r["name"].as_str().unwrap()).collect();
    assert_eq!(names[0], "training step");
    assert!(["adam", "mae_loss", "pack_weights"].iter().all(|n| names.contains(n)), "{names:?}");
    let expected = 6.0 * Architecture::seed().macs_per_pixel() * 32.0 * 32.0;
    assert!((number(&rows(&report)[0]["operations"]) / expected - 1.0).abs() < 1e-9);
}
