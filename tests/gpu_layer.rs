//! The gpu layer: data to and from the device, slices, push constants, derived barriers, errors.

mod common;

use common::gpu;
use limpid::gpu::hazard::{self, Event};
use limpid::gpu::{Buffer, DeviceOptions, Gpu, PushMember, Recorder, Slice, list_devices, push_matches};
use limpid::net::kernel::leaky_relu::Push;
use limpid::{Error, shaders};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Bytes without a period that a copy's pieces could share.
fn noise(count: usize) -> Vec<u8> {
    (0..count as u64).map(|i| limpid::net::tensor::hash(7, i) as u8).collect()
}

#[test]
fn buffers_start_at_zero() {
    let gpu = gpu();
    for bytes in [1, 255, 256, 257, 100_000] {
        // A buffer that was written and given back may be what the next one is made of.
        let dirty = gpu.buffer("dirty", bytes).unwrap();
        gpu.upload(&dirty.all(), &noise(bytes as usize)).unwrap();
        drop(dirty);
        let buffer = gpu.buffer("fresh", bytes).unwrap();
        assert_eq!(buffer.bytes(), bytes.next_multiple_of(256));
        assert!(gpu.download::<u8>(&buffer.all()).unwrap().iter().all(|b| *b == 0));
    }
}

/// Staging is 16 MiB: one byte, odd sizes, exactly a piece, one more, and several pieces with a rest.
#[test]
fn data_of_any_size_comes_back() {
    let gpu = gpu();
    for bytes in [1, 3, 255, 257, 65_537, 16 << 20, (16 << 20) + 1, (40 << 20) + 12_345] {
        let data = noise(bytes);
        let buffer = gpu.buffer("data", bytes as u64 + 512).unwrap();
        let slice = buffer.slice(256, bytes as u64);
        gpu.upload(&slice, &data).unwrap();
        assert!(gpu.download::<u8>(&slice).unwrap() == data, "{bytes} bytes");
        let all: Vec<u8> = gpu.download(&buffer.all()).unwrap();
        let outside = all[..256].iter().chain(&all[256 + bytes..]);
        assert!(outside.into_iter().all(|b| *b == 0), "{bytes} bytes: written outside the slice");
    }
}

#[test]
fn a_short_upload_leaves_the_rest() {
    let gpu = gpu();
    let buffer = gpu.buffer("data", 256).unwrap();
    gpu.upload(&buffer.all(), &[1.0f32; 64]).unwrap();
    gpu.upload(&buffer.all(), &[2.0f32; 3]).unwrap();
    let values: Vec<f32> = gpu.download(&buffer.all()).unwrap();
    assert!(values[..3] == [2.0; 3] && values[3..].iter().all(|v| *v == 1.0));
}

fn panics(f: impl FnOnce()) -> bool {
    catch_unwind(AssertUnwindSafe(f)).is_err()
}

#[test]
fn misuse_of_slices_is_caught() {
    let gpu = gpu();
    let buffer = gpu.buffer("b", 1024).unwrap();
    assert_eq!(buffer.slice(256, 700).slice(256, 444).bytes(), 444);
    for (offset, bytes) in [(4, 16), (255, 1), (0, 1025), (1024, 1), (512, 513), (0, 0)] {
        assert!(panics(|| drop(buffer.slice(offset, bytes))), "{offset}+{bytes}");
    }
    assert!(panics(|| drop(buffer.slice(256, 256).slice(256, 1))), "leaves the slice, not the buffer");
    assert!(panics(|| gpu.upload(&buffer.slice(0, 4), &[0u8; 5]).unwrap()));
    assert!(panics(|| drop(gpu.download::<f32>(&buffer.slice(0, 5)))));
    let mut rec = gpu.recorder();
    assert!(panics(|| rec.copy(&buffer.slice(0, 512), &buffer.slice(512, 256))));
}

#[test]
fn push_constants_must_match_in_every_way() {
    let member = |name, ty, offset| PushMember { name, ty, offset };
    let shader = [member("width", "u32", 0), member("scale", "f32", 4)];
    assert!(push_matches(&shader, &shader));
    for host in [
        vec![member("scale", "f32", 0), member("width", "u32", 4)],
        vec![member("widt", "u32", 0), member("scale", "f32", 4)],
        vec![member("width", "i32", 0), member("scale", "f32", 4)],
        vec![member("width", "u32", 0), member("scale", "f32", 8)],
        vec![member("width", "u32", 0)],
        vec![shader[0], shader[1], member("more", "u32", 8)],
        vec![],
    ] {
        assert!(!push_matches(&shader, &host), "{host:?}");
    }
}

/// A buffer of four quarters of 1 KiB, and copies, fills and dispatches among them.
struct Chain {
    gpu: Gpu,
    buffer: Buffer,
    rec: Recorder,
}

const QUARTER: u64 = 1024;

impl Chain {
    fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone(), buffer: gpu.buffer("chain", 4 * QUARTER).unwrap(), rec: gpu.recorder() }
    }

    fn quarter(&self, i: u64) -> Slice {
        self.buffer.slice(i * QUARTER, QUARTER)
    }

    /// `to = leaky_relu(from)`.
    fn dispatch(&mut self, from: &Slice, to: &Slice) {
        let kernel = self.gpu.kernel::<shaders::leaky_relu::Shader>(&Default::default()).unwrap();
        let bind = shaders::leaky_relu::Bind { x: from.clone(), y: to.clone() };
        self.rec.dispatch(&kernel, &bind, &Push { begin: 0, count: (to.bytes() / 16) as u32, slope: 0.5 }, [1, 1, 1]);
    }

    /// `|` for a barrier and a letter for an operation.
    fn finish(self) -> (String, Vec<Event>) {
        let mut commands = self.rec.finish().unwrap();
        let letter = |e: &Event| match e {
            Event::Barrier => '|',
            Event::Operation { name, .. } => name.chars().next().unwrap(),
        };
        commands.run().unwrap();
        (commands.events().iter().map(letter).collect(), commands.events().to_vec())
    }
}

/// What each pair of operations needs, and nothing more.
#[test]
fn barriers_are_where_ranges_conflict() {
    let gpu = gpu();
    let events = |record: &dyn Fn(&mut Chain)| {
        let mut chain = Chain::new(&gpu);
        record(&mut chain);
        chain.finish().0
    };
    type Row<'a> = (&'a str, &'a str, &'a dyn Fn(&mut Chain));
    let cases: [Row; 9] = [
        ("read after write", "l|l", &|c| {
            let [a, b, d] = [0, 1, 2].map(|i| c.quarter(i));
            c.dispatch(&a, &b);
            c.dispatch(&b, &d);
        }),
        ("write after read", "l|l", &|c| {
            let [a, b, d] = [0, 1, 2].map(|i| c.quarter(i));
            c.dispatch(&a, &b);
            c.dispatch(&d, &a);
        }),
        ("write after write", "f|f", &|c| {
            let a = c.quarter(0);
            c.rec.fill_zero(&a);
            c.rec.fill_zero(&a);
        }),
        ("two readers", "ll", &|c| {
            let [a, b, d] = [0, 1, 2].map(|i| c.quarter(i));
            c.dispatch(&a, &b);
            c.dispatch(&a, &d);
        }),
        ("disjoint ranges of one buffer", "ffc", &|c| {
            let [a, b, d, e] = [0, 1, 2, 3].map(|i| c.quarter(i));
            c.rec.fill_zero(&a);
            c.rec.fill_zero(&b);
            c.rec.copy(&d, &e);
        }),
        ("an overlap of 256 bytes", "f|f", &|c| {
            let (first, second) = (c.buffer.slice(0, QUARTER), c.buffer.slice(QUARTER - 256, QUARTER));
            c.rec.fill_zero(&first);
            c.rec.fill_zero(&second);
        }),
        ("an old conflict behind a barrier", "f|cf", &|c| {
            let [a, b, d] = [0, 1, 2].map(|i| c.quarter(i));
            c.rec.fill_zero(&a);
            c.rec.copy(&a, &b);
            c.rec.fill_zero(&d);
        }),
        ("a conflict with all but the last operation", "ff|c", &|c| {
            let [a, b, d] = [0, 1, 2].map(|i| c.quarter(i));
            c.rec.fill_zero(&a);
            c.rec.fill_zero(&b);
            c.rec.copy(&a, &d);
        }),
        ("in place, three times", "l|l|l", &|c| {
            let a = c.quarter(0);
            (0..3).for_each(|_| c.dispatch(&a, &a));
        }),
    ];
    for (what, expected, record) in cases {
        assert_eq!(events(record), expected, "{what}");
    }
}

/// A longer chain over ranges that overlap: its barriers are enough, and none of them can go.
#[test]
fn no_barrier_of_a_chain_can_be_dropped() {
    let gpu = gpu();
    let mut chain = Chain::new(&gpu);
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| chain.quarter(i));
    let halves = chain.buffer.slice(QUARTER, 2 * QUARTER);
    chain.dispatch(&a, &b);
    chain.dispatch(&a, &c);
    chain.rec.fill_zero(&d);
    chain.dispatch(&halves, &d);
    chain.rec.copy(&c, &a);
    chain.dispatch(&a, &c);
    chain.dispatch(&b, &d);
    chain.rec.fill_zero(&halves);
    let (letters, events) = chain.finish();
    assert_eq!(letters, "llf|lc|ll|f");
    hazard::check(&events).unwrap();
    for i in 0..events.len() {
        if matches!(events[i], Event::Barrier) {
            let mut fewer = events.clone();
            fewer.remove(i);
            assert!(hazard::check(&fewer).is_err(), "without the barrier at {i} of {letters}");
        }
    }
}

#[test]
fn chains_compute_what_they_say_and_can_run_again() {
    let gpu = gpu();
    let mut chain = Chain::new(&gpu);
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| chain.quarter(i));
    chain.dispatch(&a, &b);
    chain.rec.copy(&b, &c);
    chain.dispatch(&c, &c);
    chain.rec.fill_zero(&d);
    let mut commands = chain.rec.finish().unwrap();
    for value in [-8.0f32, 3.0] {
        gpu.upload(&a, &[value; 256]).unwrap();
        gpu.upload(&d, &[1.0f32; 256]).unwrap();
        commands.run().unwrap();
        let once = if value < 0.0 { value * 0.5 } else { value };
        let twice = if value < 0.0 { value * 0.25 } else { value };
        for (slice, expected) in [(&a, value), (&b, once), (&c, twice), (&d, 0.0)] {
            assert_eq!(gpu.download::<f32>(slice).unwrap(), [expected; 256]);
        }
    }
}

#[test]
fn every_operation_has_a_time_where_asked() {
    let gpu = gpu();
    let mut chain = Chain::new(&gpu);
    chain.rec.time_each();
    let [a, b] = [0, 1].map(|i| chain.quarter(i));
    chain.dispatch(&a, &b);
    chain.rec.copy(&b, &a);
    chain.rec.fill_zero(&b);
    let timings = chain.rec.finish().unwrap().run().unwrap();
    let names: Vec<&str> = timings.operations.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["leaky_relu", "copy", "fill"]);
    let sum: f64 = timings.operations.iter().map(|(_, ms)| ms).sum();
    // Timestamps follow each other: the parts make up the whole but for the rounding of their sum.
    assert!((sum - timings.device_ms).abs() <= 1e-9 * (1.0 + sum), "{timings:?}");
    assert!(timings.device_ms > 0.0 && timings.device_ms <= timings.wall_ms, "{timings:?}");
}

#[test]
fn an_unknown_device_is_refused_with_the_names_of_the_known() {
    let devices = list_devices().unwrap();
    assert!(!devices.is_empty());
    for wanted in ["no such device".to_owned(), devices.len().to_string()] {
        let options = DeviceOptions { select: Some(wanted.clone()), ..DeviceOptions::default() };
        let error = Gpu::new(&options).err().expect("no such device");
        assert!(matches!(error, Error::Input(_)));
        let message = error.to_string();
        assert!(message.contains(&format!("`{wanted}`")), "{message}");
        for device in &devices {
            assert!(message.contains(&format!("{}: {}", device.index, device.name)), "{message}");
        }
    }
}

#[test]
fn a_device_is_found_by_number_and_by_part_of_its_name() {
    let devices = list_devices().unwrap();
    let usable = devices.iter().find(|d| d.unusable.is_empty()).expect("a usable device");
    let part: String = usable.name.chars().take(6).collect::<String>().to_uppercase();
    for wanted in [usable.index.to_string(), part] {
        let options = DeviceOptions { select: Some(wanted), ..DeviceOptions::default() };
        assert_eq!(Gpu::new(&options).unwrap().info().name, usable.name);
    }
}

#[test]
fn too_large_a_buffer_is_an_error_that_names_it() {
    let gpu = gpu();
    let before = gpu.peak_bytes();
    for bytes in [gpu.info().max_allocation + 1, 1 << 60] {
        let error = gpu.buffer("whale", bytes).err().expect("no device has that much");
        assert!(matches!(error, Error::OutOfMemory(_)), "{error:?}");
        assert!(error.to_string().contains("whale"), "{error}");
    }
    assert_eq!(gpu.peak_bytes(), before);
}

#[test]
fn equal_kernels_are_made_once() {
    // A device of its own: other tests make kernels too.
    let gpu = Gpu::new(&DeviceOptions::default()).unwrap();
    let time_after = |slope| {
        gpu.kernel::<shaders::conv2d::Shader>(&shaders::conv2d::Spec { slope }).unwrap();
        gpu.pipeline_ms()
    };
    let first = time_after(0.25);
    assert!(first > 0.0);
    assert_eq!(time_after(0.25), first);
    assert!(time_after(0.5) > first);
}
