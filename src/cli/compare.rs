//! `limpid compare`: the error of a picture against its reference.

use super::report;
use limpid::Result;
use limpid::image::{Image, exr};
use limpid::metrics::{self, Comparison, Defects, FORMULAS, Figures, ReferenceNoise};
use serde_json::json;
use std::path::PathBuf;

/// Compare a picture with its reference: MAE01, relMSE, PSNR, SSIM, FLIP
///
/// Both are EXR files of one size with the channels R, G, B; the surface figures also need Z and albedo.R/G/B. Where the
/// picture has noisy.R/G/B, these are compared as well.
#[derive(Debug, clap::Args)]
#[command(after_long_help = FORMULAS)]
pub struct Args {
    /// The picture
    #[arg(value_name = "A.exr")]
    image: PathBuf,
    /// Its reference
    #[arg(value_name = "REF.exr")]
    reference: PathBuf,
    /// A second reference, with noise of its own: relMSE is then free of the references' noise
    #[arg(long, value_name = "REF2.exr")]
    second: Option<PathBuf>,
    /// Add seam_energy: how much the error changes where chunks of N x N pixels meet, against elsewhere; 1 = no seams
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    seams: Option<u32>,
    /// Add the counts of fireflies, black pixels and pixels that are not finite
    #[arg(long)]
    defects: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What was found.
struct Found {
    figures: Option<Comparison>,
    noisy: Option<Comparison>,
    noise: Option<ReferenceNoise>,
    seam_energy: Option<f64>,
    defects: Option<Defects>,
}

impl Found {
    fn new(args: &Args, image: &Image) -> Result<Self> {
        let mut reference = exr::read(&args.reference)?;
        metrics::same_size("the image", image, &reference)?;
        let second = args.second.as_ref().map(exr::read).transpose()?;
        let halves = second.map(|second| [std::mem::take(&mut reference), second]);
        if let Some([first, second]) = &halves {
            reference = metrics::mean_reference([first, second])?;
        }
        let compare = |prefix| match &halves {
            Some([first, second]) => metrics::compare_halves(image, prefix, [first, second]),
            None => metrics::compare_channels(image, prefix, &reference, ""),
        };
        let (a, r, width) = (image.rgb("")?, reference.rgb("")?, image.width);
        let defects = args.defects.then(|| metrics::defects(a, r, width, image.height)).transpose()?;
        let finite = defects.is_none_or(|defects| defects.non_finite == 0);
        let seams = args.seams.filter(|_| finite);
        Ok(Self {
            figures: finite.then(|| compare("")).transpose()?,
            noisy: image.has_rgb("noisy").then(|| compare("noisy")).transpose()?,
            noise: halves.as_ref().map(|[a, b]| metrics::reference_noise([a, b])).transpose()?,
            seam_energy: seams.map(|chunk| metrics::seam_energy(a, r, width, chunk)).transpose()?,
            defects,
        })
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let image = exr::read(&args.image)?;
    let found = Found::new(args, &image)?;
    if !args.json {
        report::print(&table(&found))?;
        return Ok(0);
    }
    let mut value = json!({
        "command": "compare",
        "limpid": env!("CARGO_PKG_VERSION"),
        "image": report::text(&args.image),
        "reference": report::text(&args.reference),
        "width": image.width,
        "height": image.height,
        "all": found.figures.map(|figures| figures.all),
        "surface": found.figures.and_then(|figures| figures.surface),
    });
    if let Some(noisy) = found.noisy {
        value["noisy"] = json!(noisy);
    }
    if let (Some(second), Some(noise)) = (&args.second, found.noise) {
        value["second"] = json!(report::text(second));
        value["noise"] = json!(noise);
    }
    if let Some(chunk) = args.seams {
        value["chunk"] = json!(chunk);
        value["seam_energy"] = json!(found.seam_energy);
    }
    if let Some(defects) = found.defects {
        value["defects"] = json!(defects);
    }
    report::print_json(&value)?;
    Ok(0)
}

/// One column for each set of pixels, then a line for each other figure.
fn table(found: &Found) -> String {
    let mut columns = Vec::new();
    for (names, figures) in [(["all", "surface"], &found.figures), (["noisy", "noisy surface"], &found.noisy)] {
        columns.extend(figures.map(|figures| (names[0], figures.all)));
        columns.extend(figures.and_then(|figures| figures.surface).map(|figures| (names[1], figures)));
    }
    type Row = (&'static str, fn(&Figures) -> String);
    let rows: [Row; 6] = [
        ("pixels", |f| f.pixels.to_string()),
        ("mae01", |f| format!("{:.6}", f.mae01)),
        ("relmse", |f| format!("{:.6}", f.relmse)),
        ("psnr", |f| format!("{:.2} dB", f.psnr)),
        ("ssim", |f| format!("{:.5}", f.ssim)),
        ("flip", |f| format!("{:.5}", f.flip)),
    ];
    let mut text = format!("{:<8}", "");
    for (name, _) in &columns {
        text += &format!("{name:>15}");
    }
    for (name, value) in rows {
        text += &format!("\n{name:<8}");
        for (_, figures) in &columns {
            text += &format!("{:>15}", value(figures));
        }
    }
    if let Some(ReferenceNoise { mae01, relmse }) = found.noise {
        text += &format!("\nnoise of the references: mae01 {mae01:.6}, relmse {relmse:.6}");
    }
    if let Some(energy) = found.seam_energy {
        text += &format!("\nseam energy: {energy:.4}");
    }
    if let Some(Defects { fireflies, black, non_finite }) = found.defects {
        text += &format!("\nfireflies: {fireflies}, black pixels: {black}, not finite: {non_finite}");
    }
    text
}
