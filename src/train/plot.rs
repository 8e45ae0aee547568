//! The course of a training run as an SVG picture: the loss above, MAE01 below.

use super::evaluate::Evaluation;
use super::run::RunState;
use crate::Error;
use crate::chart::{Drawn, Line, chart, short};
use plotters::prelude::*;

const SIZE: (u32, u32) = (960, 800);
const TRAINING: RGBColor = RGBColor(31, 119, 180);
const HELD_OUT: RGBColor = RGBColor(214, 39, 40);
const BATCHES: RGBColor = RGBColor(190, 190, 190);

/// The picture as SVG.
pub fn svg(state: &RunState) -> crate::Result<String> {
    let mut text = String::new();
    draw(state, &mut text).map_err(|e| Error::input(format!("plot: {e}")))?;
    Ok(text)
}

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
        Line::new("batches, mean of 50", BATCHES, batches),
        Line::new("training", TRAINING, evaluated(&|e| e.loss)),
        Line::new("held out", HELD_OUT, evaluated(&|e| e.held_out_loss)),
    ];
    let mae01 = [
        Line::new("training", TRAINING, evaluated(&|e| e.mae01)),
        Line::new("held out", HELD_OUT, evaluated(&|e| e.held_out_mae01)),
    ];
    let end = state.step.max(1) as f64 / unit;
    let (upper, lower) = root.split_vertically(SIZE.1 / 2);
    let title = format!("{}, preset {}", state.architecture, state.data.preset());
    chart(&upper, (&title, axis, "loss"), (0.0..end, &short), &loss)?;
    chart(&lower, ("", axis, "MAE01: linear radiance"), (0.0..end, &short), &mae01)?;
    root.present()?;
    Ok(())
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
}
