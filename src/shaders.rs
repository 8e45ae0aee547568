//! The compiled shaders, one module each, written by `build.rs`; `push_block!` checks the host's structs against them.

include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
