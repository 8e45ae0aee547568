//! Host tensors (NCHW) and the counter-based random numbers that fill them.

/// A dense tensor in NCHW order; convolution weights use the same type as OIHW.
///
/// References compute in `Tensor<f64>`, files and devices hold `Tensor<f32>`.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor<T = f32> {
    /// Batch, channels, height, width (or out, in, height, width for weights).
    pub shape: [usize; 4],
    /// The elements, width fastest.
    pub data: Vec<T>,
}

impl<T: Copy + Default> Tensor<T> {
    /// A tensor of zeros.
    pub fn zeros(shape: [usize; 4]) -> Self {
        Self { shape, data: vec![T::default(); shape.iter().product()] }
    }

    /// A tensor over `data`; panics where the length does not fit the shape.
    pub fn new(shape: [usize; 4], data: Vec<T>) -> Self {
        assert_eq!(data.len(), shape.iter().product::<usize>(), "data length against shape {shape:?}");
        Self { shape, data }
    }

    /// The index of an element in `data`.
    pub fn index(&self, n: usize, c: usize, y: usize, x: usize) -> usize {
        let [_, channels, height, width] = self.shape;
        ((n * channels + c) * height + y) * width + x
    }

    /// One element.
    pub fn at(&self, n: usize, c: usize, y: usize, x: usize) -> T {
        self.data[self.index(n, c, y, x)]
    }

    /// The height x width plane of channel `c` of image `n`.
    pub fn plane(&self, n: usize, c: usize) -> &[T] {
        let area = self.shape[2] * self.shape[3];
        let start = (n * self.shape[1] + c) * area;
        &self.data[start..start + area]
    }

    /// The number of elements.
    pub fn len(&self) -> usize {
        self.data.len()
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// A tensor of the same shape, element by element.
    pub fn map<U>(&self, f: impl Fn(T) -> U) -> Tensor<U> {
        Tensor { shape: self.shape, data: self.data.iter().map(|&v| f(v)).collect() }
    }
}

impl Tensor<f32> {
    /// The same values in double precision, exactly.
    pub fn to_f64(&self) -> Tensor<f64> {
        self.map(f64::from)
    }

    /// Uniform values in [-1, 1): element `i` is `2 * uniform(seed, i) - 1`, exact in f32.
    pub fn uniform(shape: [usize; 4], seed: u64) -> Self {
        let count = shape.iter().product::<usize>();
        Self { shape, data: (0..count as u64).map(|i| (2.0 * uniform(seed, i) - 1.0) as f32).collect() }
    }
}

impl Tensor<f64> {
    /// The values rounded to single precision.
    pub fn to_f32(&self) -> Tensor<f32> {
        self.map(|v| v as f32)
    }
}

/// The finalizer of splitmix64.
fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A 64-bit hash of (seed, counter): `mix(mix(seed) + 0x9e3779b97f4a7c15 * (counter + 1))` with splitmix64's `mix`.
///
/// Stateless, so any element can be drawn in any order and in any language.
pub fn hash(seed: u64, counter: u64) -> u64 {
    mix(mix(seed).wrapping_add(counter.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

/// A uniform number in [0, 1) with 24 bits: the top bits of [`hash`]; exact in f32.
pub fn uniform(seed: u64, counter: u64) -> f64 {
    (hash(seed, counter) >> 40) as f64 / (1u64 << 24) as f64
}

/// A seed from a name (64-bit FNV-1a), so that every tensor of a test or a network has its own stream.
pub fn seed_of(name: &str) -> u64 {
    name.bytes().fold(0xcbf2_9ce4_8422_2325, |h, byte| (h ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}
