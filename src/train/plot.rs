//! The course of a training run as an SVG picture: the loss above, MAE01 below.

use super::evaluate::Evaluation;
use super::run::RunState;
use crate::Error;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::ops::Range;

const SIZE: (u32, u32) = (960, 800);
const TRAINING: RGBColor = RGBColor(31, 119, 180);
const HELD_OUT: RGBColor = RGBColor(214, 39, 40);
const BATCHES: RGBColor = RGBColor(190, 190, 190);

/// A line of a chart.
struct Line {
    label: &'static str,
    color: RGBColor,
    points: Vec<(f64, f64)>,
}

/// The picture as SVG.
pub fn svg(state: &RunState) -> crate::Result<String> {
    let mut text = String::new();
    draw(state, &mut text).map_err(|e| Error::input(format!("plot: {e}")))?;
    Ok(text)
}

type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

fn draw(state: &RunState, text: &mut String) -> Drawn {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    // Epochs where there are any.
    let (unit, axis) = match state.data.stored() {
        Some(s) => (s.epoch_chunks as f64 / f64::from(s.batch), "epochs"),
        None => (1.0, "steps"),
    };
    let evaluated = |value: &dyn Fn(&Evaluation) -> f64| -> Vec<(f64, f64)> {
        state.evaluations.iter().map(|e| (e.step as f64 / unit, value(e))).collect()
    };
    let batches = state.losses.iter().map(|(step, loss)| (*step as f64 / unit, *loss)).collect();
    let loss = [
        Line { label: "batches, mean of 50", color: BATCHES, points: batches },
        Line { label: "training", color: TRAINING, points: evaluated(&|e| e.loss) },
        Line { label: "held out", color: HELD_OUT, points: evaluated(&|e| e.held_out_loss) },
    ];
    let mae01 = [
        Line { label: "training", color: TRAINING, points: evaluated(&|e| e.mae01) },
        Line { label: "held out", color: HELD_OUT, points: evaluated(&|e| e.held_out_mae01) },
    ];
    let end = state.step.max(1) as f64 / unit;
    let (upper, lower) = root.split_vertically(SIZE.1 / 2);
    let title = format!("{}, preset {}", state.architecture, state.data.preset());
    chart(&upper, (&title, axis, "loss: MAE, network's space"), end, &loss)?;
    chart(&lower, ("", axis, "MAE01: linear radiance"), end, &mae01)?;
    root.present()?;
    Ok(())
}

/// One chart with a logarithmic axis of values; title and the names of the axes.
fn chart(
    area: &DrawingArea<SVGBackend, Shift>,
    (title, across, up): (&str, &str, &str),
    end: f64,
    lines: &[Line],
) -> Drawn {
    let values = lines.iter().flat_map(|line| &line.points).map(|(_, value)| *value).filter(|v| *v > 0.0);
    let range = padded(values);
    let ticks = ticks(&range);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(0.0..end, range.log_scale().with_key_points(ticks))?;
    chart
        .configure_mesh()
        .x_desc(across)
        .y_desc(up)
        .x_labels(10)
        .x_label_formatter(&short)
        .y_label_formatter(&short)
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 16))
        .light_line_style(TRANSPARENT)
        .draw()?;
    for Line { label, color, points } in lines {
        let style = color.stroke_width(2);
        let shown = points.iter().copied().filter(|(_, value)| *value > 0.0);
        chart
            .draw_series(LineSeries::new(shown, style).point_size(if points.len() < 40 { 3 } else { 0 }))?
            .label(*label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .legend_area_size(30)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 15))
        .draw()?;
    Ok(())
}

/// A range around positive values; some range where there are none.
fn padded(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0f64), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { low / 1.2..high * 1.2 } else { 0.01..1.0 }
}

/// Marks of a logarithmic axis: the coarsest steps from one power of ten to the next that give three marks or more, else the finest.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    // In hundredths of a power of ten.
    let steps: [&[u32]; 3] = [
        &[100, 200, 500],
        &[100, 150, 200, 300, 400, 500, 700],
        &[100, 110, 120, 130, 140, 150, 160, 180, 200, 220, 250, 280, 300, 350, 400, 450, 500, 550, 600, 700, 800, 900],
    ];
    let marks = |steps: &[u32]| -> Vec<f64> {
        let powers = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
        let all = powers.flat_map(|p| steps.iter().map(move |s| f64::from(*s) * 10f64.powi(p - 2)));
        all.filter(|mark| range.contains(mark)).collect()
    };
    let enough = steps[..2].iter().map(|steps| marks(steps)).find(|marks| marks.len() >= 3);
    enough.unwrap_or_else(|| marks(steps[2]))
}

/// A number with as many digits as it needs.
fn short(value: &f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::data::DataSettings;
    use crate::train::run::Length;

    fn state() -> RunState {
        let mut state = RunState::new("seed", DataSettings::default(), 1e-3, Length::Steps(1000), None);
        state.step = 1000;
        for i in 1..=20u64 {
            state.losses.push((50 * i, 0.3 / i as f64));
        }
        for i in 1..=4u64 {
            let value = 0.2 / i as f64;
            let (loss, held_out_loss) = (value, 1.2 * value);
            let (mae01, held_out_mae01) = (0.1 * value, 0.13 * value);
            state.evaluations.push(Evaluation {
                step: 250 * i,
                epoch: None,
                loss,
                held_out_loss,
                mae01,
                held_out_mae01,
            });
        }
        state
    }

    #[test]
    fn the_picture_is_valid_svg_with_every_line_and_label() {
        let text = svg(&state()).expect("drawn");
        let document = roxmltree::Document::parse(&text).expect("XML");
        let words: Vec<&str> = document.descendants().filter_map(|n| n.text()).map(str::trim).collect();
        for word in ["steps", "training", "held out", "0.05", "0.1", "1000", "seed, preset fresh"] {
            assert!(words.contains(&word), "no {word} in {words:?}");
        }
        let colors = |color: &str| document.descendants().filter(|n| n.attribute("stroke") == Some(color)).count();
        // Two lines and two legends each; the legend alone would be two.
        assert!(colors("#1F77B4") >= 4 && colors("#D62728") >= 4);
    }

    /// Held-out losses above training's lie above them in the picture, and what is halved goes down the same way twice.
    #[test]
    fn the_axis_is_logarithmic() {
        let text = svg(&state()).expect("drawn");
        let document = roxmltree::Document::parse(&text).expect("XML");
        let line = |color: &str| -> Vec<f64> {
            let line =
                document.descendants().find(|n| n.has_tag_name("polyline") && n.attribute("stroke") == Some(color));
            let points = line.and_then(|n| n.attribute("points")).expect("a line");
            points.split_whitespace().map(|p| p.split(',').nth(1).expect("y").parse().expect("a number")).collect()
        };
        let (training, held_out) = (line("#1F77B4"), line("#D62728"));
        assert_eq!((training.len(), held_out.len()), (4, 4));
        assert!(training.iter().zip(&held_out).all(|(t, h)| h < t), "{training:?} {held_out:?}");
        // 1, 1/2, 1/4: whole pixels.
        let (first, second) = (training[1] - training[0], training[3] - training[1]);
        assert!(first > 20.0 && (first - second).abs() <= 2.0, "{training:?}");
    }

    #[test]
    fn a_run_that_has_just_begun_has_a_picture() {
        let state = RunState::new("seed", DataSettings::default(), 1e-3, Length::Steps(10), None);
        assert!(svg(&state).expect("drawn").contains("held out"));
        let mut one = self::state();
        one.evaluations.truncate(1);
        one.losses.clear();
        svg(&one).expect("drawn");
    }

    #[test]
    fn marks_are_few_and_inside() {
        // Whatever the range, once `padded`: 1.44 times or more from end to end.
        for low in (0..200).map(|i| 1e-4 * 1.05f64.powi(i)) {
            for high in (0..100).map(|i| low * 1.44 * 1.1f64.powi(i)) {
                let ticks = ticks(&(low..high));
                assert!((2..=20).contains(&ticks.len()), "{low} {high} {ticks:?}");
                assert!(ticks.iter().all(|t| (low..high).contains(t)));
            }
        }
        assert_eq!(
            ticks(&(0.02..1.5)).iter().map(short).collect::<Vec<_>>(),
            ["0.02", "0.05", "0.1", "0.2", "0.5", "1"]
        );
        assert_eq!((short(&0.02), short(&1000.0), short(&0.0)), ("0.02".into(), "1000".into(), "0".into()));
    }
}
