//! The compiled shaders, one module each, written by `build.rs`; `push_block!` checks the host's structs against them.
#![allow(clippy::derivable_impls, reason = "generated: the defaults are the shader's, whatever they are")]

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
