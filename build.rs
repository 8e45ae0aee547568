//! Compiles every `glsl/**/*.comp` to SPIR-V 1.6 and writes `$OUT_DIR/shaders.rs`: one module a shader with its code, its
//! `Bind` and `Spec` structs and the tables that `push_block!` checks the host's push constants against.

#[path = "src/reflect.rs"]
mod reflect;
#[path = "src/shared_constants.rs"]
mod shared_constants;
#[path = "src/without_texels.rs"]
mod without_texels;

use std::fmt::Write as _;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::{env, fs};

fn shader_files(dir: &Path, out: &mut Vec<PathBuf>) {
    println!("cargo::rerun-if-changed={}", dir.display());
    let mut entries: Vec<_> = fs::read_dir(dir).expect("glsl/ is readable").map(|e| e.expect("entry").path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            shader_files(&path, out);
        } else {
            println!("cargo::rerun-if-changed={}", path.display());
            if path.extension().is_some_and(|e| e == "comp") {
                out.push(path);
            }
        }
    }
}

/// Shaders that are loaded optimised: their unrolled loops keep llvmpipe busy for most of a second at every start otherwise
/// (`winograd`, one pipeline: 806 ms, optimised 228 ms; the same speed).
const OPTIMISED: &[&str] = &["winograd", "conv2d_cpu", "conv2d_narrow", "conv2d_weight_grad_cpu"];

fn compile_options() -> shaderc::CompileOptions<'static> {
    let mut options = shaderc::CompileOptions::new().expect("shaderc options");
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_3 as u32);
    options.set_target_spirv(shaderc::SpirvVersion::V1_6);
    options.set_source_language(shaderc::SourceLanguage::GLSL);
    // Unoptimised: the optimiser drops the names and the unused bindings that reflection reads.
    options.set_optimization_level(shaderc::OptimizationLevel::Zero);
    options.set_generate_debug_info();
    options.set_warnings_as_errors();
    for (name, value) in shared_constants::SHARED {
        options.add_macro_definition(name, Some(&format!("{value}u")));
    }
    options.set_include_callback(|requested, _kind, from, _depth| {
        let path = Path::new("glsl").join(requested);
        let content = fs::read_to_string(&path).map_err(|e| format!("{from}: {}: {e}", path.display()))?;
        Ok(shaderc::ResolvedInclude { resolved_name: path.display().to_string(), content })
    });
    options
}

/// The Rust module of one shader.
fn module_source(stem: &str, file: &Path, [spv, plain]: [&Path; 2], r: &reflect::Reflection) -> String {
    let mut s = String::new();
    let w = &mut s;
    writeln!(w, "/// `{}`.\npub mod {stem} {{\nuse crate::gpu::*;", file.display()).unwrap();
    writeln!(w, "/// The compiled shader.\n#[derive(Clone, Copy, Debug)]\npub struct Shader;").unwrap();
    writeln!(w, "/// One named buffer range a binding.\n#[derive(Clone, Debug)]\npub struct Bind {{").unwrap();
    for b in &r.bindings {
        writeln!(w, "/// Binding {}: {}, {}.\npub {}: Slice,", b.binding, b.kind, b.access, b.name).unwrap();
    }
    writeln!(w, "}}\nimpl Bindings for Bind {{ fn slices(&self) -> Vec<&Slice> {{ vec![").unwrap();
    for b in &r.bindings {
        writeln!(w, "&self.{},", b.name).unwrap();
    }
    writeln!(w, "] }} }}\n/// Specialization constants; the default is the shader's.").unwrap();
    writeln!(w, "#[derive(Clone, Copy, Debug, PartialEq)]\npub struct Spec {{").unwrap();
    for c in &r.spec {
        writeln!(w, "/// Constant {}.\npub {}: {},", c.at, c.name, c.ty).unwrap();
    }
    writeln!(w, "}}\nimpl Default for Spec {{ fn default() -> Self {{ Self {{").unwrap();
    for c in &r.spec {
        writeln!(w, "{}: {},", c.name, c.default).unwrap();
    }
    writeln!(w, "}} }} }}\nimpl Specialization for Spec {{ fn words(&self) -> Vec<u32> {{ vec![").unwrap();
    for c in &r.spec {
        let word = match c.ty {
            "f32" => format!("self.{}.to_bits()", c.name),
            "u32" => format!("self.{}", c.name),
            _ => format!("self.{} as u32", c.name),
        };
        writeln!(w, "{word},").unwrap();
    }
    writeln!(w, "] }} }}\nimpl crate::gpu::Shader for Shader {{\ntype Bind = Bind;\ntype Spec = Spec;").unwrap();
    writeln!(w, "const NAME: &'static str = {stem:?};").unwrap();
    writeln!(w, "const SPIRV: &'static [u8] = include_bytes!({:?});", spv.display().to_string()).unwrap();
    writeln!(w, "const SPIRV_WITHOUT_TEXELS: &'static [u8] = include_bytes!({:?});", plain.display().to_string())
        .unwrap();
    writeln!(w, "const BINDINGS: &'static [Binding] = &[").unwrap();
    for b in &r.bindings {
        writeln!(
            w,
            "Binding {{ name: {:?}, binding: {}, kind: BindingKind::{}, access: Access::{} }},",
            b.name, b.binding, b.kind, b.access
        )
        .unwrap();
    }
    writeln!(w, "];\nconst PUSH: &'static [PushMember] = &[").unwrap();
    for p in &r.push {
        writeln!(w, "PushMember {{ name: {:?}, ty: {:?}, offset: {} }},", p.name, p.ty, p.at).unwrap();
    }
    writeln!(w, "];\nconst SPEC_IDS: &'static [u32] = &[").unwrap();
    for c in &r.spec {
        writeln!(w, "{},", c.at).unwrap();
    }
    writeln!(w, "];\n}}\n}}").unwrap();
    s
}

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/reflect.rs");
    println!("cargo::rerun-if-changed=src/shared_constants.rs");
    println!("cargo::rerun-if-changed=src/without_texels.rs");
    let out_dir = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let compiler = shaderc::Compiler::new().expect("shaderc");
    let options = compile_options();
    let mut optimised = compile_options();
    optimised.set_optimization_level(shaderc::OptimizationLevel::Performance);
    let mut files = Vec::new();
    shader_files(Path::new("glsl"), &mut files);
    let mut rust = String::new();
    let mut hasher = DefaultHasher::new();
    let mut stems = std::collections::BTreeSet::new();
    for file in &files {
        let source = fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let stem = file.file_stem().expect("file name").to_string_lossy().into_owned();
        assert!(stems.insert(stem.clone()), "{}: a second shader of this name", file.display());
        let name = file.display().to_string();
        let compile = |options: &shaderc::CompileOptions| {
            compiler
                .compile_into_spirv(&source, shaderc::ShaderKind::Compute, &name, "main", Some(options))
                .unwrap_or_else(|e| panic!("{e}"))
        };
        let binary = compile(&options);
        let reflection = reflect::reflect(binary.as_binary());
        let loaded = if OPTIMISED.contains(&&*stem) { &compile(&optimised) } else { &binary };
        let spv = out_dir.join(format!("{stem}.spv"));
        (&stem, loaded.as_binary_u8()).hash(&mut hasher);
        fs::write(&spv, loaded.as_binary_u8()).expect("OUT_DIR is writable");
        let plain = out_dir.join(format!("{stem}.buffers.spv"));
        let words = without_texels::without_texels(binary.as_binary());
        words.hash(&mut hasher);
        let bytes: Vec<u8> = words.into_iter().flat_map(u32::to_le_bytes).collect();
        fs::write(&plain, bytes).expect("OUT_DIR is writable");
        rust.push_str(&module_source(&stem, file, [&spv, &plain], &reflection));
    }
    writeln!(rust, "/// Of all shaders together.\npub const HASH: u64 = {:#x};", hasher.finish()).unwrap();
    fs::write(out_dir.join("shaders.rs"), rust).expect("OUT_DIR is writable");
}
