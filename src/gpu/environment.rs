//! Environment switches of the CPU driver, set once before the first Vulkan call and only where the user left them unset.

use std::path::PathBuf;
use std::sync::OnceLock;

/// `LP_NATIVE_VECTOR_WIDTH`: 512-bit vectors, the convolution's subgroup of 16, where the processor has AVX-512.
fn vector_width() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512vl")
        && std::arch::is_x86_feature_detected!("avx512bw")
        && std::arch::is_x86_feature_detected!("avx512dq")
    {
        return "512";
    }
    "256"
}

/// limpid's folder in the user's cache directory; none where the system names no such directory.
pub(super) fn cache_folder() -> Option<PathBuf> {
    let env = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let home = env("XDG_CACHE_HOME").or_else(|| env("HOME").map(|home| home.join(".cache")));
    home.map(|home| home.join("limpid"))
}

fn set_if_unset(name: &str, value: &std::ffi::OsStr) {
    if std::env::var_os(name).is_none() {
        // SAFETY: called once, from `prepare`, before limpid starts a thread or loads the Vulkan loader.
        unsafe { std::env::set_var(name, value) };
    }
}

/// Sets the switches; later calls do nothing.
pub(super) fn prepare() {
    static DONE: OnceLock<()> = OnceLock::new();
    DONE.get_or_init(|| {
        set_if_unset("LP_NATIVE_VECTOR_WIDTH", vector_width().as_ref());
        // Mesa's disk cache does not key its code by vector width: each width gets a directory of its own.
        if let Some(cache) = cache_folder() {
            let width = std::env::var("LP_NATIVE_VECTOR_WIDTH").unwrap_or_default();
            let dir = cache.join(format!("mesa-{width}"));
            if std::fs::create_dir_all(&dir).is_ok() {
                set_if_unset("MESA_SHADER_CACHE_DIR", dir.as_os_str());
            }
        }
    });
}

/// The driver switches in force, by name.
#[must_use]
pub fn settings() -> Vec<(&'static str, String)> {
    ["LP_NATIVE_VECTOR_WIDTH", "LP_NUM_THREADS", "MESA_SHADER_CACHE_DIR"]
        .into_iter()
        .filter_map(|name| Some((name, std::env::var(name).ok()?)))
        .collect()
}
