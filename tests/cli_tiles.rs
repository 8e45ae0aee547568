//! `--tile` and `--max-memory` of `limpid denoise` and `limpid render --denoise`.

mod cli_support;

use cli_support::Cli;

const WEIGHTS: [&str; 2] = ["--weights", "w.safetensors"];

/// A noisy picture and its reconstruction as a whole.
fn rendered(cli: &Cli) {
    cli.weights();
    cli.render(&["spheres:5", "--size", "531x61", "--spp", "1", "-o", "noisy.exr"]);
    cli.ok(&[&["denoise", "noisy.exr", "-o", "whole.exr"], &WEIGHTS[..]].concat());
}

fn same(cli: &Cli, a: &str, b: &str) {
    for end in ["exr", "png", "compare.png"] {
        assert_eq!(cli.bytes(&format!("{a}.{end}")), cli.bytes(&format!("{b}.{end}")), "{a} and {b}: {end}");
    }
}

/// One sphere in a corner of nothing: the other tiles are exact as they are.
#[test]
fn tiles_that_were_skipped_are_counted() {
    let cli = Cli::new();
    let scene = r#"<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="45"/><film type="hdrfilm"><rfilter type="box"/></film>
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform></sensor>
      <shape type="sphere"><point name="center" x="-1.3" y="1.3" z="0"/><float name="radius" value="0.2"/><bsdf type="diffuse"/></shape>
      <emitter type="point"><point name="position" x="0" y="2" z="2"/><rgb name="intensity" value="3,3,3"/></emitter>
    </scene>"#;
    std::fs::write(cli.path("corner.xml"), scene).unwrap();
    cli.render(&["corner.xml", "--size", "640x640", "--spp", "2", "-o", "noisy.exr"]);
    let report = cli.json(&["denoise", "noisy.exr", "-o", "a.exr", "--tile", "64", "--json"]);
    let [tiles, skipped] = ["tiles", "skipped"].map(|key| report["tiling"][key].as_u64().expect("a number"));
    assert!(tiles >= 9 && skipped >= tiles - 4 && skipped < tiles, "{skipped} of {tiles}");
}

#[test]
fn tiles_write_the_same_files() {
    let cli = Cli::new();
    rendered(&cli);
    let denoise = |output: &str, flags: &[&str]| {
        let common = ["denoise", "noisy.exr", "-o", output, "--validation", "--json"];
        cli.json(&[&common[..], &WEIGHTS, flags].concat())
    };
    let whole = denoise("a.exr", &[]);
    same(&cli, "a", "whole");
    assert_eq!((&whole["tiling"]["tiles"], &whole["tiling"]["core"][0]), (&1.into(), &531.into()));
    assert_eq!((&whole["settings"]["tile"], &whole["settings"]["max_memory_mib"]), (&().into(), &().into()));
    // Everything that the device held.
    assert_eq!(whole["tiling"]["device_bytes"], whole["peak_device_bytes"]);

    let tiled = denoise("b.exr", &["--tile", "32"]);
    same(&cli, "b", "whole");
    let tiling = &tiled["tiling"];
    assert!(tiling["tiles"].as_u64().unwrap() > 1 && tiling["core"][0] == 32, "{tiling}");
    assert_eq!(tiling["window"][0].as_u64().unwrap(), 32 + 2 * tiling["overlap"].as_u64().unwrap());
    assert_eq!(tiling["device_bytes"], tiled["peak_device_bytes"]);
    assert_eq!(tiled["settings"]["tile"], 32);

    let mib = whole["peak_device_bytes"].as_u64().unwrap() >> 20;
    let bounded = denoise("c.exr", &["--max-memory", &mib.to_string()]);
    same(&cli, "c", "whole");
    assert!(bounded["tiling"]["tiles"].as_u64().unwrap() > 1, "{}", bounded["tiling"]);
    assert!(bounded["peak_device_bytes"].as_u64().unwrap() <= mib << 20, "{bounded}");
    assert_eq!(bounded["settings"]["max_memory_mib"], mib);
}

#[test]
fn a_render_is_reconstructed_in_tiles_too() {
    let cli = Cli::new();
    rendered(&cli);
    let args = ["spheres:5", "--size", "531x61", "--spp", "1", "--denoise", "--tile", "32", "-o", "a.exr"];
    let report = cli.report(&[&args[..], &WEIGHTS].concat());
    same(&cli, "a", "whole");
    assert!(report["tiling"]["tiles"].as_u64().unwrap() > 1, "{}", report["tiling"]);
}

#[test]
fn demands_that_cannot_be_met() {
    let cli = Cli::new();
    rendered(&cli);
    let fails = |flags: &[&str], parts: &[&str]| {
        let common = ["denoise", "noisy.exr", "-o", "a.exr"];
        cli.fails(&[&common[..], &WEIGHTS, flags].concat(), 2, parts);
        let common = ["render", "--size", "531x61", "--spp", "1", "--denoise", "-o", "a.exr"];
        cli.fails(&[&common[..], &WEIGHTS, flags].concat(), 2, parts);
    };
    fails(&["--tile", "100"], &["--tile 100", "multiple of 32", "96 or 128"]);
    fails(&["--tile", "0"], &["--tile", "1.."]);
    fails(&["--tile", "4294967296"], &["--tile"]);
    fails(&["--max-memory", "0"], &["--max-memory", "1.."]);
    fails(&["--max-memory", "1"], &["531x61", "1 MiB", "needs --max-memory"]);
    fails(&["--tile", "32", "--max-memory", "2"], &["--tile 32", "--max-memory 2", "would do"]);
    fails(&["--overlap", "8"], &["--tile"]);
    fails(&["--tile", "32", "--blend"], &["--overlap"]);
    fails(&["--blend"], &["--tile"]);
    fails(&["--tile", "32", "--overlap", "8", "--max-memory", "1000"], &["--overlap", "--max-memory"]);
    fails(&["--tile", "32", "--overlap", "16385"], &["--overlap", "16384"]);
    fails(&["--tile", "32", "--overlap", "0", "--blend"], &["--blend", "--overlap 32"]);
    fails(&["--tile", "100", "--overlap", "8"], &["multiple of 32"]);
    cli.fails(&["render", "--tile", "32", "--overlap", "8"], 2, &["--denoise"]);
    cli.fails(&["render", "--tile", "32"], 2, &["--denoise"]);
    cli.fails(&["render", "--max-memory", "32"], 2, &["--denoise"]);
}

/// An overlap that was given: approximate, which the report says, or exact where it is large enough.
#[test]
fn overlaps() {
    let cli = Cli::new();
    rendered(&cli);
    let denoise = |output: &str, flags: &[&str]| {
        let common = ["denoise", "noisy.exr", "-o", output, "--validation", "--tile", "32", "--overlap"];
        cli.ok(&[&common[..], flags, &WEIGHTS].concat())
    };
    let report = |output: &str, flags: &[&str]| -> serde_json::Value {
        serde_json::from_str(&denoise(output, &[flags, &["--json"]].concat())).expect("JSON")
    };
    let chunks = report("chunks.exr", &["0"]);
    let (tiling, settings) = (&chunks["tiling"], &chunks["settings"]);
    assert_eq!((&tiling["tiles"], &tiling["window"][0]), (&34.into(), &32.into()));
    assert_eq!((&tiling["exact"], &tiling["blend"], &tiling["overlap"]), (&false.into(), &false.into(), &0.into()));
    assert_eq!((&settings["overlap"], &settings["blend"]), (&0.into(), &false.into()));
    assert_eq!(tiling["device_bytes"], chunks["peak_device_bytes"]);
    let needed = tiling["exact_overlap"].as_u64().expect("a number");
    assert!(cli.bytes("chunks.exr") != cli.bytes("whole.exr"), "no seams");

    let blended = report("blended.exr", &["8", "--blend"]);
    assert_eq!((&blended["tiling"]["blend"], &blended["tiling"]["window"][0]), (&true.into(), &64.into()));
    assert!(cli.bytes("blended.exr") != cli.bytes("whole.exr"));
    let text = denoise("blended.exr", &["8", "--blend"]);
    assert!(text.contains("approximate") && text.contains(&needed.to_string()), "{text}");

    let exact = report("exact.exr", &[&needed.to_string()]);
    assert_eq!(exact["tiling"]["exact"], true);
    same(&cli, "exact", "whole");

    let args = ["spheres:5", "--size", "531x61", "--spp", "1", "--denoise", "--tile", "32", "--overlap", "0"];
    let rendered = cli.report(&[&args[..], &["-o", "render.exr"], &WEIGHTS].concat());
    assert_eq!((&rendered["tiling"]["exact"], &rendered["settings"]["overlap"]), (&false.into(), &0.into()));
    same(&cli, "render", "chunks");
}

/// A network that reads albedo and world-space normals.
#[test]
fn base_in_tiles_too() {
    let cli = Cli::new();
    let base = limpid::net::architecture::Architecture::named("base").expect("an architecture");
    cli.weights_of(&base, "base.safetensors");
    let scene = ["spheres:5", "--size", "531x61", "--spp", "1"];
    cli.render(&[&scene[..], &["-o", "noisy.exr"]].concat());
    let weights = ["--weights", "base.safetensors"];
    cli.ok(&[&["denoise", "noisy.exr", "-o", "whole.exr", "--validation"], &weights[..]].concat());
    let report = cli.json(&[&["denoise", "noisy.exr", "-o", "a.exr", "--tile", "32", "--json"], &weights[..]].concat());
    assert!(report["tiling"]["tiles"].as_u64().unwrap() > 1, "{}", report["tiling"]);
    assert_eq!(report["tiling"]["device_bytes"], report["peak_device_bytes"]);
    same(&cli, "a", "whole");
    for (output, flags) in [("b", &["--denoise"][..]), ("c", &["--denoise", "--tile", "32"])] {
        cli.render(&[&scene[..], flags, &weights, &["-o", &format!("{output}.exr")]].concat());
        same(&cli, output, "whole");
    }
}
