//! `limpid compare`: the error of a picture against its reference.

use super::report;
use limpid::Result;
use limpid::image::exr;
use limpid::metrics::{Comparison, FORMULAS, Figures, compare, compare_channels};
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
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<u8> {
    let (image, reference) = (exr::read(&args.image)?, exr::read(&args.reference)?);
    let figures = compare(&image, &reference)?;
    let noisy = if image.has_rgb("noisy") { Some(compare_channels(&image, "noisy", &reference, "")?) } else { None };
    if args.json {
        let mut value = json!({
            "command": "compare",
            "limpid": env!("CARGO_PKG_VERSION"),
            "image": report::text(&args.image),
            "reference": report::text(&args.reference),
            "width": image.width,
            "height": image.height,
            "all": figures.all,
            "surface": figures.surface,
        });
        if let Some(noisy) = noisy {
            value["noisy"] = json!(noisy);
        }
        report::print_json(&value)?;
    } else {
        report::print(&table(&figures, noisy.as_ref()))?;
    }
    Ok(0)
}

/// One column for each set of pixels.
fn table(figures: &Comparison, noisy: Option<&Comparison>) -> String {
    let mut columns = vec![("all", figures.all)];
    columns.extend(figures.surface.map(|f| ("surface", f)));
    if let Some(noisy) = noisy {
        columns.push(("noisy", noisy.all));
        columns.extend(noisy.surface.map(|f| ("noisy surface", f)));
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
    text
}
