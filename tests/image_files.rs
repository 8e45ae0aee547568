//! EXR and PNG files.

use exr::prelude::WritableImage;
use exr::prelude::{AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Layer, LayerAttributes, Vec2, f16};
use limpid::image::{Image, MAX_SIDE, exr as limpid_exr, file, png};
use proptest::prelude::*;
use std::fs;
use std::path::Path;

/// An image with a distinct value in every place, odd values included.
fn sample(width: u32, height: u32) -> Image {
    let mut image = Image::new(width, height);
    let names = ["R", "G", "B", "noisy.R", "noisy.G", "noisy.B", "N.X", "N.Y", "N.Z", "Nscreen.X", "Z", "variance.R"];
    for (c, name) in names.into_iter().enumerate() {
        let mut plane: Vec<f32> = (0..image.pixel_count()).map(|i| c as f32 + i as f32 * 0.37).collect();
        plane[0] = [f32::NAN, f32::INFINITY, -0.0, 1e-42, f32::MAX, f32::MIN_POSITIVE][c % 6];
        image.channels.insert(name.into(), plane);
    }
    image
}

fn bits(image: &Image) -> Vec<(&String, Vec<u32>)> {
    image.channels.iter().map(|(name, plane)| (name, plane.iter().map(|v| v.to_bits()).collect())).collect()
}

fn files_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn exr_keeps_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    for (width, height) in [(1, 1), (1, 37), (37, 1), (16, 16), (33, 17), (128, 40)] {
        let mut image = sample(width, height);
        let values =
            ["16", "-3", "007", "3000000000", "0.5", "1e-3", "0.1", "inf", "NaN", "nee", "", "ba2aa047ed26e293"];
        for (i, value) in values.into_iter().enumerate() {
            image.attributes.insert(format!("limpid{i}"), value.into());
        }
        image.attributes.insert("device".into(), "llvmpipe (LLVM 15.0.6, 256 bits) \u{ae} \u{3bb}".into());
        image.attributes.insert("a name that is longer than thirty-one characters".into(), "x".into());
        let path = folder.path().join("x.exr");
        limpid_exr::write(&image, &path).unwrap();
        let read = limpid_exr::read(&path).unwrap();
        assert_eq!((read.width, read.height), (width, height));
        assert_eq!(bits(&read), bits(&image));
        assert_eq!(read.attributes, image.attributes);
        assert_eq!(limpid_exr::encode(&image).unwrap(), fs::read(&path).unwrap(), "equal images, equal bytes");
    }
    assert_eq!(files_in(folder.path()), ["x.exr"]);
}

#[test]
fn exr_is_one_flat_part_with_typed_attributes() {
    let mut image = sample(20, 10);
    for (name, value) in [("spp", "16"), ("exposure", "0.5"), ("depth", "ray")] {
        image.attributes.insert(name.into(), value.into());
    }
    let bytes = limpid_exr::encode(&image).unwrap();
    let meta = exr::meta::MetaData::read_from_buffered(&bytes[..], true).unwrap();
    assert_eq!(meta.headers.len(), 1);
    let header = &meta.headers[0];
    let names: Vec<_> = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
    assert_eq!(names, image.channels.keys().cloned().collect::<Vec<_>>());
    use exr::meta::attribute::AttributeValue as Value;
    let mut types: Vec<_> = header.own_attributes.other.iter().map(|(k, v)| (k.to_string(), v.clone())).collect();
    types.sort_by(|a, b| a.0.cmp(&b.0));
    let expected = [("depth", Value::Text("ray".into())), ("exposure", Value::F32(0.5)), ("spp", Value::I32(16))];
    assert_eq!(types, expected.map(|(k, v)| (k.to_string(), v)));
    // All attributes are in the order of their names.
    let position = |name: &str| bytes.windows(name.len()).position(|window| window == name.as_bytes()).unwrap();
    let order = ["channels\0", "compression\0", "dataWindow\0", "depth\0", "exposure\0", "lineOrder\0", "spp\0"];
    assert!(order.map(position).is_sorted(), "{:?}", order.map(position));
}

fn foreign(compression: Compression, samples: fn() -> FlatSamples) -> Vec<u8> {
    let encoding = Encoding { compression, ..Encoding::UNCOMPRESSED };
    let channels = AnyChannels::sort([AnyChannel::new("v.a", samples())].into_iter().collect());
    let layer = Layer::new(Vec2(4, 2), LayerAttributes::default(), encoding, channels);
    let mut bytes = std::io::Cursor::new(Vec::new());
    exr::image::Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn exr_of_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.exr");
    let read = |bytes: Vec<u8>| {
        fs::write(&path, bytes).unwrap();
        limpid_exr::read(&path).map(|mut image| image.channels.remove("v.a").unwrap())
    };
    let half = || FlatSamples::F16((0..8).map(|i| f16::from_f32(i as f32 * 0.25)).collect());
    let uint = || FlatSamples::U32((0..8).collect());
    for compression in [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::PIZ] {
        assert_eq!(read(foreign(compression, half)).unwrap(), (0..8).map(|i| i as f32 * 0.25).collect::<Vec<_>>());
        assert_eq!(read(foreign(compression, uint)).unwrap(), (0..8).map(|i| i as f32).collect::<Vec<_>>());
    }
    let layer = |name: &str| {
        let channels = AnyChannels::sort([AnyChannel::new("R", FlatSamples::F32(vec![0.0; 8]))].into_iter().collect());
        Layer::new(Vec2(4, 2), LayerAttributes::named(name), Encoding::UNCOMPRESSED, channels)
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    let parts = exr::image::Image::empty(exr::meta::header::ImageAttributes::with_size(Vec2(4, 2)));
    parts.with_layer(layer("a")).with_layer(layer("b")).write().to_buffered(&mut bytes).unwrap();
    let error = read(bytes.into_inner()).unwrap_err().to_string();
    assert!(error.contains("2 parts"), "{error}");
}

#[test]
fn broken_exr_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.exr");
    let error = limpid_exr::read(&path).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("x.exr"), "{error}");
    assert!(limpid_exr::read(folder.path()).unwrap_err().to_string().contains("directory"));
    let bytes = limpid_exr::encode(&sample(33, 40)).unwrap();
    for length in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
        fs::write(&path, &bytes[..length]).unwrap();
        let error = limpid_exr::read(&path).unwrap_err();
        assert_eq!(error.exit_code(), 2, "cut to {length} of {}: {error}", bytes.len());
        let word = if length < 4 { "not an OpenEXR" } else { "truncated or damaged" };
        assert!(error.to_string().contains(word), "cut to {length}: {error}");
    }
    fs::write(&path, b"\x89PNG\r\n\x1a\n and so on").unwrap();
    assert!(limpid_exr::read(&path).unwrap_err().to_string().contains("not an OpenEXR"));
}

#[test]
fn images_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.exr");
    let change = |f: fn(&mut Image)| {
        let mut image = sample(4, 3);
        f(&mut image);
        let error = limpid_exr::write(&image, &path).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    assert!(change(|i| i.width = 0).contains("0x3"));
    assert!(change(|i| i.channels.clear()).contains("0 channels"));
    assert!(change(|i| i.channels.get_mut("Z").unwrap().truncate(5)).contains("channel 'Z' has 5 values"));
    assert!(change(|i| drop(i.channels.insert(String::new(), vec![0.0; 12]))).contains("channel name"));
    assert!(change(|i| drop(i.attributes.insert("dataWindow".into(), "x".into()))).contains("'dataWindow'"));
    assert!(change(|i| drop(i.attributes.insert("a\0b".into(), "x".into()))).contains("attribute name"));
    assert!(files_in(folder.path()).is_empty());
    let mut image = sample(2, 1);
    assert!(image.channel("no").unwrap_err().to_string().contains("N.X"));
    assert!(image.rgb("albedo").is_err() && !image.has_rgb("albedo") && image.has_rgb("noisy") && image.has_rgb(""));
    image.set_rgb("albedo", [vec![1.0; 2], vec![2.0; 2], vec![3.0; 2]]);
    assert_eq!(image.rgb("albedo").unwrap(), [&[1.0, 1.0], &[2.0, 2.0], &[3.0, 3.0]]);
    assert_eq!(image.rgb("").unwrap()[2], image.channel("B").unwrap());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Changed bytes: an error or an image, never a panic.
    #[test]
    fn damaged_exr_never_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4), header: bool) {
        let mut image = sample(9, 20);
        image.attributes.insert("spp".into(), "16".into());
        let mut bytes = limpid_exr::encode(&image).unwrap();
        let end = if header { 900.min(bytes.len()) } else { bytes.len() };
        edits.into_iter().for_each(|(at, byte)| bytes[at.index(end)] = byte);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.exr");
        fs::write(&path, bytes).unwrap();
        if let Ok(image) = limpid_exr::read(&path) {
            prop_assert!(image.channels.keys().all(|name| image.channel(name).is_ok()));
        }
    }
}

#[test]
fn srgb_values() {
    // IEC 61966-2-1: the linear part, the seam, and 0.5 -> 0.735357, 0.214041 -> 0.5.
    for (linear, display) in
        [(0.0, 0.0), (0.001, 0.01292), (0.003_130_8, 0.04045), (0.214_041_14, 0.5), (0.5, 0.735_357), (1.0, 1.0)]
    {
        assert!((png::srgb_encode(linear) - display).abs() < 1e-5, "{linear}: {}", png::srgb_encode(linear));
    }
    assert_eq!([f32::NAN, -1.0, f32::NEG_INFINITY].map(png::srgb_encode), [0.0; 3]);
    assert_eq!([2.0, f32::INFINITY].map(png::srgb_encode), [1.0; 2]);
    let planes = [vec![0.214_041_14f32, 0.0], vec![1.0, f32::NAN], vec![7.0, 0.001]];
    let planes = planes.each_ref().map(|plane| &plane[..]);
    assert_eq!(png::to_srgb8(planes, 0.0), [128, 255, 255, 0, 0, 3]);
    // 2^-2 of 0.856164 is 0.214041.
    assert_eq!(png::to_srgb8([&[0.856_164_6f32]; 3], -2.0), [128; 3]);
}

#[test]
fn png_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.png");
    let red: Vec<f32> = (0..6).map(|i| i as f32 / 5.0).collect();
    let (green, blue) = (vec![0.5f32; 6], vec![0.0f32; 6]);
    let rgb = [&red[..], &green, &blue];
    png::write(&path, 3, 2, rgb, 0.0).unwrap();
    let picture = image::open(&path).unwrap();
    assert_eq!(picture.color(), image::ColorType::Rgb8);
    let picture = picture.into_rgb8();
    assert_eq!((picture.width(), picture.height()), (3, 2));
    assert_eq!(picture.as_raw(), &png::to_srgb8(rgb, 0.0));
    assert_eq!(picture.get_pixel(0, 1).0, [203, 188, 0], "the first pixel of the second row: sRGB of 0.6 and 0.5");

    png::write_compare(&path, 3, 2, [rgb, [&blue, &blue, &red]], 0.0).unwrap();
    let both = image::open(&path).unwrap().into_rgb8();
    assert_eq!((both.width(), both.height()), (6 + png::SEPARATOR_WIDTH, 2));
    for (y, x) in [(0, 0), (1, 2)] {
        assert_eq!(both.get_pixel(x, y), picture.get_pixel(x, y));
        let red = picture.get_pixel(x, y).0[0];
        assert_eq!(both.get_pixel(3 + png::SEPARATOR_WIDTH + x, y).0, [0, 0, red]);
    }
    assert_eq!(both.get_pixel(3, 0).0, [255; 3]);
    assert!(png::write(&path, 3, 3, rgb, 0.0).is_err());
    assert!(png::write(&path, 0, 0, [&[], &[], &[]], 0.0).is_err());
    assert!(png::write(&path, MAX_SIDE + 1, 1, rgb, 0.0).is_err());
}

#[test]
fn outputs_are_whole_or_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.bin");
    let fail = |out: &mut dyn file::WriteSeek| {
        out.write_all(&[1; 100_000]).unwrap();
        Err(limpid::Error::input("stop"))
    };
    assert!(file::write_atomically(&path, fail).is_err());
    assert!(files_in(folder.path()).is_empty());
    let good = |out: &mut dyn file::WriteSeek| {
        out.write_all(b"whole").unwrap();
        Ok(())
    };
    file::write_atomically(&path, good).unwrap();
    assert!(file::write_atomically(&path, fail).is_err());
    assert_eq!(fs::read(&path).unwrap(), b"whole");
    file::writable(&path).unwrap();
    file::writable(folder.path().join("new.bin")).unwrap();
    assert_eq!(files_in(folder.path()), ["out.bin"]);

    for bad in [folder.path().to_owned(), folder.path().join("no/out.bin"), path.join("below a file"), "".into()] {
        let error = file::writable(&bad).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(&*bad.display().to_string()), "{error}");
        assert!(file::write_atomically(&bad, good).is_err());
    }
}

#[cfg(unix)]
#[test]
fn links_devices_and_rights() {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
    let folder = tempfile::tempdir().unwrap();
    let (path, link) = (folder.path().join("file"), folder.path().join("link"));
    fs::write(&path, "old").unwrap();
    symlink(&path, &link).unwrap();
    let write = |path: &Path| {
        file::write_atomically(path, |out| {
            out.write_all(b"new").unwrap();
            Ok(())
        })
    };
    write(&link).unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(fs::read(&path).unwrap(), b"new");
    let plain = folder.path().join("plain");
    fs::write(&plain, "").unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&path), mode(&plain));

    let null = Path::new("/dev/null");
    file::writable(null).unwrap();
    write(null).unwrap();
    assert!(fs::metadata(null).unwrap().file_type().is_char_device());
    assert!(file::writable("/proc/limpid.exr").is_err());
}
