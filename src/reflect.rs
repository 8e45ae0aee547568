//! Reads a SPIR-V module and lists what the host must agree with. Used by `build.rs` alone.

use rspirv::dr::{Instruction, Module, Operand, load_words};
use rspirv::spirv::{Decoration, ImageFormat, Op, StorageClass};
use std::collections::HashMap;

/// One descriptor.
pub struct Binding {
    pub name: String,
    pub binding: u32,
    /// A `BindingKind` as Rust source.
    pub kind: String,
    /// An `Access` as Rust source.
    pub access: &'static str,
}

/// A scalar with its type as Rust source and its offset (push constants) or id (specialization constants).
pub struct Scalar {
    pub name: String,
    pub ty: &'static str,
    pub at: u32,
    /// The default value as Rust source; empty for push constants.
    pub default: String,
}

/// What one compute shader asks of its host.
pub struct Reflection {
    pub bindings: Vec<Binding>,
    pub push: Vec<Scalar>,
    pub spec: Vec<Scalar>,
}

struct Tables {
    module: Module,
    names: HashMap<u32, String>,
    member_names: HashMap<(u32, u32), String>,
    decorations: HashMap<(u32, Decoration), Option<u32>>,
    member_decorations: HashMap<(u32, u32, Decoration), Option<u32>>,
}

fn id(operand: &Operand) -> u32 {
    operand.id_ref_any().expect("operand is no id")
}

fn literal(operand: &Operand) -> u32 {
    match operand {
        Operand::LiteralBit32(value) => *value,
        other => panic!("operand {other:?} is no 32-bit literal"),
    }
}

/// The module without `OpExecutionModeId` (a workgroup size from specialization constants), which rspirv does not load; and
/// those instructions.
pub fn loadable(words: &[u32]) -> (Vec<u32>, Vec<u32>) {
    const HEADER: usize = 5;
    let (mut kept, mut modes) = (words[..HEADER].to_vec(), Vec::new());
    let mut at = HEADER;
    while at < words.len() {
        let (count, opcode) = ((words[at] >> 16) as usize, words[at] & 0xffff);
        let to = if opcode == Op::ExecutionModeId as u32 { &mut modes } else { &mut kept };
        to.extend_from_slice(&words[at..at + count]);
        at += count;
    }
    (kept, modes)
}

impl Tables {
    fn new(words: &[u32]) -> Self {
        let module = load_words(loadable(words).0).expect("shaderc wrote SPIR-V that does not parse");
        let mut tables = Self {
            names: HashMap::new(),
            member_names: HashMap::new(),
            decorations: HashMap::new(),
            member_decorations: HashMap::new(),
            module,
        };
        for i in &tables.module.debug_names {
            match (i.class.opcode, i.operands.as_slice()) {
                (Op::Name, [target, Operand::LiteralString(name)]) => {
                    tables.names.insert(id(target), name.clone());
                }
                (Op::MemberName, [target, member, Operand::LiteralString(name)]) => {
                    tables.member_names.insert((id(target), literal(member)), name.clone());
                }
                _ => {}
            }
        }
        for i in &tables.module.annotations {
            let value = |operand: Option<&Operand>| match operand {
                Some(Operand::LiteralBit32(value)) => Some(*value),
                _ => None,
            };
            match (i.class.opcode, i.operands.as_slice()) {
                (Op::Decorate, [target, Operand::Decoration(decoration), rest @ ..]) => {
                    tables.decorations.insert((id(target), *decoration), value(rest.first()));
                }
                (Op::MemberDecorate, [target, member, Operand::Decoration(decoration), rest @ ..]) => {
                    let key = (id(target), literal(member), *decoration);
                    tables.member_decorations.insert(key, value(rest.first()));
                }
                _ => {}
            }
        }
        tables
    }

    fn definition(&self, wanted: u32) -> &Instruction {
        let all = &self.module.types_global_values;
        all.iter().find(|i| i.result_id == Some(wanted)).expect("id is not defined")
    }

    fn scalar_type(&self, ty: u32, context: &str) -> &'static str {
        let i = self.definition(ty);
        match (i.class.opcode, i.operands.as_slice()) {
            (Op::TypeBool, _) => "bool",
            (Op::TypeFloat, [width, ..]) if literal(width) == 32 => "f32",
            (Op::TypeInt, [width, signed]) if literal(width) == 32 && literal(signed) == 0 => "u32",
            (Op::TypeInt, [width, _]) if literal(width) == 32 => "i32",
            _ => panic!("{context}: only 32-bit scalars may cross the shader/host border"),
        }
    }

    fn access(&self, variable: u32, block: Option<(u32, u32)>) -> &'static str {
        let has = |decoration| {
            self.decorations.contains_key(&(variable, decoration))
                || block.is_some_and(|(ty, members)| {
                    (0..members).all(|m| self.member_decorations.contains_key(&(ty, m, decoration)))
                })
        };
        match (has(Decoration::NonWritable), has(Decoration::NonReadable)) {
            (true, _) => "Read",
            (false, true) => "Write",
            (false, false) => "ReadWrite",
        }
    }

    fn binding(&self, variable: u32, pointee: u32, class: StorageClass) -> Binding {
        let ty = self.definition(pointee);
        let binding = self.decorations.get(&(variable, Decoration::Binding)).copied().flatten().expect("no binding");
        let set = self.decorations.get(&(variable, Decoration::DescriptorSet)).copied().flatten();
        assert!(set.is_none_or(|set| set == 0), "only descriptor set 0 is used");
        match (class, ty.class.opcode) {
            (StorageClass::StorageBuffer, Op::TypeStruct) => Binding {
                name: snake_case(self.names.get(&pointee).expect("storage block without a name")),
                binding,
                kind: "StorageBuffer".into(),
                access: self.access(variable, Some((pointee, ty.operands.len() as u32))),
            },
            (StorageClass::UniformConstant, Op::TypeImage) => {
                let format = ty.operands.iter().find_map(|o| match o {
                    Operand::ImageFormat(format) => Some(*format),
                    _ => None,
                });
                let format = match format {
                    Some(ImageFormat::Rgba32f) => "Rgba32f",
                    Some(ImageFormat::R32f) => "R32f",
                    other => panic!("texel format {other:?} has no row in TexelFormat"),
                };
                Binding {
                    name: self.names.get(&variable).expect("texel buffer without a name").clone(),
                    binding,
                    kind: format!("TexelBuffer(TexelFormat::{format})"),
                    access: self.access(variable, None),
                }
            }
            (class, op) => panic!("descriptor of {class:?} {op:?} is not supported"),
        }
    }

    fn push_members(&self, block: u32) -> Vec<Scalar> {
        let members = &self.definition(block).operands;
        (0u32..)
            .zip(members)
            .map(|(m, ty)| {
                let name = self.member_names[&(block, m)].clone();
                let at =
                    self.member_decorations[&(block, m, Decoration::Offset)].expect("push constant without offset");
                Scalar { ty: self.scalar_type(id(ty), &name), name, at, default: String::new() }
            })
            .collect()
    }

    fn spec_constant(&self, i: &Instruction) -> Option<Scalar> {
        let result = i.result_id?;
        let at = self.decorations.get(&(result, Decoration::SpecId)).copied().flatten()?;
        let name = self.names.get(&result)?.to_lowercase();
        let ty = self.scalar_type(i.result_type?, &name);
        let default = match (i.class.opcode, ty) {
            (Op::SpecConstantTrue, _) => "true".into(),
            (Op::SpecConstantFalse, _) => "false".into(),
            (_, "f32") => format!("f32::from_bits({})", literal(&i.operands[0])),
            (_, "i32") => format!("{}", literal(&i.operands[0]) as i32),
            _ => format!("{}", literal(&i.operands[0])),
        };
        Some(Scalar { name, ty, at, default })
    }
}

/// `SceneSpheres` -> `scene_spheres`.
fn snake_case(name: &str) -> String {
    let mut out = String::new();
    for c in name.chars() {
        if c.is_uppercase() && !out.is_empty() && !out.ends_with('_') {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

/// Lists the bindings, push constants and specialization constants of a module, each in ascending order.
pub fn reflect(words: &[u32]) -> Reflection {
    let t = Tables::new(words);
    let mut out = Reflection { bindings: Vec::new(), push: Vec::new(), spec: Vec::new() };
    for i in &t.module.types_global_values {
        if i.class.opcode == Op::Variable {
            let Operand::StorageClass(class) = i.operands[0] else { panic!("variable without storage class") };
            let pointer = t.definition(i.result_type.expect("variable without type"));
            let pointee = id(&pointer.operands[1]);
            match class {
                StorageClass::PushConstant => out.push = t.push_members(pointee),
                StorageClass::StorageBuffer | StorageClass::UniformConstant => {
                    out.bindings.push(t.binding(i.result_id.expect("variable without id"), pointee, class));
                }
                _ => {}
            }
        }
        out.spec.extend(t.spec_constant(i));
    }
    out.bindings.sort_by_key(|b| b.binding);
    out.spec.sort_by_key(|s| s.at);
    out
}
