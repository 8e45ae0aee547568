//! `limpid dataset` and `limpid train` as processes: files, logs, signals, sudden death.

mod cli_support;

use cli_support::{Cli, stderr};
use limpid::net::tensor::hash;
use limpid::net::weights::Weights;
use limpid::train::checkpoint;
use serde_json::Value;
use std::collections::BTreeSet;
use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, Stdio};

const DATASET: [&str; 11] =
    ["dataset", "--validation", "-o", "ds", "--count", "2", "--size", "64x32", "--spp", "2", "--reference-spp=4"];
/// Four chunks to train on, by threes.
const PAPER: [&str; 8] = ["train", "--preset", "paper", "--crop", "32", "--batch", "3", "--validation"];
/// A short run on fresh scenes.
const FRESH: [&str; 18] = [
    "train",
    "--validation",
    "--scenes",
    "spheres",
    "--crop",
    "32",
    "--batch",
    "2",
    "--window",
    "32",
    "--initial",
    "1",
    "--pool",
    "1",
    "--reference-spp",
    "2",
    "--steps",
    "4",
];

fn weights(cli: &Cli, name: &str) -> Weights {
    Weights::load(&cli.path(name)).unwrap_or_else(|e| panic!("{e}"))
}

fn bits(cli: &Cli, name: &str) -> Vec<u32> {
    weights(cli, name).parameters.iter().map(|p| p.to_bits()).collect()
}

fn log(cli: &Cli, name: &str) -> Vec<Value> {
    let text = String::from_utf8(cli.bytes(name)).expect("UTF-8");
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"))).collect()
}

/// Numbers of the step lines and of the evaluation lines.
fn steps(log: &[Value]) -> [Vec<u64>; 2] {
    [false, true].map(|evaluation| {
        let of_kind = log.iter().filter(|line| line.get("held_out_loss").is_some() == evaluation);
        of_kind.map(|line| line["step"].as_u64().expect("a number")).collect()
    })
}

fn spawn(cli: &Cli, args: &[&str]) -> Child {
    cli.command(args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("limpid runs")
}

fn kill(child: &Child, signal: &str) {
    let sent = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status().expect("sh runs");
    assert!(sent.success());
}

#[test]
fn a_data_set_says_what_it_did_and_is_kept() {
    let cli = Cli::new();
    let json = [&DATASET[..], &["--json"]].concat();
    let report = cli.json(&json);
    let numbers = |report: &Value| ["noisy_pictures", "targets", "rendered", "kept"].map(|key| report[key].as_u64());
    assert_eq!(numbers(&report), [4, 2, 6, 0].map(Some));
    assert_eq!(numbers(&cli.json(&json)), [4, 2, 0, 6].map(Some));
    // What it holds is what `render` makes of the same scene.
    let n = report["scenes"][0].as_u64().expect("a number");
    let ours = cli.image(&format!("ds/spheres-{n:05}.noisy-0.exr"));
    let seed = &ours.attributes["seed"];
    let scene = format!("spheres:{n}");
    let args =
        [&scene, "-o", "a.exr", "--spp=2", "--size=64x32", "--estimator=cosine", "--sampler=pcg", "--seed", seed];
    cli.render(&args);
    let rendered = cli.image("a.exr");
    assert!(ours.channels == rendered.channels);
    assert_eq!(ours.attributes, rendered.attributes);

    let changed = |flag: &'static str, value: &'static str| [&DATASET[..], &[flag, value]].concat();
    assert_eq!(cli.run(&changed("--count", "3")).status.code(), Some(2), "given twice");
    let other = ["dataset", "-o", "ds", "--count", "2", "--size", "64x32", "--spp", "3", "--reference-spp=4"];
    cli.fails(&other, 2, &["ds: ", "another data set (spp 2, asked for 3)", "name another folder"]);
    std::fs::write(cli.path("file"), "x").unwrap();
    cli.fails(&["dataset", "-o", "file", "--count", "1", "--size", "32x32"], 1, &["file"]);
    cli.fails(&["dataset", "-o", "b", "--count", "0"], 2, &["0 scenes"]);
    cli.fails(&["dataset", "-o", "b", "--spp", "0"], 2, &["--spp"]);
    cli.fails(&["dataset", "-o", "b", "--size", "0x4"], 2, &["--size"]);
    cli.fails(&["dataset"], 2, &["--output"]);
}

#[test]
fn the_paper_s_preset_leaves_weights_log_and_plot() {
    let cli = Cli::new();
    let pictures = ["--count", "2", "--size", "64x32", "--spp", "2", "--reference-spp", "4"];
    let report = cli.json(&[&PAPER[..], &pictures, &["--epochs", "2", "-o", "w.safetensors", "--json"]].concat());
    assert_eq!(cli.names(), ["w.checkpoint", "w.dataset", "w.log.jsonl", "w.safetensors", "w.svg"]);
    // Eight chunks: two epochs of four, by threes.
    assert_eq!((&report["steps"], &report["epochs"], &report["finished"]), (&3.into(), &2.into(), &true.into()));
    let log = log(&cli, "w.log.jsonl");
    assert_eq!(steps(&log), [vec![1, 2, 3], vec![2, 3]]);
    let last = log.last().expect("lines");
    assert_eq!(last, report["evaluations"].as_array().expect("a list").last().expect("two"));
    let metadata = weights(&cli, "w.safetensors").metadata;
    for key in ["loss", "held_out_loss", "mae01", "held_out_mae01"] {
        let value = last[key].as_f64().expect("a number");
        assert!(value > 0.0);
        assert_eq!(metadata[key], format!("{value:.6}"));
    }
    assert_eq!((metadata["preset"].as_str(), metadata["split"].as_str()), ("paper", "scene"));
    assert!(metadata["run"].contains(r#""loss":"mae""#), "{}", metadata["run"]);
    let plot = String::from_utf8(cli.bytes("w.svg")).expect("UTF-8");
    let document = roxmltree::Document::parse(&plot).expect("SVG");
    let words: Vec<&str> = document.descendants().filter_map(|n| n.text()).map(str::trim).collect();
    assert!(["epochs", "held out", "seed, preset paper"].iter().all(|word| words.contains(word)), "{words:?}");

    // Repeated with the data set named: the same bits. Another split: others.
    let named = [&PAPER[..], &["--dataset", "w.dataset", "--epochs", "2"]].concat();
    cli.ok(&[&named[..], &["-o", "again.safetensors"]].concat());
    assert_eq!(bits(&cli, "w.safetensors"), bits(&cli, "again.safetensors"));
    cli.ok(&[&named[..], &["--split", "chunk", "-o", "chunk.safetensors"]].concat());
    assert_ne!(bits(&cli, "w.safetensors"), bits(&cli, "chunk.safetensors"));
    cli.ok(&["train", "--verify", "w.safetensors"]);
    // More epochs of the same run.
    let more =
        ["train", "--resume", "w.checkpoint", "--dataset", "w.dataset", "--epochs", "3", "-o", "more.safetensors"];
    assert_eq!(cli.json(&[&more[..], &["--json"]].concat())["steps"], 4);
}

#[test]
fn what_does_not_fit_is_refused() {
    let cli = Cli::new();
    cli.ok(&DATASET);
    let paper = |more: &[&'static str]| [&PAPER[..], &["-o", "w.safetensors"], more].concat();
    cli.fails(&paper(&["--dataset", "none"]), 2, &["none", "no data set", "limpid dataset -o"]);
    cli.fails(&paper(&["--dataset", "ds", "--count", "3"]), 2, &["--dataset", "--count"]);
    cli.fails(&paper(&["--window", "64"]), 2, &["--window goes with --preset fresh"]);
    cli.fails(&paper(&["--evaluate-every", "64"]), 2, &["--evaluate-every goes with --preset fresh"]);
    cli.fails(&paper(&["--dataset", "ds", "--split", "frame"]), 2, &["--split", "one of scene, chunk"]);
    cli.fails(&paper(&["--dataset", "ds", "--epochs", "0"]), 2, &["--epochs"]);
    let train = |more: &[&'static str]| [&["train", "-o", "w.safetensors"], more].concat();
    for flag in [["--epochs", "1"], ["--dataset", "ds"], ["--split", "chunk"], ["--count", "3"]] {
        cli.fails(&train(&flag), 2, &[flag[0], "goes with --preset paper"]);
    }
    cli.fails(&train(&["--preset", "tape"]), 2, &["one of fresh, paper"]);
    cli.fails(&train(&["--loss", "ssim"]), 2, &["one of mae, multiscale"]);
    cli.fails(&train(&[]), 2, &["--steps N or --minutes M"]);
    cli.fails(&train(&["--steps", "1", "--learning-rate", "nan"]), 2, &["--learning-rate NaN"]);
    // Beyond the first line, which says what is read.
    let ends = |args: &[&str], part: &str| {
        let output = cli.run(args);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        let last = message.lines().last().expect("a line");
        assert!(last.starts_with("error: ") && last.contains(part), "{message}");
    };
    let sized = |flag: &'static str, value: &'static str| {
        ["train", "--preset", "paper", "-o", "w.safetensors", "--dataset", "ds", flag, value]
    };
    ends(&sized("--crop", "48"), "no whole number of chunks of 48x48");
    ends(&sized("--crop", "0"), "no whole number of chunks");
    ends(&sized("--crop", "32,64"), "chunks of one side");
    ends(
        &["train", "--preset", "paper", "-o", "w.safetensors", "--dataset", "ds", "--crop=32", "--batch=0"],
        "batches of 0",
    );
    // A checkpoint goes on with its own data set.
    cli.ok(&paper(&["--dataset", "ds", "--steps", "1"]));
    let other = ["dataset", "-o", "w.dataset", "--count", "2", "--size", "64x32", "--spp", "2", "--reference-spp", "5"];
    cli.ok(&other);
    let resume = ["train", "--resume", "w.checkpoint", "-o", "w.safetensors"];
    ends(&resume, "w.dataset: is not the data set that the run began with");
    let name = std::fs::read_dir(cli.path("ds"))
        .unwrap()
        .map(|e| e.unwrap().path())
        .find(|p| p.extension() == Some("exr".as_ref()));
    std::fs::write(name.expect("a picture"), b"no picture").unwrap();
    ends(&[&resume[..], &["--dataset", "ds"]].concat(), "sha256 differs");
    std::fs::remove_dir_all(cli.path("w.dataset")).unwrap();
    cli.fails(&resume, 2, &["w.dataset", "no data set"]);
}

#[test]
fn a_stopped_run_ends_in_order_and_goes_on_to_the_same_bits() {
    let cli = Cli::new();
    cli.ok(&DATASET);
    let run = |output: &'static str| [&PAPER[..], &["--dataset", "ds", "--epochs", "24", "-o", output]].concat();
    cli.ok(&run("whole.safetensors"));
    let mut args = run("a.safetensors");
    for (signal, code) in [("TERM", 143), ("INT", 130)] {
        let mut child = spawn(&cli, &args);
        // The last line before the first step.
        let messages = BufReader::new(child.stderr.take().expect("piped")).lines();
        assert!(messages.map(|line| line.expect("text")).any(|line| line == "training"));
        kill(&child, signal);
        assert_eq!(child.wait().expect("limpid ends").code(), Some(code));
        let state = checkpoint::load(&cli.path("a.checkpoint")).expect("a checkpoint").0;
        assert!(state.step < 32, "nothing is left to go on with");
        assert_eq!(weights(&cli, "a.safetensors").metadata["steps"], state.step.to_string());
        assert_eq!(steps(&log(&cli, "a.log.jsonl"))[0], (1..=state.step).collect::<Vec<_>>());
        args = vec!["train", "--validation", "--resume", "a.checkpoint", "--dataset", "ds", "-o", "a.safetensors"];
    }
    cli.ok(&args);
    assert_eq!(bits(&cli, "a.safetensors"), bits(&cli, "whole.safetensors"));
    let lines = |name| steps(&log(&cli, name));
    assert_eq!(lines("a.log.jsonl"), lines("whole.log.jsonl"));
    assert_eq!(lines("a.log.jsonl")[1].len(), 24, "one evaluation an epoch");
}

/// What a run's folder shows as it goes.
fn watch(cli: &Cli) -> (usize, BTreeSet<OsString>, Option<(u64, u64)>) {
    let text = std::fs::read_to_string(cli.path("a.log.jsonl")).unwrap_or_default();
    let steps = text.lines().filter(|line| line.contains("device_ms")).count();
    let names = std::fs::read_dir(cli.path(".")).expect("the folder").map(|e| e.expect("an entry").file_name());
    let begun = names.filter(|name| name.to_string_lossy().ends_with(".part")).collect();
    let checkpoint = std::fs::metadata(cli.path("a.checkpoint")).ok().map(|m| (m.ino(), m.len()));
    (steps, begun, checkpoint)
}

/// Killed after a step, while a file is written, when the checkpoint changes: what is there is whole, and goes on.
#[test]
fn a_killed_run_leaves_a_whole_checkpoint() {
    let cli = Cli::new();
    cli.ok(&DATASET);
    let common = ["--dataset", "ds", "--checkpoint-every", "1"];
    let run = |output: &'static str| [&PAPER[..], &common, &["--epochs", "24", "-o", output]].concat();
    cli.ok(&run("whole.safetensors"));
    let mut args = run("a.safetensors");
    let (mut done, mut killed) = (0, 0);
    for i in 0..8 {
        let (_, begun, checkpoint) = watch(&cli);
        let wanted = done as usize + 1 + hash(8, i) as usize % 3;
        let reached = || {
            let now = watch(&cli);
            match i % 4 {
                0 => now.0 >= wanted,
                1 => !now.1.is_subset(&begun),
                _ => now.2 != checkpoint,
            }
        };
        let mut child = spawn(&cli, &args);
        while !reached() && child.try_wait().expect("limpid runs").is_none() {
            std::thread::yield_now();
        }
        child.kill().expect("killed");
        killed += u32::from(child.wait().expect("dead").signal() == Some(9));
        // The first checkpoint may not have been written yet.
        if cli.path("a.checkpoint").exists() {
            let state = checkpoint::load(&cli.path("a.checkpoint")).expect("a whole checkpoint").0;
            assert!(state.step >= done, "{} after {done}", state.step);
            done = state.step;
            args = [&["train", "--resume", "a.checkpoint", "-o", "a.safetensors"], &common[..]].concat();
        }
        if cli.path("a.safetensors").exists() {
            weights(&cli, "a.safetensors");
        }
    }
    assert!(done > 0 && killed > 4, "{killed} kills, {done} steps kept");
    cli.ok(&args);
    assert_eq!(bits(&cli, "a.safetensors"), bits(&cli, "whole.safetensors"));
    assert_eq!(steps(&log(&cli, "a.log.jsonl")), steps(&log(&cli, "whole.log.jsonl")));
}

#[test]
fn evaluations_of_fresh_runs_change_no_bit() {
    let cli = Cli::new();
    cli.ok(&[&FRESH[..], &["--evaluate-every", "0", "-o", "a.safetensors"]].concat());
    cli.ok(&[&FRESH[..], &["--evaluate-every", "3", "-o", "b.safetensors"]].concat());
    assert_eq!(bits(&cli, "a.safetensors"), bits(&cli, "b.safetensors"));
    assert_eq!(steps(&log(&cli, "a.log.jsonl")), [vec![1, 2, 3, 4], vec![]]);
    // Every three steps and at the end.
    let log = log(&cli, "b.log.jsonl");
    assert_eq!(steps(&log), [vec![1, 2, 3, 4], vec![3, 4]]);
    let last = log.last().expect("lines");
    assert!(last["epoch"].is_null());
    assert_ne!(last["loss"], last["held_out_loss"]);
    assert!(!weights(&cli, "a.safetensors").metadata.contains_key("held_out_loss"));
    let metadata = weights(&cli, "b.safetensors").metadata;
    assert_eq!((metadata["preset"].as_str(), metadata["evaluated_at_step"].as_str()), ("fresh", "4"));
    assert!(metadata["run"].contains(r#""loss":"multiscale""#), "{}", metadata["run"]);
    cli.ok(&["train", "--verify", "b.safetensors"]);
}
