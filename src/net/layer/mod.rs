//! The layers: each has its definition in f64 here, its shader of the same name in `glsl/net/`, and rows in [`cases`].

mod case;
pub mod concat;
pub mod conv2d;
pub mod demodulate;
pub mod kernel_filter;
pub mod leaky_relu;
pub mod masked_pool2d;
pub mod max_pool2d;
pub mod pu;
pub mod upsample2d;
pub mod winograd;

pub use case::{Bounds, Case, Data, Gradients, Pattern, cases};

/// Declares [`Kind`] and [`Kind::ALL`] from one list, so that no layer can be in one and not in the other.
macro_rules! kinds {
    ($($(#[$doc:meta])* $kind:ident = $name:literal,)*) => {
        /// The kinds of layer.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Kind { $($(#[$doc])* $kind,)* }

        impl Kind {
            /// Every kind, once.
            pub const ALL: &'static [Kind] = &[$(Kind::$kind,)*];

            /// The stem of the layer's files.
            pub fn name(self) -> &'static str {
                match self { $(Kind::$kind => $name,)* }
            }
        }
    };
}

kinds! {
    /// [`conv2d`]
    Conv2d = "conv2d",
    /// [`leaky_relu`]
    LeakyRelu = "leaky_relu",
    /// [`max_pool2d`]
    MaxPool2d = "max_pool2d",
    /// [`upsample2d`]
    Upsample2d = "upsample2d",
    /// [`mod@concat`]
    Concat = "concat",
}
