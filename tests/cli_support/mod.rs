//! Runs the binary in a folder of its own.
#![allow(dead_code)]

use limpid::denoise::Preparation;
use limpid::image::{Image, exr};
use limpid::net::architecture::Architecture;
use limpid::net::weights::Weights;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// A folder and the binary.
pub struct Cli(TempDir);

/// Standard output of a process.
pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).expect("UTF-8")
}

/// Standard error of a process.
pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).expect("UTF-8")
}

impl Cli {
    /// An empty folder.
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The binary, to be run in the folder.
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_limpid"));
        command.args(args).current_dir(self.0.path()).env_remove("RUST_LOG");
        command
    }

    /// Runs it.
    pub fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().expect("limpid runs")
    }

    /// Runs it, which must succeed; its standard output.
    #[track_caller]
    pub fn ok(&self, args: &[&str]) -> String {
        let output = self.run(args);
        assert!(output.status.success(), "{args:?}: {}: {}", output.status, stderr(&output));
        stdout(&output)
    }

    /// `limpid render ARGS` under the validation layer.
    #[track_caller]
    pub fn render(&self, args: &[&str]) -> String {
        self.ok(&[&["render", "--validation"], args].concat())
    }

    /// The JSON object that it prints.
    #[track_caller]
    pub fn json(&self, args: &[&str]) -> serde_json::Value {
        let text = self.ok(args);
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"))
    }

    /// The report of `limpid render ARGS --json`.
    #[track_caller]
    pub fn report(&self, args: &[&str]) -> serde_json::Value {
        let text = self.render(&[args, &["--json"]].concat());
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}"))
    }

    /// Runs it, which must end with `code`, one line on standard error with all `parts`, nothing on standard output and no
    /// file made or changed.
    #[track_caller]
    pub fn fails(&self, args: &[&str], code: i32, parts: &[&str]) {
        self.command_fails(self.command(args), code, parts);
    }

    /// The same for a prepared command.
    #[track_caller]
    pub fn command_fails(&self, mut command: Command, code: i32, parts: &[&str]) {
        let before = self.files();
        let output = command.output().expect("limpid runs");
        let message = stderr(&output);
        let shown = format!("{command:?}: {}: {message}", output.status);
        assert_eq!(output.status.code(), Some(code), "{shown}");
        assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{shown}");
        for part in parts {
            assert!(message.contains(part), "no `{part}` in: {shown}");
        }
        assert_eq!(stdout(&output), "", "{shown}");
        assert!(self.files() == before, "files changed: {shown}");
    }

    /// Names and contents of all files.
    pub fn files(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let entries = std::fs::read_dir(self.0.path()).expect("the folder");
        let mut list: Vec<_> = entries.map(|e| e.expect("an entry").path()).collect();
        list.sort();
        list.into_iter().map(|path| (path.clone(), std::fs::read(&path).unwrap_or_default())).collect()
    }

    /// Names of all files.
    pub fn names(&self) -> Vec<String> {
        let name = |(path, _): (PathBuf, _)| path.file_name().expect("a name").to_string_lossy().into_owned();
        self.files().into_iter().map(name).collect()
    }

    /// A file's bytes.
    #[track_caller]
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// A picture.
    #[track_caller]
    pub fn image(&self, name: &str) -> Image {
        exr::read(self.path(name)).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Writes weights as they are before training; what comes out is no good picture, but it is one.
    pub fn weights(&self) {
        self.weights_of(&Architecture::seed(), "w.safetensors");
    }

    /// The same of any architecture.
    pub fn weights_of(&self, architecture: &Architecture, name: &str) {
        let mut weights = Weights::glorot(architecture, 1);
        weights.metadata.extend(Preparation::of_architecture(architecture).expect("known inputs").metadata());
        weights.save(Path::new(&self.path(name))).expect("saved");
    }
}
