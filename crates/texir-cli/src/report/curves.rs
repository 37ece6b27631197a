//! Loss curves of the fit's stages, as inline SVG that takes its colours from the page.

use plotters::prelude::*;
use texir_core::fit::{EpochLog, Stage};

use crate::failure::Failure;

/// The curve of one stage.
#[derive(Clone, Debug)]
pub struct Curve {
    /// The stage.
    pub stage: Stage,
    /// Inline SVG.
    pub svg: String,
    /// Loss of the last epoch.
    pub last: f32,
}

/// Size of a chart in its own units; the page scales it.
const SIZE: (u32, u32) = (520, 300);

/// Placeholder colours of the series, which the style sheet replaces: total, image term, smoothness term.
const SERIES: [(&str, RGBColor); 3] =
    [("loss", RGBColor(1, 0, 0)), ("image", RGBColor(2, 0, 0)), ("smoothness", RGBColor(3, 0, 0))];

/// Reads `log.jsonl`.
pub fn parse(text: &str) -> Result<Vec<EpochLog>, Failure> {
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(i, line)| {
            serde_json::from_str(line)
                .map_err(|e| Failure::new(format!("log.jsonl, line {}: {e}", i + 1)).help("run `texir fit` again"))
        })
        .collect()
}

/// One chart per stage that ran.
pub fn draw(log: &[EpochLog]) -> Result<Vec<Curve>, Failure> {
    log.chunk_by(|a, b| a.stage == b.stage)
        .map(|epochs| {
            let stage = epochs[0].stage;
            let losses: Vec<[f32; 3]> = epochs.iter().map(|e| [e.loss, e.image, e.smooth]).collect();
            let svg = chart(&losses).map_err(|e| Failure::new(format!("the loss curve of stage {stage:?}: {e}")))?;
            Ok(Curve { stage, svg, last: losses.last().map_or(0.0, |e| e[0]) })
        })
        .collect()
}

/// Losses over a logarithmic axis; a series that is 0 throughout is left out.
fn chart(epochs: &[[f32; 3]]) -> Result<String, Box<dyn std::error::Error>> {
    let positive = || epochs.iter().flatten().copied().filter(|&v| v > 0.0 && v.is_finite());
    let low = positive().fold(f32::INFINITY, f32::min);
    let high = positive().fold(0.0, f32::max);
    let (low, high) = if low < high { (low / 1.15, high * 1.15) } else { (1e-3, 1.0) };
    let last_epoch = epochs.len().saturating_sub(1).max(1) as f32;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&area)
            .margin(6)
            .margin_right(14)
            .x_label_area_size(44)
            .y_label_area_size(62)
            .build_cartesian_2d(0.0..last_epoch, low.log10()..high.log10())?;
        chart
            .configure_mesh()
            .disable_x_mesh()
            .light_line_style(TRANSPARENT)
            .x_labels(5)
            .y_labels(5)
            .x_desc("epoch")
            .x_label_formatter(&|x| format!("{x:.0}"))
            .y_label_formatter(&|y| two_digits(10f32.powf(*y)))
            .label_style(("sans-serif", 16))
            .axis_desc_style(("sans-serif", 16))
            .draw()?;
        for (i, (_, colour)) in SERIES.iter().enumerate().rev() {
            if epochs.iter().any(|e| e[i] > 0.0) {
                let points = epochs.iter().enumerate().map(|(x, e)| (x as f32, e[i].max(low).log10()));
                chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
            }
        }
        area.present()?;
    }
    Ok(themed(&svg))
}

/// A positive number in two significant digits: 0.031, 1.2, 45, 3e-5.
fn two_digits(value: f32) -> String {
    let magnitude = value.log10().floor();
    if (-4.0..2.0).contains(&magnitude) {
        format!("{value:.*}", (1.0 - magnitude) as usize)
    } else {
        format!("{value:.1e}")
    }
}

/// Hands colours and size to the style sheet, and drops the namespace that inline SVG does without.
fn themed(svg: &str) -> String {
    let mut svg = svg.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "");
    svg = svg.replacen(&format!("width=\"{}\" height=\"{}\" ", SIZE.0, SIZE.1), "", 1);
    for (name, RGBColor(r, g, b)) in SERIES {
        svg = svg.replace(&format!("stroke=\"#{r:02X}{g:02X}{b:02X}\""), &format!("class=\"series-{name}\""));
    }
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log() -> Vec<EpochLog> {
        (0..30)
            .map(|i| EpochLog {
                stage: if i < 20 { Stage::I } else { Stage::II },
                epoch: i % 20,
                learning_rate: 0.03,
                loss: 1.0 / (i + 1) as f32,
                image: 0.5 / (i + 1) as f32,
                smooth: 0.0,
                seconds: f64::from(i),
            })
            .collect()
    }

    #[test]
    fn a_chart_per_stage_in_themed_colours() {
        let curves = draw(&log()).unwrap();
        assert_eq!(curves.iter().map(|c| c.stage).collect::<Vec<_>>(), [Stage::I, Stage::II]);
        for curve in &curves {
            assert!(curve.svg.contains("series-loss") && curve.svg.contains("series-image"), "{}", curve.svg);
            assert!(!curve.svg.contains("series-smoothness"));
            assert!(!curve.svg.contains("http"));
        }
        assert_eq!(curves[1].last, 1.0 / 30.0);
    }

    #[test]
    fn a_written_log_reads_back() {
        let lines: Vec<String> = log().iter().map(|e| serde_json::to_string(e).unwrap()).collect();
        assert_eq!(parse(&lines.join("\n")).unwrap(), log());
        assert!(parse("\n{\"stage\":\"I\"}").unwrap_err().to_string().contains("line 2"));
    }

    #[test]
    fn labels_are_short() {
        assert_eq!([0.0312, 1.23, 45.2, 0.000_031].map(two_digits), ["0.031", "1.2", "45", "3.1e-5"]);
    }

    #[test]
    fn degenerate_logs_still_draw() {
        assert!(draw(&[]).unwrap().is_empty());
        let mut one = log()[..1].to_vec();
        one[0].loss = f32::NAN;
        assert_eq!(draw(&one).unwrap().len(), 1);
    }
}
