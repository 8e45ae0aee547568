//! Data sets on disk: what is written, what is kept, what is refused.

mod common;
mod dataset_support;

use common::gpu;
use dataset_support::{SEED_INPUTS, load, made, settings, write};
use limpid::image::{Image, exr};
use limpid::train::dataset::{DatasetSettings, Frames, MANIFEST, Manifest, Part, Writer, Written};
use sha2::{Digest, Sha256};
use std::path::Path;

fn files(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let entry = |e: std::io::Result<std::fs::DirEntry>| e.unwrap().path();
    let mut list: Vec<_> = std::fs::read_dir(dir).unwrap().map(entry).collect();
    list.sort();
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    list.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect()
}

#[test]
fn a_data_set_holds_pairs_with_shared_targets() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(2, (40, 24)));
    assert_eq!(manifest.scenes, settings(2, (1, 1)).scenes());
    assert_eq!(files(dir.path()).len(), 2 * 3 + 1);
    for n in manifest.scenes {
        let read = |part: Part| exr::read(dir.path().join(part.file(n))).unwrap();
        let (a, b, target) = (read(Part::Noisy(0)), read(Part::Noisy(1)), read(Part::Target));
        for image in [&a, &b, &target] {
            assert_eq!((image.width, image.height), (40, 24));
            assert_eq!(image.attributes["scene"], format!("spheres:{n}"));
            assert_eq!((&image.attributes["aa"], &image.attributes["bounces"]), (&"false".into(), &"8".into()));
        }
        let kind = |image: &Image| ["estimator", "sampler", "spp"].map(|name| image.attributes[name].clone());
        assert_eq!(
            (kind(&a), kind(&target)),
            (["cosine", "pcg", "2"].map(String::from), ["nee", "sobol", "4"].map(String::from))
        );
        assert_eq!(kind(&a), kind(&b));
        // Other noise, the same first hits: depth and all.
        assert_ne!(a.channels["G"], b.channels["G"]);
        for name in ["Z", "Nscreen.X", "N.Z", "albedo.R"] {
            assert_eq!(a.channels[name], b.channels[name]);
        }
        assert_eq!(target.channels.keys().collect::<Vec<_>>(), ["B", "G", "R"]);
        // What is no surface is exact in all of them.
        let lights =
            (0..40 * 24).filter(|i| ["R", "G", "B"].iter().all(|c| a.channels[&format!("albedo.{c}")][*i] == 0.0));
        lights.for_each(|i| assert_eq!(a.channels["R"][i], target.channels["R"][i]));
    }
}

#[test]
fn what_is_there_is_kept_and_what_is_not_is_made_again() {
    let gpu = gpu();
    let settings = settings(2, (32, 32));
    let (dir, manifest) = made(&gpu, &settings);
    let whole = files(dir.path());
    assert_eq!(write(&gpu, dir.path(), &settings), (manifest.clone(), 0));
    let [a, b] = [Part::Noisy(1).file(manifest.scenes[0]), Part::Target.file(manifest.scenes[1])];
    std::fs::remove_file(dir.path().join(&a)).unwrap();
    let path = dir.path().join(&b);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(write(&gpu, dir.path(), &settings), (manifest.clone(), 2));
    // Without a manifest, what files say of themselves decides.
    std::fs::remove_file(dir.path().join(MANIFEST)).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_eq!(write(&gpu, dir.path(), &settings), (manifest, 1));
    assert!(files(dir.path()) == whole);
}

#[test]
fn a_stopped_data_set_has_no_manifest_and_goes_on() {
    let gpu = gpu();
    let settings = settings(2, (32, 32));
    let (other, _) = made(&gpu, &settings);
    let dir = tempfile::tempdir().unwrap();
    let mut calls = 0;
    let mut writer = Writer::new(&gpu, dir.path(), &settings).unwrap();
    let ended = writer.run(|_, _| {
        calls += 1;
        calls < 4
    });
    assert!(matches!(ended.unwrap(), Written::Stopped));
    let kept = writer.rendered();
    assert!(kept > 0 && kept < 6 && !dir.path().join(MANIFEST).exists(), "{kept}");
    let message = Manifest::of(dir.path()).unwrap_err().to_string();
    assert!(message.contains("no data set") && message.contains("limpid dataset -o"), "{message}");
    assert_eq!(write(&gpu, dir.path(), &settings).1, 6 - kept);
    assert!(files(dir.path()) == files(other.path()));
}

#[test]
fn a_folder_with_another_data_set_is_refused() {
    let gpu = gpu();
    let ours = settings(2, (32, 32));
    let (dir, _) = made(&gpu, &ours);
    let before = files(dir.path());
    let changes = [
        ((|s| s.count = 3) as fn(&mut DatasetSettings), "count 2, asked for 3"),
        (|s| s.width = 64, "width 32, asked for 64"),
        (|s| s.spp = 3, "spp 2, asked for 3"),
        (|s| s.reference_spp = 5, "reference_spp 4, asked for 5"),
        (|s| s.seed = 8, "seed 7, asked for 8"),
    ];
    for manifest in [true, false] {
        if !manifest {
            std::fs::remove_file(dir.path().join(MANIFEST)).unwrap();
        }
        for (change, what) in changes {
            let mut other = ours.clone();
            change(&mut other);
            let refused = Writer::new(&gpu, dir.path(), &other).and_then(|mut writer| writer.run(|_, _| true));
            // Unfinished, two scenes of three are a beginning.
            if !manifest && other.count == 3 {
                assert!(matches!(refused, Ok(Written::Whole(_))));
                std::fs::remove_file(dir.path().join(MANIFEST)).unwrap();
                let third = other.scenes()[2];
                Part::all().for_each(|part| std::fs::remove_file(dir.path().join(part.file(third))).unwrap());
                continue;
            }
            let message = refused.expect_err("another data set").to_string();
            assert!(message.contains("another data set") && message.contains("name another folder"), "{message}");
            assert!(!manifest || message.contains(what), "{message}");
        }
    }
    assert!(files(dir.path()) == before[1..], "the manifest alone is gone");
    for bad in [settings(0, (32, 32)), settings(90_001, (32, 32)), settings(1, (0, 32))] {
        assert!(Writer::new(&gpu, &dir.path().join("new"), &bad).is_err());
        assert!(!dir.path().join("new").exists());
    }
}

/// The manifest as it would be if this file had been written so.
fn forge(dir: &Path, name: &str, bytes: &[u8]) {
    std::fs::write(dir.join(name), bytes).unwrap();
    let mut manifest = Manifest::of(dir).unwrap();
    let sum: String = Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect();
    manifest.files.insert(name.to_owned(), sum);
    std::fs::write(dir.join(MANIFEST), serde_json::to_vec(&manifest).unwrap()).unwrap();
}

#[test]
fn damaged_data_sets_are_refused_by_name() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(1, (32, 32)));
    let dir = dir.path();
    let (noisy, target) = (Part::Noisy(0).file(manifest.scenes[0]), Part::Target.file(manifest.scenes[0]));
    let fails = |parts: &[&str]| {
        let loaded = Manifest::of(dir).and_then(|m| Frames::load(&gpu, SEED_INPUTS(), dir, &m, |_, _| true));
        let message = loaded.err().expect("damaged").to_string();
        assert!(parts.iter().all(|part| message.contains(part)), "no {parts:?} in {message}");
    };
    let original = files(dir);
    let restore = || original.iter().for_each(|(name, bytes)| std::fs::write(dir.join(name), bytes).unwrap());
    for name in [&noisy, &target] {
        let bytes = std::fs::read(dir.join(name)).unwrap();
        std::fs::remove_file(dir.join(name)).unwrap();
        fails(&[name, "is missing", "limpid dataset -o"]);
        for length in [0, 3, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(dir.join(name), &bytes[..length]).unwrap();
            fails(&[name, "sha256 differs"]);
            // A damaged file that the manifest vouches for.
            forge(dir, name, &bytes[..length]);
            fails(&[name]);
            restore();
        }
        std::fs::write(dir.join(name), std::fs::read(dir.join(Part::Noisy(1).file(manifest.scenes[0]))).unwrap())
            .unwrap();
        fails(&[name, "sha256 differs"]);
        restore();
    }
    let mut image = exr::read(dir.join(&noisy)).unwrap();
    image.channels.remove("Z");
    forge(dir, &noisy, &exr::encode(&image).unwrap());
    fails(&[&noisy, "'Z'"]);
    restore();
    let small = Image {
        width: 16,
        height: 16,
        channels: ["R", "G", "B"].map(|c| (c.to_owned(), vec![0.5; 256])).into(),
        ..Image::default()
    };
    forge(dir, &target, &exr::encode(&small).unwrap());
    fails(&[&target, "size"]);
    restore();
    load(&gpu, SEED_INPUTS(), dir);
}

#[test]
fn damaged_manifests_are_refused() {
    let gpu = gpu();
    let (dir, manifest) = made(&gpu, &settings(1, (32, 32)));
    let path = dir.path().join(MANIFEST);
    let text = std::fs::read_to_string(&path).unwrap();
    let refused = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let message = Manifest::of(dir.path()).expect_err(text).to_string();
        assert!(message.contains(MANIFEST) && message.contains("no data set of limpid"), "{message}");
        assert!(Writer::new(&gpu, dir.path(), &manifest.settings).is_err(), "{text}");
    };
    for length in 0..text.trim_end().len() {
        refused(&text[..length]);
    }
    let changed = |from: &str, to: &str| {
        assert!(text.contains(from));
        text.replacen(from, to, 1)
    };
    refused("[]");
    refused("{}");
    refused(&changed("\"limpid_dataset\": 1", "\"limpid_dataset\": 2"));
    refused(&changed("\"count\": 1", "\"count\": 0"));
    refused(&changed("\"count\": 1", "\"count\": 2"));
    refused(&changed("\"count\": 1", "\"count\": -1"));
    refused(&changed("\"width\": 32", "\"width\": 99999"));
    refused(&changed("\"seed\": 7", "\"seed\": 8"));
    refused(&changed(&manifest.scenes[0].to_string(), "90000"));
    let old = changed("\"family_version\": 1", "\"family_version\": 0");
    std::fs::write(&path, old).unwrap();
    let message = Writer::new(&gpu, dir.path(), &manifest.settings).err().expect("another version").to_string();
    assert!(message.contains("family version 0"), "{message}");
}
