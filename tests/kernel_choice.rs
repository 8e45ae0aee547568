//! Which kernels a device gets: by its facts, by name, and by the self-check, which a wrong result must fail.

mod cli_support;
mod common;

use cli_support::Cli;
use common::gpu;
use limpid::denoise::{Denoiser, Guides, Kernels, Preparation};
use limpid::gpu::{DeviceOptions, Gpu};
use limpid::kernels::check::{Part, Purpose, Row, rows};
use limpid::kernels::{Choice, choose, choose_with};
use limpid::net::architecture::Architecture;
use limpid::net::kernel::Family;
use limpid::net::plan::Plan;
use limpid::net::tensor::Tensor;
use limpid::net::weights::Weights;
use limpid::{Error, Result};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A device that keeps its files in a folder of the test.
fn gpu_with(cache: Option<&Path>) -> Gpu {
    Gpu::new(&DeviceOptions { cache: cache.map(Path::to_owned), ..DeviceOptions::default() }).unwrap()
}

/// What a right kernel makes, off by twice what rounding may do (and a little) in the last element of one part.
fn lying(family: Family, row: &Row, about: Part) -> Result<Tensor> {
    let mut result = truth(family, row)?;
    if row.part == about {
        let bound = row.expected(family).1.data.last().copied().expect("an element");
        *result.data.last_mut().expect("an element") += 2.0 * bound as f32 + 1e-3;
    }
    Ok(result)
}

fn truth(family: Family, row: &Row) -> Result<Tensor> {
    Ok(row.expected(family).0.to_f32())
}

fn unreachable(_: Family, row: &Row) -> Result<Tensor> {
    panic!("{} was checked again", row.case.name)
}

fn faster(gpu: &Gpu) -> Option<Family> {
    let best = Family::choose(gpu.info());
    if best == Family::Portable {
        println!("NOT RUN: the device has no other kernels than `portable`");
    }
    (best != Family::Portable).then_some(best)
}

/// Every file under a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).map(|entries| entries.map(|e| e.unwrap().path()).collect::<Vec<_>>());
    entries.unwrap_or_default().into_iter().flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

/// What is asked for before there is a plan is what the plan then uses, and nothing else: the driver makes no kernel twice
/// and none in vain.
#[test]
fn requested_kernels_are_those_of_the_plan() {
    for (architecture, family) in
        ["seed", "base"].iter().flat_map(|name| Family::all(gpu().info()).into_iter().map(move |f| (*name, f)))
    {
        let gpu = gpu_with(None);
        let mut weights = Weights::glorot(&Architecture::named(architecture).unwrap(), 0);
        weights.metadata.extend(Preparation::of_architecture(&weights.architecture).unwrap().metadata());
        let kernels = Kernels::of(family);
        Plan::request_kernels(&gpu, &weights.architecture, kernels.family, kernels.fusion).unwrap();
        let requested = gpu.kernels();
        if !matches!(family, Family::Cpu { .. }) {
            assert_eq!(requested, [], "only kernels that take long to make are asked for");
            continue;
        }
        assert!(!requested.is_empty());
        let denoiser = Denoiser::with_kernels(&gpu, &weights, kernels, (40, 40)).unwrap();
        let frame = gpu.buffer("frame", 40 * 40 * 16).unwrap().all();
        let planes = vec![frame.clone(); denoiser.preparation().inputs.planes().len() - 1];
        denoiser.record(&frame, &Guides::of_planes(denoiser.preparation().inputs, &planes)).unwrap();
        let convolutions = |(name, _): &(&'static str, Vec<u32>)| *name == "winograd" || name.starts_with("conv2d");
        let used: Vec<_> = gpu.kernels().into_iter().filter(convolutions).collect();
        assert_eq!(requested, used, "{architecture}, {}", family.name());
    }
}

/// The real kernels pass, under the validation layer.
#[test]
fn every_family_of_the_device_passes_its_self_check() {
    let gpu = gpu();
    for family in Family::all(gpu.info()) {
        for purpose in [Purpose::Inference, Purpose::Training] {
            let choice = choose(&gpu, Some(family.name()), purpose).unwrap();
            assert_eq!(choice.family, family);
            assert_eq!(choice.checks.len(), usize::from(family != Family::Portable));
        }
    }
}

#[test]
fn a_wrong_result_of_any_kernel_falls_back_to_portable_and_says_so() {
    let gpu = gpu_with(None);
    let Some(best) = faster(&gpu) else { return };
    for purpose in [Purpose::Inference, Purpose::Training] {
        for wrong in rows(best, purpose) {
            let choice = choose_with(&gpu, None, purpose, |family, row| lying(family, row, wrong.part)).unwrap();
            assert_eq!(choice.family, Family::Portable);
            let [warning] = &choice.warnings()[..] else { panic!("{:?}", choice.warnings()) };
            for part in [best.name(), wrong.part.name(), "`portable`", "off by more than"] {
                assert!(warning.contains(part), "no {part}: {warning}");
            }
            // By name there is no way around.
            let forced = choose_with(&gpu, Some(best.name()), purpose, |family, row| lying(family, row, wrong.part));
            let message = forced.expect_err("refused").to_string();
            assert!(message.contains(best.name()) && message.contains(wrong.part.name()), "{message}");
        }
        let choice = choose_with(&gpu, None, purpose, truth).unwrap();
        assert_eq!((choice.family, choice.warnings()), (best, Vec::new()));
    }
}

#[test]
fn the_verdict_is_remembered_and_a_forced_family_is_checked_again() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = gpu_with(Some(folder.path()));
    let Some(best) = faster(&gpu) else { return };
    let purpose = Purpose::Inference;
    let remembered = |choice: &Choice| choice.checks.iter().map(|check| check.remembered).collect::<Vec<_>>();
    let lie = |family: Family, row: &Row| lying(family, row, Part::Forward);
    let first = choose_with(&gpu, None, purpose, lie).unwrap();
    assert_eq!((first.family, remembered(&first)), (Family::Portable, vec![false]));
    // Another process of the same device.
    let gpu = gpu_with(Some(folder.path()));
    let second = choose_with(&gpu, None, purpose, unreachable).unwrap();
    assert_eq!((second.family, remembered(&second)), (Family::Portable, vec![true]));
    assert_eq!(second.checks[0].failure, first.checks[0].failure);
    // What is wanted for training was not checked yet.
    assert_eq!(remembered(&choose_with(&gpu, None, Purpose::Training, truth).unwrap()), [false]);
    // A failure is not believed where the family is forced; what passes then is believed.
    let forced = choose_with(&gpu, Some(best.name()), purpose, truth).unwrap();
    assert_eq!((forced.family, remembered(&forced)), (best, vec![false]));
    let last = choose_with(&gpu, None, purpose, unreachable).unwrap();
    assert_eq!((last.family, remembered(&last)), (best, vec![true]));
    assert_eq!(choose_with(&gpu, Some(best.name()), purpose, unreachable).unwrap().family, best);
}

#[test]
fn damaged_and_unwritable_files_are_no_errors() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = gpu_with(Some(folder.path()));
    let Some(best) = faster(&gpu) else { return };
    let purpose = Purpose::Inference;
    choose_with(&gpu, None, purpose, truth).unwrap();
    let [file] = &files(folder.path())[..] else { panic!("{:?}", files(folder.path())) };
    for damage in [&b""[..], b"\xff", b"\"pass", b"{\"failed\":"] {
        std::fs::write(file, damage).unwrap();
        let choice = choose_with(&gpu, None, purpose, truth).unwrap();
        assert!(choice.family == best && !choice.checks[0].remembered, "{damage:?}");
    }
    // A file is in the place of the folder.
    let gpu = gpu_with(Some(file));
    let choice = choose_with(&gpu, None, purpose, truth).unwrap();
    assert!(choice.family == best && !choice.checks[0].remembered);
}

/// An error that is none of the kernels' says nothing of them; a lost device does.
#[test]
fn only_a_lost_device_is_remembered_as_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let gpu = gpu_with(Some(folder.path()));
    if faster(&gpu).is_none() {
        return;
    }
    let purpose = Purpose::Inference;
    let full = choose_with(&gpu, None, purpose, |_, _| Err(Error::OutOfMemory("full".into())));
    assert!(matches!(full, Err(Error::OutOfMemory(_))));
    assert!(files(folder.path()).is_empty());
    let lost = choose_with(&gpu, None, purpose, |_, _| Err(Error::DeviceLost("gone".into())));
    assert!(matches!(lost, Err(Error::DeviceLost(_))));
    let next = choose_with(&gpu, None, purpose, unreachable).unwrap();
    assert_eq!(next.family, Family::Portable);
    assert!(next.warnings()[0].contains("gone"), "{:?}", next.warnings());
}

#[test]
fn families_are_a_table_that_ends_with_portable() {
    let gpu = gpu();
    let offers = Family::offers(gpu.info());
    assert_eq!(offers.last().unwrap().family, Ok(Family::Portable));
    for offer in &offers {
        match &offer.family {
            Ok(family) => assert_eq!(family.name(), offer.name),
            Err(why) => assert!(!why.is_empty(), "{}", offer.name),
        }
    }
    let mut discrete = gpu.info().clone();
    (discrete.is_cpu, discrete.subgroup_size) = (false, 32);
    assert_eq!(Family::all(&discrete).first(), Some(&Family::Portable));
    assert!(Family::all(&discrete).iter().all(|family| family.name() != "cpu"));
}

/// A command in a folder of its own, with a cache of its own.
struct Scene {
    cli: Cli,
    cache: TempDir,
}

impl Scene {
    fn new() -> Self {
        let cli = Cli::new();
        cli.weights();
        cli.ok(&["render", "--size", "32x32", "--spp", "1", "-o", "a.exr"]);
        Self { cli, cache: tempfile::tempdir().unwrap() }
    }

    fn denoise(&self, kernels: &[&str]) -> std::process::Command {
        let args = ["denoise", "a.exr", "-o", "b.exr", "--weights", "w.safetensors", "--json"];
        let mut command = self.cli.command(&[&args[..], kernels].concat());
        command.env("XDG_CACHE_HOME", self.cache.path());
        command
    }

    fn report(&self, kernels: &[&str]) -> serde_json::Value {
        let output = self.denoise(kernels).output().unwrap();
        assert!(output.status.success(), "{}", cli_support::stderr(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

#[test]
fn the_command_line_names_kernels() {
    let scene = Scene::new();
    let gpu = gpu();
    for family in Family::all(gpu.info()) {
        let report = scene.report(&["--kernels", family.name()]);
        assert_eq!(report["kernels"], family.name());
        let checks = report["self_checks"].as_array().expect("an array");
        assert_eq!(checks.len(), usize::from(family != Family::Portable));
        assert!(report["ms"]["start"].as_f64().is_some_and(|ms| ms > 0.0), "{report}");
        assert!(checks.iter().all(|check| check["failure"].is_null() && check["kernels"] == family.name()));
    }
    let runs: Vec<_> = Family::offers(gpu.info()).iter().filter(|o| o.family.is_ok()).map(|o| o.name).collect();
    let listed = runs.join(", ");
    for name in ["", "Cpu", "cuda"] {
        scene.cli.command_fails(scene.denoise(&["--kernels", name]), 2, &[&format!("`{name}`"), &listed]);
    }
    for args in [&["bench", "net"][..], &["bench", "train"], &["train", "-o", "t.safetensors", "--steps", "1"]] {
        scene.cli.fails(&[args, &["--kernels", "cuda"]].concat(), 2, &["`cuda`", &listed]);
    }
    scene.cli.fails(&["render", "-o", "c.exr", "--kernels", "portable"], 2, &["--kernels", "--denoise"]);
}

/// A broken verdict or pipeline file, and a cache that is a file, change neither the exit code nor a bit of the result.
#[test]
fn a_broken_cache_is_no_error() {
    let scene = Scene::new();
    scene.report(&[]);
    let right = scene.cli.bytes("b.exr");
    for damage in [&b""[..], b"garbage", &[0xff; 4096]] {
        for file in files(&scene.cache.path().join("limpid/checks")) {
            std::fs::write(file, damage).unwrap();
        }
        for file in files(&scene.cache.path().join("limpid/pipelines")) {
            std::fs::write(file, damage).unwrap();
        }
        scene.report(&[]);
        assert!(scene.cli.bytes("b.exr") == right);
    }
    std::fs::remove_dir_all(scene.cache.path().join("limpid")).unwrap();
    std::fs::write(scene.cache.path().join("limpid"), "a file").unwrap();
    scene.report(&[]);
    assert!(scene.cli.bytes("b.exr") == right);
}

#[test]
fn devices_list_every_family() {
    let cli = Cli::new();
    let report: serde_json::Value = serde_json::from_str(&cli.ok(&["devices", "--json"])).unwrap();
    for device in report["devices"].as_array().expect("devices").iter().filter(|d| d["unusable"] == "") {
        let families = device["families"].as_array().expect("families");
        let runs: Vec<_> = families.iter().filter(|f| f["not_run"].is_null()).collect();
        assert_eq!(runs.iter().filter(|f| f["chosen"] == true).count(), 1, "{device}");
        assert_eq!(device["kernels"].as_array().map(Vec::len), Some(runs.len()));
        for family in families {
            let checked = family["self_check"] == "passed";
            assert_eq!(checked, family["chosen"] == true && family["name"] != "portable", "{family}");
        }
    }
    let text = cli.ok(&["devices"]);
    for family in report["devices"][0]["families"].as_array().expect("families") {
        let line = text.lines().find(|l| l.contains(&format!(" {} ", family["name"].as_str().unwrap())));
        let line = line.unwrap_or_else(|| panic!("{family} is not in {text}"));
        assert_eq!(line.contains("NOT RUN"), !family["not_run"].is_null(), "{line}");
    }
}
