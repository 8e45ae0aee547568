//! Enums whose variants have names that users write and files keep.

/// Gives an enum without data a name a variant: `ALL`, `name`, `Display`, and a `FromStr` whose error lists them.
macro_rules! named {
    ($type:ident, $what:literal, $($variant:ident = $name:literal),+ $(,)?) => {
        impl $type {
            /// All of them.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// As it is written.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name),+
                }
            }
        }

        impl std::fmt::Display for $type {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }

        impl std::str::FromStr for $type {
            type Err = $crate::Error;

            fn from_str(text: &str) -> $crate::Result<Self> {
                let found = Self::ALL.iter().find(|value| value.name() == text);
                found.copied().ok_or_else(|| {
                    let known = Self::ALL.iter().map(|value| value.name()).collect::<Vec<_>>().join(", ");
                    $crate::Error::input(format!(concat!($what, " `{}`: one of {}"), text, known))
                })
            }
        }
    };
}
pub(crate) use named;
