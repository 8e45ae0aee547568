//! Vulkan compute, the only place with `ash` and `unsafe`: a device, buffers, kernels and recorded command lists.
//!
//! Errors cover what a caller cannot foresee (no device, no memory, a lost device). Misuse by this crate itself, such as a
//! slice out of its buffer's range, is an assertion. Barriers are never written by hand: [`Recorder`] derives them from the
//! `readonly` and `writeonly` qualifiers of the shaders and from the ranges bound.
#![allow(unsafe_code)]

mod buffer;
mod commands;
mod device;
mod disk;
mod environment;
mod footprint;
pub mod hazard;
mod instance;
mod kernel;
mod matrix;

pub use buffer::{Buffer, Slice};
pub use commands::{Commands, Recorder, Timings};
pub use device::{DeviceInfo, DeviceOptions, Gpu, list_devices};
pub use environment::settings as environment_settings;
pub use footprint::Footprint;
pub use kernel::Kernel;
pub use matrix::MatrixShape;

/// What a shader does with a descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// `readonly`.
    Read,
    /// `writeonly`.
    Write,
    /// No qualifier.
    ReadWrite,
}

/// Texel format of a storage texel buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TexelFormat {
    /// Four floats.
    Rgba32f,
    /// One float.
    R32f,
}

/// How a descriptor is bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// `buffer` block.
    StorageBuffer,
    /// `imageBuffer`; a storage buffer on devices without [`DeviceInfo::texel_views`].
    TexelBuffer(TexelFormat),
}

/// One descriptor of a shader.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// Its field in `Bind`.
    pub name: &'static str,
    /// Binding number in set 0.
    pub binding: u32,
    /// How it is bound.
    pub kind: BindingKind,
    /// What the shader does with it.
    pub access: Access,
}

/// One member of a push-constant block.
#[derive(Clone, Copy, Debug)]
pub struct PushMember {
    /// Name.
    pub name: &'static str,
    /// Rust type.
    pub ty: &'static str,
    /// Byte offset.
    pub offset: usize,
}

/// The buffer ranges of one dispatch, in the order of [`Shader::BINDINGS`].
pub trait Bindings {
    /// The ranges.
    fn slices(&self) -> Vec<&Slice>;
}

/// Values of specialization constants, in the order of [`Shader::SPEC_IDS`].
pub trait Specialization: Copy {
    /// The values as 32-bit words.
    fn words(&self) -> Vec<u32>;
}

/// A compiled shader and its tables; implemented by `build.rs` for every `glsl/**/*.comp`.
pub trait Shader {
    /// Buffer ranges of a dispatch.
    type Bind: Bindings;
    /// Specialization constants.
    type Spec: Specialization;
    /// File stem.
    const NAME: &'static str;
    /// The module, as little-endian words.
    const SPIRV: &'static [u8];
    /// The same module with storage buffers in the place of texel buffers.
    const SPIRV_WITHOUT_TEXELS: &'static [u8];
    /// Descriptors.
    const BINDINGS: &'static [Binding];
    /// Push-constant members.
    const PUSH: &'static [PushMember];
    /// Specialization constant ids.
    const SPEC_IDS: &'static [u32];
}

/// A host struct that equals a shader's push-constant block; made by [`crate::push_block!`].
pub trait PushBlock: bytemuck::Pod {
    /// The shader.
    type Shader: Shader;
}

const fn same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

/// Whether host members equal the shader's, in names, types and offsets. Used by [`crate::push_block!`].
#[must_use]
pub const fn push_matches(shader: &[PushMember], host: &[PushMember]) -> bool {
    if shader.len() != host.len() {
        return false;
    }
    let mut i = 0;
    while i < shader.len() {
        let (s, h) = (&shader[i], &host[i]);
        if !same(s.name, h.name) || !same(s.ty, h.ty) || s.offset != h.offset {
            return false;
        }
        i += 1;
    }
    true
}

/// Declares the push constants of a shader; a name, type or offset that differs from the GLSL does not compile.
#[macro_export]
macro_rules! push_block {
    ($(#[$meta:meta])* $vis:vis struct $name:ident for $shader:path { $($field:ident : $ty:ty),* $(,)? }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name {
            $(#[allow(missing_docs)] pub $field: $ty,)*
        }
        const _: () = {
            use $shader as module;
            const HOST: &[$crate::gpu::PushMember] = &[$($crate::gpu::PushMember {
                name: stringify!($field),
                ty: stringify!($ty),
                offset: std::mem::offset_of!($name, $field),
            }),*];
            assert!(
                $crate::gpu::push_matches(<module::Shader as $crate::gpu::Shader>::PUSH, HOST),
                "push constants differ from the shader's"
            );
            impl $crate::gpu::PushBlock for $name {
                type Shader = module::Shader;
            }
        };
    };
}
