//! Error over time as an SVG picture.

use super::summary::Summary;
use crate::chart::{Drawn, Line, chart, padded, short, ticks};
use crate::render::{Estimator, Sampler};
use crate::{Error, Result};
use plotters::prelude::*;

const SIZE: (u32, u32) = (960, 720);

/// relMSE over device time, both axes logarithmic: a colour an estimator, pale for `pcg`, dashed where reconstructed.
pub fn svg(summary: &Summary, title: &str) -> Result<String> {
    let mut text = String::new();
    draw(summary, title, &mut text).map_err(|e| Error::input(format!("plot: {e}")))?;
    Ok(text)
}

fn draw(summary: &Summary, title: &str, text: &mut String) -> Drawn {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let lines: Vec<Line> = summary
        .lines
        .iter()
        .map(|line| {
            let color = match line.technique.estimator {
                Estimator::Uniform => RGBColor(110, 110, 110),
                Estimator::Cosine => RGBColor(31, 119, 180),
                Estimator::Nee => RGBColor(214, 39, 40),
            };
            let strength = match line.technique.sampler {
                Sampler::Pcg => 0.45,
                Sampler::Sobol => 1.0,
            };
            let told = |p: &super::Point| p.relmse.map(|error| (p.device_ms * 1e-3, error));
            let (technique, end) = (line.technique, if line.reconstructed { ", reconstructed" } else { "" });
            Line {
                label: format!("{technique}{end}"),
                color: color.mix(strength),
                dashed: line.reconstructed,
                points: line.points.iter().filter_map(told).collect(),
            }
        })
        .collect();
    let seconds = padded(lines.iter().flat_map(|line| &line.points).map(|(seconds, _)| *seconds));
    let marks = ticks(&seconds);
    chart(
        &root,
        (title, "seconds of device time", "relMSE"),
        (seconds.log_scale().with_key_points(marks), &short),
        &lines,
    )?;
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::error::{Key, Outcome, Run, Technique, summarize};

    /// A technique of half the error lies below another, and twice the time lies as far to the right wherever it is.
    #[test]
    fn both_axes_are_logarithmic() {
        let run = |sampler, spp: u32, error: f64| {
            let technique = Technique { estimator: Estimator::Nee, sampler };
            let outcome =
                |f: f64| Outcome { relmse: f * error / f64::from(spp), device_ms: f64::from(spp), wall_ms: 1.0 };
            Run {
                key: Key { technique, spp, seed: 0 },
                rays: 1,
                noisy: outcome(1.0),
                reconstructed: Some(outcome(0.25)),
            }
        };
        let runs: Vec<Run> = [4, 8, 16]
            .into_iter()
            .flat_map(|spp| [run(Sampler::Pcg, spp, 1.0), run(Sampler::Sobol, spp, 0.5)])
            .collect();
        let text = svg(&summarize(&runs, 0.0), "a title").expect("drawn");
        let document = roxmltree::Document::parse(&text).expect("XML");
        let words: Vec<&str> = document.descendants().filter_map(|n| n.text()).map(str::trim).collect();
        for word in ["a title", "nee+pcg", "nee+sobol", "nee+sobol, reconstructed", "seconds of device time", "relMSE"]
        {
            assert!(words.contains(&word), "no {word} in {words:?}");
        }
        let line = |opacity: &str| -> Vec<(f64, f64)> {
            let line = document
                .descendants()
                .find(|n| {
                    n.has_tag_name("polyline")
                        && n.attribute("opacity") == Some(opacity)
                        && n.attribute("stroke") == Some("#D62728")
                })
                .unwrap_or_else(|| panic!("no line of opacity {opacity}"));
            let number = |text: &str| text.parse::<f64>().expect("a number");
            let points = line.attribute("points").expect("points").split_whitespace();
            points.filter_map(|p| p.split_once(',')).map(|(x, y)| (number(x), number(y))).collect()
        };
        let (pcg, sobol) = (line("0.45"), line("1"));
        assert_eq!((pcg.len(), sobol.len()), (3, 3));
        for (p, s) in pcg.iter().zip(&sobol) {
            assert!(s.0 == p.0 && s.1 > p.1 + 10.0, "{pcg:?} {sobol:?}");
        }
        let step = |i: usize, f: fn(&(f64, f64)) -> f64| f(&pcg[i + 1]) - f(&pcg[i]);
        assert!(step(0, |p| p.0) > 20.0 && (step(0, |p| p.0) - step(1, |p| p.0)).abs() <= 2.0, "{pcg:?}");
        assert!(step(0, |p| p.1) > 20.0 && (step(0, |p| p.1) - step(1, |p| p.1)).abs() <= 2.0, "{pcg:?}");
    }
}
