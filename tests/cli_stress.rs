//! `limpid stress`.

mod cli_support;

use cli_support::Cli;
use std::time::Duration;

#[test]
fn cases_are_chosen_and_told() {
    let cli = Cli::new();
    let text = cli.ok(&["stress", "--only", "T9,t3,N1", "--validation"]);
    for part in ["T3   point light", "passed", "T9 ", "N1 ", "3 passed, 0 failed, 0 not run"] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    assert!(!text.contains("T10"), "{text}");
    // Of these only devices with kernels that round to f16 run the second.
    let report = cli.json(&["stress", "--only", "T9,N5", "--json"]);
    assert_eq!(report["command"], "stress");
    let device = &report["devices"][0];
    let [brighter, halves] = &device["cases"].as_array().unwrap()[..] else { panic!("{report}") };
    assert_eq!((brighter["number"].as_str(), brighter["outcome"].as_str()), (Some("T9"), Some("passed")));
    let runs = halves["outcome"] == "passed";
    assert_eq!([&device["passed"], &device["failed"], &device["not_run"]], if runs { [2, 0, 0] } else { [1, 0, 1] });
    assert!(device["device"]["name"].is_string());
    if !runs {
        assert_eq!((halves["number"].as_str(), halves["outcome"].as_str()), (Some("N5"), Some("not_run")));
        assert!(halves["reason"].as_str().unwrap().contains("f16"));
        assert!(cli.ok(&["stress", "--only", "N5"]).contains("f16"));
    }
    let measure = &brighter["measures"][0];
    assert_eq!(
        (measure["value"].as_f64(), measure["bar"].as_f64(), measure["compared"].as_u64()),
        (Some(0.0), Some(0.0), Some(3))
    );
    cli.fails(&["stress", "--only", "T99"], 2, &["T99", "T1, T2"]);
    cli.fails(&["stress", "--all-devices", "--device", "0"], 2, &["--device"]);
}

#[test]
fn every_device_has_a_column() {
    let cli = Cli::new();
    let devices = cli.json(&["devices", "--json"]);
    let usable = devices["devices"].as_array().unwrap().iter().filter(|device| device["unusable"] == "").count();
    let report = cli.json(&["stress", "--only", "T9", "--all-devices", "--json"]);
    assert_eq!(report["devices"].as_array().unwrap().len(), usable);
}

#[cfg(target_os = "linux")]
#[test]
fn a_signal_ends_between_cases() {
    let cli = Cli::new();
    let mut command = cli.command(&["stress", "--only", "T8,T9", "--json"]);
    let child = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    // T8 takes seconds.
    std::thread::sleep(Duration::from_secs(2));
    let killed = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["interrupted"], "SIGINT");
    assert_eq!(report["devices"][0]["cases"].as_array().unwrap().len(), 1);
}
