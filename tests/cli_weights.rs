//! `limpid weights`, and the architecture `base` through the commands.

mod cli_support;

use cli_support::Cli;
use limpid::denoise::Preparation;
use limpid::image::exr;
use limpid::net::architecture::Architecture;
use limpid::net::base::Widths;
use limpid::net::weights::Weights;

const BASE: [&str; 3] = ["--denoise", "--weights", "b.safetensors"];

fn base() -> Architecture {
    Architecture::base(&Widths::default()).unwrap()
}

#[test]
fn conversion_to_tza_and_back_keeps_all_bits() {
    let cli = Cli::new();
    cli.weights_of(&Architecture::base(&Widths::open_image_denoise()).unwrap(), "b.safetensors");
    let convert =
        |from: &str, to: &str, args: &[&str]| drop(cli.ok(&[&["weights", "convert", from, to], args].concat()));
    convert("b.safetensors", "b.tza", &["--precision", "fp32"]);
    convert("b.tza", "c.safetensors", &[]);
    assert_eq!(cli.bytes("c.safetensors"), cli.bytes("b.safetensors"));
    convert("c.safetensors", "c.tza", &["--precision", "fp32"]);
    assert_eq!(cli.bytes("c.tza"), cli.bytes("b.tza"));
    // Half precision is the default, and exact once it is rounded.
    convert("b.safetensors", "h.tza", &[]);
    assert!(cli.bytes("h.tza").len() < cli.bytes("b.tza").len() * 6 / 10);
    convert("h.tza", "h.safetensors", &[]);
    convert("h.safetensors", "i.tza", &[]);
    assert_eq!(cli.bytes("i.tza"), cli.bytes("h.tza"));
}

/// What another program wrote, tensors in another order, becomes the file that limpid writes.
#[test]
fn conversion_to_safetensors_is_canonical() {
    let cli = Cli::new();
    cli.weights();
    let bytes = cli.bytes("w.safetensors");
    let begin = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut header: serde_json::Map<_, _> = serde_json::from_slice(&bytes[8..begin]).unwrap();
    let mut data = Vec::new();
    for (_, tensor) in
        header.iter_mut().filter(|(name, _)| *name != "__metadata__").collect::<Vec<_>>().into_iter().rev()
    {
        let [from, to] = [0, 1].map(|i| begin + tensor["data_offsets"][i].as_u64().unwrap() as usize);
        tensor["data_offsets"] = serde_json::json!([data.len(), data.len() + to - from]);
        data.extend_from_slice(&bytes[from..to]);
    }
    let header = serde_json::to_vec(&header).unwrap();
    let shuffled = [&(header.len() as u64).to_le_bytes(), &header[..], &data].concat();
    assert_ne!(shuffled, bytes);
    std::fs::write(cli.path("shuffled.safetensors"), shuffled).unwrap();
    cli.ok(&["weights", "convert", "shuffled.safetensors", "again.safetensors"]);
    assert_eq!(cli.bytes("again.safetensors"), bytes);
}

/// The weights shipped with limpid are found by name; a file of that name is `./NAME`.
#[test]
fn shipped_weights_have_names() {
    let cli = Cli::new();
    for name in ["kpn", "seed", "base"] {
        let info = cli.json(&["weights", "info", name, "--json"]);
        assert_eq!(info["architecture"], name);
        let file = format!("{name}.safetensors");
        std::fs::copy(format!("{}/weights/{file}", env!("CARGO_MANIFEST_DIR")), cli.path(&file)).unwrap();
        for (output, weights) in [("a.exr", name), ("b.exr", &file)] {
            let picture = ["render", "spheres:3", "-o", output, "--size", "32x32", "--spp", "1"];
            cli.ok(&[&picture[..], &["--denoise", "--weights", weights]].concat());
        }
        assert_eq!(cli.bytes("a.exr"), cli.bytes("b.exr"), "{name}");
    }
    cli.fails(&["weights", "info", "./seed"], 2, &["./seed"]);
}

#[test]
fn what_cannot_be_converted() {
    let cli = Cli::new();
    cli.weights();
    let mut base = Weights::glorot(&base(), 1);
    base.save(&cli.path("none.safetensors")).unwrap();
    base.metadata.extend(Preparation::OPEN_IMAGE_DENOISE.metadata());
    base.metadata.insert("transfer".into(), "log1p".into());
    base.save(&cli.path("log1p.safetensors")).unwrap();
    std::fs::write(cli.path("cut.tza"), b"\xd7\x41\x02").unwrap();
    let fails = |from: &str, to: &str, parts: &[&str]| cli.fails(&["weights", "convert", from, to], 2, parts);
    fails("w.safetensors", "a.tza", &["w.safetensors", "radiance,albedo,normal", "pu"]);
    fails("none.safetensors", "a.tza", &["none.safetensors", "inputs", "none"]);
    fails("log1p.safetensors", "a.tza", &["log1p.safetensors", "transfer `pu`"]);
    fails("cut.tza", "a.tza", &["one must end in .safetensors"]);
    fails("w.safetensors", "a.onnx", &["a.onnx", ".safetensors or .tza"]);
    fails("w.safetensors", "none/a.tza", &["none", "create it"]);
    fails("cut.tza", "a.safetensors", &["cut.tza", "past the end"]);
    fails("missing.tza", "a.safetensors", &["missing.tza"]);
}

#[test]
fn info_prints_what_a_file_holds() {
    let cli = Cli::new();
    cli.weights_of(&Architecture::base(&Widths::open_image_denoise()).unwrap(), "b.safetensors");
    cli.ok(&["weights", "convert", "b.safetensors", "b.tza"]);
    for file in ["b.safetensors", "b.tza"] {
        let info = cli.json(&["weights", "info", file, "--json"]);
        assert_eq!(info["architecture"], "base:32,48,64,80,96,112,96,64,64,64,32");
        assert_eq!((&info["parameters"], &info["kmac_per_pixel"]), (&919_811.into(), &125.4.into()));
        assert_eq!(info["metadata"]["transfer"], "pu");
    }
    for (name, parts) in [
        (&["seed"][..], ["seed\n", "787617", "180.3", "log1p", "radiance,normal_screen.xy,depth"]),
        (&[], ["kpn\n", "750433", "68.6", "pu", "radiance,albedo,normal"]),
    ] {
        let text = cli.ok(&[&["weights", "info"], name].concat());
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    }
    let convert = ["weights", "convert", "kpn.safetensors", "k.tza"];
    cli.weights_of(&Architecture::kpn(&Widths::default()).unwrap(), "kpn.safetensors");
    cli.fails(&convert, 2, &["kpn.safetensors", "`kpn`", "base"]);
    cli.fails(&["weights", "info", "missing.safetensors"], 2, &["missing.safetensors"]);
}

#[test]
fn denoise_equals_render_denoise_with_base() {
    let cli = Cli::new();
    cli.weights_of(&base(), "b.safetensors");
    let args = ["spheres:5", "--size", "45x33", "--spp", "3"];
    cli.render(&[&args[..], &["-o", "noisy.exr"]].concat());
    cli.render(&[&args[..], &BASE, &["-o", "whole.exr"]].concat());
    // What the network does not read need not be there.
    let mut image = cli.image("noisy.exr");
    ["Nscreen.X", "Nscreen.Y", "Z"].iter().for_each(|name| drop(image.channels.remove(*name)));
    exr::write(&image, cli.path("few.exr")).unwrap();
    let denoise = |input: &str, output: &str| {
        cli.ok(&["denoise", input, "-o", output, "--weights", "b.safetensors", "--validation"]);
        cli.image(output)
    };
    assert_eq!(denoise("noisy.exr", "a.exr"), cli.image("whole.exr"));
    assert_eq!(cli.bytes("a.exr"), cli.bytes("whole.exr"));
    let whole = cli.image("whole.exr");
    assert_eq!(denoise("few.exr", "b.exr").rgb("").unwrap(), whole.rgb("").unwrap());
    let changed = (0..whole.pixel_count()).filter(|&i| whole.channels["G"][i] != whole.channels["noisy.G"][i]).count();
    assert!(changed > whole.pixel_count() / 2, "{changed} pixels changed");
}

#[test]
fn a_missing_channel_is_named() {
    let cli = Cli::new();
    cli.weights();
    cli.weights_of(&base(), "b.safetensors");
    cli.render(&["-o", "a.exr", "--size", "8x8", "--spp", "1"]);
    let mut image = cli.image("a.exr");
    ["N.Y", "N.Z", "Nscreen.X"].iter().for_each(|name| drop(image.channels.remove(*name)));
    exr::write(&image, cli.path("few.exr")).unwrap();
    let fails = |weights: &str, part: &str| {
        let args = ["denoise", "few.exr", "-o", "b.exr", "--weights", weights];
        cli.fails(&args, 2, &["few.exr", part, "limpid render"]);
    };
    fails("b.safetensors", "has no N.Y, N.Z;");
    fails("w.safetensors", "has no Nscreen.X;");
}

/// Trained, resumed, continued and verified; the weights denoise and convert.
#[test]
fn base_trains_and_its_weights_work() {
    let cli = Cli::new();
    let widths = "base:16,16,16,16,16,16,16,16,16,16,16";
    let small =
        ["--batch", "2", "--crop", "32", "--window", "40", "--pool", "2", "--initial", "1", "--reference-spp", "4"];
    let train = |args: &[&str]| cli.ok(&[&["train"], args, &small, &["--validation"]].concat());
    train(&["-o", "b.safetensors", "--architecture", widths, "--steps", "3"]);
    let info = cli.json(&["weights", "info", "b.safetensors", "--json"]);
    assert_eq!(info["architecture"], widths);
    assert_eq!(
        (&info["metadata"]["inputs"], &info["metadata"]["transfer"]),
        (&"radiance,albedo,normal".into(), &"pu".into())
    );
    assert_eq!(info["metadata"]["steps"], "3");
    train(&["--verify", "b.safetensors"]);
    train(&["-o", "b.safetensors", "--resume", "b.checkpoint"]);
    // The file's widths count.
    train(&["-o", "c.safetensors", "--architecture", "base", "--init", "b.safetensors", "--steps", "1"]);
    assert_eq!(cli.json(&["weights", "info", "c.safetensors", "--json"])["architecture"], widths);
    cli.render(&["--size", "20x20", "--spp", "2", "--denoise", "--weights", "c.safetensors", "-o", "a.exr"]);
    cli.ok(&["weights", "convert", "c.safetensors", "c.tza"]);
    let fails = |args: &[&str], parts: &[&str]| {
        cli.fails(&[&["train", "-o", "d.safetensors", "--steps", "1"], args].concat(), 2, parts);
    };
    fails(&["--init", "b.safetensors"], &["b.safetensors", "expected seed", "`base`"]);
    fails(&["--architecture", "bass"], &["bass", "seed, base"]);
    fails(&["--architecture", "base:16"], &["11 numbers", "enc_conv0"]);
    let mut weights = Weights::load(&cli.path("b.safetensors")).unwrap();
    weights.metadata.insert("transfer".into(), "log1p".into());
    weights.save(&cli.path("log1p.safetensors")).unwrap();
    fails(&["--architecture", "base", "--init", "log1p.safetensors"], &["log1p.safetensors", "another transfer"]);
}
