//! Turns the texel buffers that a SPIR-V module reads into storage buffers, for devices whose texel views are too small for
//! tensors (Vulkan promises 65,536 texels). Used by `build.rs` alone.

use rspirv::binary::Assemble;
use rspirv::dr::{Instruction, Module, Operand, load_words};
use rspirv::spirv::{Decoration, Dim, ImageFormat, Op, StorageClass};
use std::collections::HashMap;

/// A texel buffer as a storage buffer: `struct { T texels[]; }`, `T` a `vec4` or a `float`.
#[derive(Clone, Copy)]
struct Texels {
    variable: u32,
    element: u32,
    element_pointer: u32,
    single: bool,
}

struct Rewrite {
    module: Module,
    next_id: u32,
    float: u32,
    vec4: u32,
    zero: u32,
    float_zero: u32,
    float_one: u32,
}

fn id(operand: &Operand) -> u32 {
    operand.id_ref_any().expect("operand is no id")
}

fn instruction(op: Op, ty: Option<u32>, result: Option<u32>, operands: Vec<Operand>) -> Instruction {
    Instruction::new(op, ty, result, operands)
}

/// The module, and with storage buffers in the place of its texel buffers; the same where it has none.
///
/// # Panics
/// Where a texel buffer is used in another way than `imageLoad` of `rgba32f` or `r32f`.
pub fn without_texels(words: &[u32]) -> Vec<u32> {
    let (kept, modes) = crate::reflect::loadable(words);
    let module = load_words(kept).expect("shaderc wrote SPIR-V that does not parse");
    let images = image_variables(&module);
    if images.is_empty() {
        return words.to_vec();
    }
    let mut rewrite = Rewrite::new(module);
    let texels = rewrite.declare(&images);
    rewrite.bodies(&texels);
    with_modes(rewrite.module.assemble(), &modes)
}

/// The module with execution modes where they belong, after the entry point.
fn with_modes(mut words: Vec<u32>, modes: &[u32]) -> Vec<u32> {
    const HEADER: usize = 5;
    let mut at = HEADER;
    loop {
        let (count, opcode) = ((words[at] >> 16) as usize, words[at] & 0xffff);
        at += count;
        if opcode == Op::EntryPoint as u32 {
            words.splice(at..at, modes.iter().copied());
            return words;
        }
    }
}

/// Every texel buffer: its variable and whether its texels are single floats.
fn image_variables(module: &Module) -> Vec<(u32, bool)> {
    let mut types = HashMap::new();
    let mut variables = Vec::new();
    for i in &module.types_global_values {
        match (i.class.opcode, i.operands.as_slice()) {
            (Op::TypeImage, [_, Operand::Dim(Dim::DimBuffer), .., Operand::ImageFormat(format)]) => {
                let single = match format {
                    ImageFormat::Rgba32f => false,
                    ImageFormat::R32f => true,
                    other => panic!("texel buffers of {other:?} are not known"),
                };
                types.insert(i.result_id, single);
            }
            (Op::TypePointer, [Operand::StorageClass(StorageClass::UniformConstant), target]) => {
                if let Some(&single) = types.get(&Some(id(target))) {
                    types.insert(i.result_id, single);
                }
            }
            (Op::Variable, _) => {
                if let (Some(&single), Some(variable)) = (types.get(&i.result_type), i.result_id) {
                    variables.push((variable, single));
                }
            }
            _ => {}
        }
    }
    variables
}

impl Rewrite {
    fn new(module: Module) -> Self {
        let next_id = module.header.as_ref().expect("a header").bound;
        let mut this = Self { module, next_id, float: 0, vec4: 0, zero: 0, float_zero: 0, float_one: 0 };
        let word = Operand::LiteralBit32;
        this.float = this.find_or_add(Op::TypeFloat, None, vec![word(32)]);
        this.vec4 = this.find_or_add(Op::TypeVector, None, vec![Operand::IdRef(this.float), word(4)]);
        let int = this.find_or_add(Op::TypeInt, None, vec![word(32), word(1)]);
        this.zero = this.find_or_add(Op::Constant, Some(int), vec![word(0)]);
        this.float_zero = this.find_or_add(Op::Constant, Some(this.float), vec![word(0f32.to_bits())]);
        this.float_one = this.find_or_add(Op::Constant, Some(this.float), vec![word(1f32.to_bits())]);
        this
    }

    fn new_id(&mut self) -> u32 {
        self.next_id += 1;
        self.module.header.as_mut().expect("a header").bound = self.next_id;
        self.next_id - 1
    }

    fn add(&mut self, op: Op, ty: Option<u32>, operands: Vec<Operand>) -> u32 {
        let result = self.new_id();
        self.module.types_global_values.push(instruction(op, ty, Some(result), operands));
        result
    }

    /// Scalar and vector types must be declared once.
    fn find_or_add(&mut self, op: Op, ty: Option<u32>, operands: Vec<Operand>) -> u32 {
        let same = |i: &&Instruction| i.class.opcode == op && i.result_type == ty && i.operands == operands;
        match self.module.types_global_values.iter().find(same).and_then(|i| i.result_id) {
            Some(found) => found,
            None => self.add(op, ty, operands),
        }
    }

    fn decorate(&mut self, op: Op, operands: Vec<Operand>) {
        self.module.annotations.push(instruction(op, None, None, operands));
    }

    /// Declares the storage buffers at the end of the globals, under the variables' ids.
    fn declare(&mut self, images: &[(u32, bool)]) -> HashMap<u32, Texels> {
        let is_image =
            |i: &Instruction| i.class.opcode == Op::Variable && images.iter().any(|(v, _)| Some(*v) == i.result_id);
        self.module.types_global_values.retain(|i| !is_image(i));
        let mut all = HashMap::new();
        for &(variable, single) in images {
            let (element, bytes) = if single { (self.float, 4) } else { (self.vec4, 16) };
            let storage = Operand::StorageClass(StorageClass::StorageBuffer);
            let (reference, word) = (Operand::IdRef, Operand::LiteralBit32);
            let array = self.add(Op::TypeRuntimeArray, None, vec![reference(element)]);
            let block = self.add(Op::TypeStruct, None, vec![reference(array)]);
            let pointer = self.add(Op::TypePointer, None, vec![storage.clone(), reference(block)]);
            let element_pointer = self.add(Op::TypePointer, None, vec![storage.clone(), reference(element)]);
            let declaration = instruction(Op::Variable, Some(pointer), Some(variable), vec![storage]);
            self.module.types_global_values.push(declaration);
            let name = Operand::Decoration;
            self.decorate(Op::Decorate, vec![reference(array), name(Decoration::ArrayStride), word(bytes)]);
            self.decorate(Op::Decorate, vec![reference(block), name(Decoration::Block)]);
            let offset = vec![reference(block), word(0), name(Decoration::Offset), word(0)];
            self.decorate(Op::MemberDecorate, offset);
            all.insert(variable, Texels { variable, element, element_pointer, single });
        }
        all
    }

    /// Replaces every load of an image and the reads of what was loaded.
    fn bodies(&mut self, texels: &HashMap<u32, Texels>) {
        let mut functions = std::mem::take(&mut self.module.functions);
        for function in &mut functions {
            let mut loaded = HashMap::new();
            for block in &mut function.blocks {
                for i in std::mem::take(&mut block.instructions) {
                    let source = i.operands.first().and_then(Operand::id_ref_any);
                    match (i.class.opcode, source) {
                        (Op::Load, Some(from)) if texels.contains_key(&from) => {
                            loaded.insert(i.result_id.expect("a load has a result"), texels[&from]);
                        }
                        (Op::ImageRead, Some(from)) => {
                            let texels = loaded.get(&from).expect("only texel buffers are read");
                            block.instructions.extend(self.read(*texels, &i));
                        }
                        _ => {
                            let strays = i.operands.iter().filter_map(Operand::id_ref_any);
                            let stray = strays.into_iter().find(|id| loaded.contains_key(id));
                            assert!(stray.is_none(), "a texel buffer in {i:?}");
                            block.instructions.push(i);
                        }
                    }
                }
            }
        }
        self.module.functions = functions;
    }

    /// `imageLoad(x, at)` as `x.texels[at]`; a single float is `vec4(r, 0, 0, 1)`.
    fn read(&mut self, x: Texels, image_read: &Instruction) -> Vec<Instruction> {
        assert_eq!(image_read.operands.len(), 2, "image operands are not known: {image_read:?}");
        let reference = Operand::IdRef;
        let at = vec![reference(x.variable), reference(self.zero), image_read.operands[1].clone()];
        let pointer = self.new_id();
        let mut out = vec![instruction(Op::AccessChain, Some(x.element_pointer), Some(pointer), at)];
        let result = image_read.result_id;
        if x.single {
            let float = self.new_id();
            out.push(instruction(Op::Load, Some(x.element), Some(float), vec![reference(pointer)]));
            let parts = [float, self.float_zero, self.float_zero, self.float_one].map(reference).to_vec();
            out.push(instruction(Op::CompositeConstruct, Some(self.vec4), result, parts));
        } else {
            out.push(instruction(Op::Load, Some(x.element), result, vec![reference(pointer)]));
        }
        out
    }
}
