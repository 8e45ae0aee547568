//! Signals, checkpoints, `--resume`.

mod cli_support;

use cli_support::{Cli, stdout};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

/// Many dispatches of at most about 0.25 s each.
const LONG: [&str; 8] = ["render", "--size", "96x96", "--spp", "1024", "--estimator", "cosine", "--json"];

/// Starts a render, sends the signal once it says that it has begun; exit code and report.
fn interrupt(cli: &Cli, args: &[&str], signal: &str) -> (Option<i32>, serde_json::Value) {
    let mut child = cli.command(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("limpid runs");
    let mut messages = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    messages.read_line(&mut line).expect("a line");
    assert!(line.starts_with("render "), "{line}");
    let sent = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status().expect("sh runs");
    assert!(sent.success());
    let output = child.wait_with_output().expect("limpid ends");
    let report = serde_json::from_str(&stdout(&output)).expect("a report");
    (output.status.code(), report)
}

#[test]
fn an_interrupted_render_resumes_to_the_same_bits() {
    let cli = Cli::new();
    cli.ok(&[&LONG[..], &["-o", "whole.exr"]].concat());
    let args = [&LONG[..], &["-o", "a.exr"]].concat();
    let resumed = [&args[..], &["--resume"]].concat();
    let mut last = 0;
    for (args, signal, code) in [(&args, "TERM", 143), (&resumed, "INT", 130)] {
        let (status, report) = interrupt(&cli, args, signal);
        assert_eq!(status, Some(code), "{report}");
        assert_eq!(report["interrupted"], format!("SIG{signal}"));
        let done = report["frames"][0]["spp_done"].as_u64().expect("samples");
        assert!(done > last && done < 1024, "{report}");
        assert_eq!(report["frames"][0]["spp_resumed"], last);
        last = done;
        assert_eq!(cli.names(), ["a.exr", "a.exr.checkpoint", "a.png", "whole.exr", "whole.png"]);
        let image = cli.image("a.exr");
        assert_eq!(image.attributes["spp"], done.to_string());
        assert!(image.channels.values().flatten().all(|v| v.is_finite()));
    }
    let report: serde_json::Value = serde_json::from_str(&cli.ok(&resumed)).expect("JSON");
    assert!(report["interrupted"].is_null());
    assert_eq!(report["frames"][0]["spp_resumed"], last);
    assert_eq!(cli.names(), ["a.exr", "a.png", "whole.exr", "whole.png"]);
    assert_eq!(cli.bytes("a.exr"), cli.bytes("whole.exr"));
    assert_eq!(cli.bytes("a.png"), cli.bytes("whole.png"));
    // What is finished is kept.
    let report: serde_json::Value = serde_json::from_str(&cli.ok(&resumed)).expect("JSON");
    assert_eq!(report["frames"][0]["kept"], "a.exr");
    assert_eq!(cli.bytes("a.exr"), cli.bytes("whole.exr"));
}

#[test]
fn frames_resume() {
    let cli = Cli::new();
    let mut args = LONG.to_vec();
    args.extend(["spheres:4", "--frames", "0..2", "-o"]);
    cli.ok(&[&args[..], &["whole.exr"]].concat());
    args.push("a.exr");
    let (status, report) = interrupt(&cli, &args, "TERM");
    assert_eq!(status, Some(143), "{report}");
    args.push("--resume");
    cli.ok(&args);
    for frame in ["0000", "0001"] {
        assert_eq!(cli.bytes(&format!("a.{frame}.exr")), cli.bytes(&format!("whole.{frame}.exr")));
    }
    assert!(!cli.names().iter().any(|name| name.ends_with("checkpoint")), "{:?}", cli.names());
}

#[test]
fn other_settings_and_damage_are_refused() {
    let cli = Cli::new();
    let args = [&LONG[..], &["-o", "a.exr"]].concat();
    assert_eq!(interrupt(&cli, &args, "INT").0, Some(130));
    let bytes = cli.bytes("a.exr.checkpoint");
    // Standard error also has the line that says what is rendered: not one line in all.
    let fails = |more: &[&str], part: &str| {
        let output = cli.run(&[&args[..], &["--resume"], more].concat());
        let message = cli_support::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        let last = message.lines().last().expect("a line");
        assert!(last.starts_with("error: a.exr.checkpoint: ") && last.contains(part), "{message}");
    };
    fails(&["--seed", "1"], "another scene, size or settings");
    fails(&["--bounces", "2"], "another scene, size or settings");
    std::fs::write(cli.path("a.exr.checkpoint"), &bytes[..bytes.len() - 1]).unwrap();
    fails(&[], "damaged");
    let mut turned = bytes.clone();
    turned[bytes.len() / 2] ^= 1;
    std::fs::write(cli.path("a.exr.checkpoint"), turned).unwrap();
    fails(&[], "damaged");
    std::fs::write(cli.path("a.exr.checkpoint"), b"").unwrap();
    fails(&[], "not a checkpoint");
}

#[test]
fn resume_without_a_checkpoint_renders_anew() {
    let cli = Cli::new();
    let args = ["--size", "16x16", "--spp", "2", "-o", "a.exr", "--resume"];
    cli.render(&args);
    let first = cli.bytes("a.exr");
    // Another setting: not kept.
    let report = cli.report(&[&args[..], &["--seed", "5"]].concat());
    assert!(report["frames"][0]["kept"].is_null(), "{report}");
    assert_ne!(cli.bytes("a.exr"), first);
}
