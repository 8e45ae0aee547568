//! Named media: metals and transparent ones.

use glam::DVec3;

/// Complex indices of refraction of metals as linear RGB: measured spectra (SOPRA, Palik) integrated as Mitsuba 3 does.
const METALS: [(&str, [f64; 3], [f64; 3]); 21] = [
    ("a-C", [2.944, 2.2271, 1.9682], [0.88746, 0.7993, 0.81529]),
    ("Ag", [0.15528, 0.11673, 0.13839], [4.8284, 3.1222, 2.1469]),
    ("Al", [1.6575, 0.8804, 0.52124], [9.2238, 6.2695, 4.837]),
    ("Au", [0.14304, 0.37531, 1.442], [3.983, 2.3856, 1.6034]),
    ("Be", [4.185, 3.185, 2.7841], [3.8355, 3.0101, 2.869]),
    ("Cr", [4.3697, 2.9165, 1.6549], [5.2065, 4.2313, 3.7547]),
    ("Cu", [0.20101, 0.92375, 1.1022], [3.9133, 2.453, 2.1421]),
    ("Hg", [2.3989, 1.44, 0.90957], [6.3276, 4.3719, 3.4218]),
    ("Ir", [3.0863, 2.0822, 1.6179], [5.5922, 4.0671, 3.2673]),
    ("K", [0.064043, 0.04641, 0.038185], [2.1042, 1.3489, 0.91313]),
    ("Li", [0.26579, 0.19562, 0.22095], [3.5402, 2.3111, 1.6686]),
    ("Mo", [4.484, 3.5251, 2.7763], [4.1114, 3.4208, 3.1506]),
    ("Nb", [3.4201, 2.7901, 2.3956], [3.4414, 2.7377, 2.5797]),
    ("Rh", [2.5858, 1.8602, 1.5543], [6.7823, 4.703, 3.9761]),
    ("Ta", [2.0627, 2.3929, 2.6279], [2.4084, 1.7415, 1.947]),
    ("Te", [7.3902, 4.4821, 2.6371], [3.256, 3.5271, 3.2921]),
    ("TiC", [3.7005, 2.8374, 2.5823], [3.2656, 2.3516, 2.1728]),
    ("TiN", [1.6484, 1.1505, 1.3798], [3.3683, 1.9435, 1.1021]),
    ("VC", [3.6576, 2.7527, 2.5327], [3.0683, 2.1987, 1.9632]),
    ("VN", [2.8656, 2.1192, 1.9401], [3.0322, 2.0561, 1.6163]),
    ("W", [4.3708, 3.3002, 2.9984], [3.5006, 2.6049, 2.2732]),
];

/// Indices of refraction by name, as in Mitsuba.
const MEDIA: [(&str, f64); 23] = [
    ("vacuum", 1.0),
    ("helium", 1.000036),
    ("hydrogen", 1.000132),
    ("air", 1.000277),
    ("carbon dioxide", 1.00045),
    ("water", 1.3330),
    ("acetone", 1.36),
    ("ethanol", 1.361),
    ("carbon tetrachloride", 1.461),
    ("glycerol", 1.4729),
    ("benzene", 1.501),
    ("silicone oil", 1.52045),
    ("bromine", 1.661),
    ("water ice", 1.31),
    ("fused quartz", 1.458),
    ("pyrex", 1.470),
    ("acrylic glass", 1.49),
    ("polypropylene", 1.49),
    ("bk7", 1.5046),
    ("sodium chloride", 1.544),
    ("amber", 1.55),
    ("pet", 1.5750),
    ("diamond", 2.419),
];

/// `eta` and `k` of a metal.
pub fn metal(name: &str) -> Option<(DVec3, DVec3)> {
    METALS.iter().find(|metal| metal.0 == name).map(|metal| (metal.1.into(), metal.2.into()))
}

/// The names that [`metal`] knows.
pub fn metal_names() -> String {
    METALS.map(|metal| metal.0).join(", ")
}

/// The index of refraction of a transparent medium; capitals make no difference.
pub fn medium(name: &str) -> Option<f64> {
    MEDIA.iter().find(|medium| medium.0.eq_ignore_ascii_case(name)).map(|medium| medium.1)
}

/// The names that [`medium`] knows.
pub fn medium_names() -> String {
    MEDIA.map(|medium| medium.0).join(", ")
}
