//! Line charts as SVG.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use std::ops::Range;

/// A line of a chart.
pub struct Line {
    /// In the legend.
    pub label: String,
    /// Its colour.
    pub color: RGBAColor,
    /// Whether it is dashed.
    pub dashed: bool,
    /// Its points; values of 0 and less are not shown.
    pub points: Vec<(f64, f64)>,
}

impl Line {
    /// A whole line.
    pub fn new(label: impl Into<String>, color: impl Color, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.into(), color: color.to_rgba(), dashed: false, points }
    }
}

/// What drawing gives.
pub type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

/// One chart with a logarithmic axis of values; title and the names of the axes, the axis across and its labels.
pub fn chart<X: AsRangedCoord<Value = f64>>(
    area: &DrawingArea<SVGBackend, Shift>,
    (title, across, up): (&str, &str, &str),
    (x, x_label): (X, &dyn Fn(&f64) -> String),
    lines: &[Line],
) -> Drawn
where
    X::CoordDescType: ValueFormatter<f64>,
{
    let values = lines.iter().flat_map(|line| &line.points).map(|(_, value)| *value).filter(|v| *v > 0.0);
    let range = padded(values);
    let ticks = ticks(&range);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(76)
        .build_cartesian_2d(x, range.log_scale().with_key_points(ticks))?;
    chart
        .configure_mesh()
        .x_desc(across)
        .y_desc(up)
        .x_labels(10)
        .x_label_formatter(&x_label)
        .y_label_formatter(&short)
        .label_style(("sans-serif", 15))
        .axis_desc_style(("sans-serif", 16))
        .light_line_style(TRANSPARENT)
        .draw()?;
    for Line { label, color, dashed, points } in lines {
        let style = color.stroke_width(2);
        let shown = || points.iter().copied().filter(|(_, value)| *value > 0.0);
        let size = if points.len() < 40 { 3 } else { 0 };
        let series = if *dashed {
            chart.draw_series(shown().map(|point| Circle::new(point, size, style)))?;
            chart.draw_series(DashedLineSeries::new(shown(), 6, 4, style))?
        } else {
            chart.draw_series(LineSeries::new(shown(), style).point_size(size))?
        };
        let gap = if *dashed { 4 } else { 0 };
        series.label(label.as_str()).legend(move |(x, y)| {
            EmptyElement::at((x, y))
                + PathElement::new([(0, 0), (12 - gap, 0)], style)
                + PathElement::new([(12, 0), (24 - gap, 0)], style)
        });
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
pub fn padded(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = values.fold((f64::INFINITY, 0f64), |(low, high), v| (low.min(v), high.max(v)));
    if low <= high { low / 1.2..high * 1.2 } else { 0.01..1.0 }
}

/// Marks of a logarithmic axis: the coarsest steps from one power of ten to the next that give three marks or more, else the finest.
pub fn ticks(range: &Range<f64>) -> Vec<f64> {
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
pub fn short(value: &f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

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
