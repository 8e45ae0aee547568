//! Bad arguments and bad input: the exit code, one line that names cause and mend, nothing written.

mod cli_support;

use cli_support::Cli;

#[test]
fn arguments() {
    let cli = Cli::new();
    let fails = |args: &[&str], parts: &[&str]| cli.fails(&[&["render"], args].concat(), 2, parts);
    fails(&["--size", "0x0"], &["0x0", "no pixels", "1 to 16384"]);
    fails(&["--size", "0x5"], &["no pixels"]);
    fails(&["--size", "16385x1"], &["too large", "16384"]);
    fails(&["--size", "99999999999999999999x1"], &["too large"]);
    fails(&["--size", "16384x16384x1"], &["768x768"]);
    fails(&["--size", "768"], &["768x768"]);
    fails(&["--spp", "0"], &["--spp", "1.."]);
    fails(&["--spp", "-4"], &["--spp"]);
    fails(&["--spp", "99999999999"], &["--spp"]);
    fails(&["--bounces", "1025", "--size", "8x8"], &["1025", "0..=1024"]);
    fails(&["--estimator", "magic"], &["magic", "uniform, cosine, nee"]);
    fails(&["--sampler", "halton"], &["halton", "pcg, sobol"]);
    fails(&["--seed", "x"], &["--seed"]);
    fails(&["--exposure", "nan"], &["--exposure", "-64 to 64"]);
    fails(&["--frames", "5..5", "spheres:1"], &["no frame", "A..B"]);
    fails(&["--frames", "0..2"], &["spheres:N"]);
    fails(&["--weights", "w.safetensors"], &["--denoise"]);
    fails(&["--variance"], &["--sampler pcg"]);
    fails(&["--sp", "4"], &["--sp", "--spp"]);
    cli.fails(&["rendr"], 2, &["rendr", "render"]);
    cli.fails(&["denoise"], 2, &["IN.exr"]);
}

#[test]
fn no_command_prints_the_help() {
    let output = Cli::new().run(&[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(cli_support::stderr(&output).contains("Usage: limpid"));
    let help = Cli::new().ok(&["--help"]);
    for command in ["render", "denoise", "train", "compare", "scene", "devices"] {
        assert!(help.contains(&format!("  {command}")), "{help}");
    }
    assert_eq!(Cli::new().ok(&["--version"]), format!("limpid {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn outputs() {
    let cli = Cli::new();
    std::fs::create_dir(cli.path("folder.exr")).unwrap();
    std::fs::create_dir(cli.path("a.png")).unwrap();
    let fails = |output: &str, parts: &[&str]| {
        cli.fails(&["render", "--size", "8x8", "-o", output], 2, parts);
    };
    fails("none/a.exr", &["none", "create it"]);
    fails("folder.exr", &["folder.exr", "is a directory"]);
    fails("a.exr", &["a.png", "is a directory"]);
    fails("b.png", &["b.png", ".exr"]);
    fails(".exr", &[".exr"]);
    fails("/proc/a.exr", &["/proc/a.exr", "cannot write"]);
    cli.fails(&["scene", "-o", "none/s.xml"], 2, &["none", "create it"]);
}

#[test]
fn scenes() {
    let cli = Cli::new();
    let fails = |scene: &str, parts: &[&str]| {
        cli.fails(&["render", scene, "--size", "8x8"], 2, parts);
        cli.fails(&["scene", scene, "-o", "x.xml"], 2, parts);
    };
    fails("none.xml", &["none.xml", "no such file", "spheres:N"]);
    fails("spheres:x", &["spheres:x", "spheres:N"]);
    fails("spheres:-1", &["spheres:-1"]);
    fails(".", &["is a directory"]);
    let xml = cli.ok(&["scene"]);
    let write = |text: &str| std::fs::write(cli.path("s.xml"), text).unwrap();
    write(&xml[..xml.len() / 2]);
    fails("s.xml", &["s.xml"]);
    write("");
    fails("s.xml", &["s.xml"]);
    let line = 1 + xml.lines().position(|line| line.contains("type=\"sphere\"")).expect("a sphere");
    write(&xml.replacen("type=\"sphere\"", "type=\"teapot\"", 1));
    fails("s.xml", &["s.xml", &line.to_string(), "teapot"]);
    // Without the teapot, which is named.
    let report = cli.report(&["s.xml", "--size", "8x8", "--lenient"]);
    let left_out = report["left_out"].as_array().expect("a list");
    assert_eq!(left_out.len(), 1);
    assert!(left_out[0].as_str().expect("text").starts_with(&format!("s.xml:{line}: shape of type 'teapot'")));
    let output = cli.run(&["scene", "s.xml", "--lenient"]);
    assert!(cli_support::stderr(&output).contains(&format!("left out: s.xml:{line}: ")), "{output:?}");
    assert_eq!(cli_support::stdout(&output).matches("<shape").count(), xml.matches("<shape").count() - 1);
    std::fs::write(cli.path("s.xml"), [0xff, 0xfe, 0x00]).unwrap();
    fails("s.xml", &["s.xml", "UTF-8"]);
}

#[test]
fn devices() {
    let cli = Cli::new();
    let list: serde_json::Value = serde_json::from_str(&cli.ok(&["devices", "--json"])).expect("JSON");
    let first = &list["devices"][0];
    let name = first["name"].as_str().expect("a name");
    assert!(first["kernels"].as_array().is_some_and(|kernels| !kernels.is_empty()), "{first}");
    assert!(cli.ok(&["devices"]).contains(name));
    cli.fails(&["render", "--size", "8x8", "--device", "Voodoo 2"], 2, &["Voodoo 2", name]);
    cli.fails(&["render", "--size", "8x8", "--device", "99"], 2, &["99", name]);
    // By number and by a part of the name, in any case.
    for device in ["0", &name[..4].to_uppercase()] {
        let report = cli.report(&["--size", "8x8", "--device", device]);
        assert_eq!(report["device"]["name"], name);
    }
}

#[test]
fn no_vulkan_device() {
    let cli = Cli::new();
    for args in [&["devices"][..], &["render", "--size", "8x8"]] {
        let mut command = cli.command(args);
        command.env("VK_DRIVER_FILES", "/nonexistent.json").env("VK_ICD_FILENAMES", "/nonexistent.json");
        cli.command_fails(command, 1, &["no Vulkan", "mesa-vulkan-drivers"]);
    }
}

#[test]
fn commands_that_do_not_denoise_need_no_weights() {
    let cli = Cli::new();
    cli.render(&["--size", "8x8", "-o", "a.exr"]);
    assert_eq!(cli.names(), ["a.exr", "a.png"]);
}

#[test]
fn a_missing_file_is_named_and_its_cause_said_once() {
    let cli = Cli::new();
    let cases: [&[&str]; 3] = [
        &["denoise", "none", "-o", "a.exr"],
        &["render", "-o", "a.exr", "--denoise", "--weights", "none"],
        &["bench", "net", "--weights", "none"],
    ];
    for args in cases {
        cli.fails(args, 2, &["none: No such file or directory"]);
        let message = cli_support::stderr(&cli.run(args));
        assert_eq!(message.matches("No such file").count(), 1, "{message}");
    }
}
