//! Charts, drawn with `plotters` and a font that the program carries, so that they look alike everywhere.

use crate::markdown::method_name;
use crate::metrics::metric;
use crate::report::{ObjectRecord, Report, Step};
use lumi_core::DisplayImage;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::collections::BTreeMap;
use std::error::Error;

/// A chart's failure, in the plotting crate's words.
type Drawn<T> = Result<T, Box<dyn Error>>;

const PAPER: RGBColor = RGBColor(246, 246, 243);
const INK: RGBColor = RGBColor(40, 40, 46);
const FAINT: RGBColor = RGBColor(208, 208, 204);
/// Colours that stay apart for colour-blind readers (Okabe and Ito 2008).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 86, 96),
];
const FONT: &str = "sans-serif";
/// Charts are drawn this much larger and then averaged: letters and lines stand where they belong, not on whole pixels.
const FINE: u32 = 3;
/// The same for coordinates.
const STEP: i32 = FINE as i32;

/// A named list of values, at 1, 2, 3…
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Values; gaps are left out.
    pub values: Vec<Option<f64>>,
}

/// One chart of a figure.
pub struct Chart {
    /// Above it.
    pub title: String,
    /// Along the x axis.
    pub x: String,
    /// Along the y axis.
    pub y: String,
    /// What it shows.
    pub series: Vec<Series>,
    /// Names of the groups of bars; lines if empty.
    pub groups: Vec<String>,
}

/// Charts side by side on one page of `width × height` pixels.
///
/// # Errors
/// In the plotting crate's words; none is known for finite values.
pub fn draw(charts: &[Chart], (width, height): (u32, u32)) -> crate::Result<DisplayImage> {
    let fine = (FINE * width, FINE * height);
    let mut bytes = vec![0; fine.0 as usize * fine.1 as usize * 3];
    page(charts, fine, &mut bytes)
        .map_err(|e| lumi_core::Error::value("chart", format!("could not be drawn: {e}")))?;
    let pixels = bytes.as_chunks::<3>().0.iter();
    let large = DisplayImage {
        width: fine.0 as usize,
        height: fine.1 as usize,
        pixels: pixels.map(|p| p.map(|v| f32::from(v) / 255.0)).collect(),
        alpha: None,
    };
    Ok(large.resized(width as usize, height as usize))
}

fn page(charts: &[Chart], size: (u32, u32), bytes: &mut [u8]) -> Drawn<()> {
    let font = epaint_default_fonts::UBUNTU_LIGHT;
    plotters::style::register_font(FONT, FontStyle::Normal, font)
        .map_err(|_| "the built-in font cannot be read")?;
    let root = BitMapBackend::with_buffer(bytes, size).into_drawing_area();
    root.fill(&PAPER)?;
    for (chart, area) in charts
        .iter()
        .zip(root.split_evenly((1, charts.len().max(1))))
    {
        if chart.groups.is_empty() {
            lines(chart, &area)?;
        } else {
            bars(chart, &area)?;
        }
    }
    root.present()?;
    Ok(())
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, Shift>;

/// Lowest and highest value with some air; `floor` is always inside.
fn range(chart: &Chart, floor: Option<f64>) -> (f64, f64) {
    let values = chart
        .series
        .iter()
        .flat_map(|s| s.values.iter().flatten().copied());
    let (low, high) = values
        .chain(floor)
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(v), h.max(v))
        });
    if low > high {
        return (0.0, 1.0);
    }
    let air = (0.08 * (high - low)).max(1e-3);
    (if floor == Some(low) { low } else { low - air }, high + air)
}

fn lines(chart: &Chart, area: &Area) -> Drawn<()> {
    let count = chart
        .series
        .iter()
        .map(|s| s.values.len())
        .max()
        .unwrap_or(1);
    let (low, high) = range(chart, None);
    // Room for the legend above the lines.
    let high = high + 0.1 * chart.series.len() as f64 * (high - low);
    let mut context = ChartBuilder::on(area)
        .margin(FINE * 18)
        .caption(&chart.title, (FONT, FINE * 24, &INK))
        .x_label_area_size(FINE * 46)
        .y_label_area_size(FINE * 66)
        .build_cartesian_2d(0.7..count as f64 + 0.3, low..high)?;
    context
        .configure_mesh()
        .bold_line_style(FAINT.stroke_width(FINE))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.stroke_width(FINE))
        .set_all_tick_mark_size(FINE * 5)
        .label_style((FONT, FINE * 17, &INK))
        .axis_desc_style((FONT, FINE * 19, &INK))
        .x_labels(count.min(12))
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| short(*y, high - low))
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .draw()?;
    for (series, color) in chart.series.iter().zip(COLORS.iter().cycle()) {
        let points: Vec<(f64, f64)> = series
            .values
            .iter()
            .enumerate()
            .filter_map(|(i, v)| Some((i as f64 + 1.0, (*v)?)))
            .collect();
        context
            .draw_series(LineSeries::new(
                points.clone(),
                color.stroke_width(FINE * 2),
            ))?
            .label(&series.name)
            .legend(move |(x, y)| {
                PathElement::new([(x, y), (x + STEP * 22, y)], color.stroke_width(FINE * 2))
            });
        context.draw_series(
            points
                .into_iter()
                .map(|p| Circle::new(p, FINE * 4, color.filled())),
        )?;
    }
    context
        .configure_series_labels()
        .background_style(PAPER.mix(0.85))
        .border_style(FAINT.stroke_width(FINE))
        .margin(FINE * 6)
        .legend_area_size(FINE * 30)
        .label_font((FONT, FINE * 17, &INK))
        .position(SeriesLabelPosition::UpperRight)
        .draw()?;
    Ok(())
}

fn bars(chart: &Chart, area: &Area) -> Drawn<()> {
    let (low, high) = range(chart, Some(0.0));
    let n = chart.groups.len();
    let mut context = ChartBuilder::on(area)
        .margin(FINE * 18)
        .caption(&chart.title, (FONT, FINE * 24, &INK))
        .x_label_area_size(FINE * 46)
        .y_label_area_size(FINE * 66)
        .build_cartesian_2d(0.0..n as f64, low..high * 1.12)?;
    let name = |x: &f64| {
        // Labels stand in the middle of the groups: with n lines they fall on whole numbers.
        let i = x.round() as usize;
        chart.groups.get(i).cloned().unwrap_or_default()
    };
    context
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(FAINT.stroke_width(FINE))
        .light_line_style(TRANSPARENT)
        .axis_style(INK.stroke_width(FINE))
        .set_all_tick_mark_size(FINE * 5)
        .label_style((FONT, FINE * 17, &INK))
        .axis_desc_style((FONT, FINE * 19, &INK))
        .x_labels(0)
        .x_label_formatter(&name)
        .y_label_formatter(&|y| short(*y, high - low))
        .x_desc(&chart.x)
        .y_desc(&chart.y)
        .draw()?;
    let width = 0.76 / chart.series.len().max(1) as f64;
    for (k, (series, color)) in chart.series.iter().zip(COLORS.iter().cycle()).enumerate() {
        let left = |i: usize| i as f64 + 0.12 + k as f64 * width;
        let boxes = series.values.iter().enumerate().filter_map(|(i, v)| {
            let corners = [(left(i), 0.0), (left(i) + 0.94 * width, (*v)?)];
            Some(Rectangle::new(corners, color.filled()))
        });
        context
            .draw_series(boxes)?
            .label(&series.name)
            .legend(move |(x, y)| {
                Rectangle::new(
                    [(x, y - STEP * 6), (x + STEP * 14, y + STEP * 6)],
                    color.filled(),
                )
            });
    }
    // Names of the groups below the axis, centred, smaller where there are many.
    let size = if n > 10 { 13 } else { 16_u32 };
    let style = |vertical| {
        let style = (FONT, FINE * size, &INK).into_text_style(area);
        style.pos(Pos::new(HPos::Center, vertical))
    };
    let (left, top) = area.get_base_pixel();
    for (i, group) in chart.groups.iter().enumerate() {
        let (x, y) = context.backend_coord(&(i as f64 + 0.5, low));
        area.draw_text(group, &style(VPos::Top), (x - left, y - top + STEP * 6))?;
    }
    // A single bar per group has room for its value.
    if let [series] = chart.series.as_slice() {
        for (i, value) in series.values.iter().enumerate() {
            let Some(value) = value else { continue };
            let (x, y) = context.backend_coord(&(i as f64 + 0.5, value.max(0.0)));
            let text = short(*value, 0.1 * (high - low));
            area.draw_text(&text, &style(VPos::Bottom), (x - left, y - top - STEP * 4))?;
        }
    }
    if chart.series.len() > 1 {
        context
            .configure_series_labels()
            .background_style(PAPER.mix(0.85))
            .border_style(FAINT.stroke_width(FINE))
            .margin(FINE * 6)
            .legend_area_size(FINE * 30)
            .label_font((FONT, FINE * 17, &INK))
            .position(SeriesLabelPosition::UpperRight)
            .draw()?;
    }
    Ok(())
}

/// As many decimals as a range needs.
fn short(value: f64, range: f64) -> String {
    let decimals = if range > 20.0 {
        0
    } else if range > 1.0 {
        1
    } else if range > 0.1 {
        2
    } else {
        3
    };
    format!("{value:.decimals$}")
}

/// PSNR and SSIM over the steps of a chain, one line per method, after one scale per scene.
#[must_use]
pub fn chain_charts(title: &str, methods: &BTreeMap<String, Vec<Step>>) -> Vec<Chart> {
    let order = ["token", "pixel", "direct"];
    let charts = ["psnr", "ssim"].into_iter().filter_map(metric).map(|m| {
        let series = order.iter().filter_map(|key| {
            let steps = methods.get(*key)?;
            let values = steps.iter().map(|s| s.figures.whole.slr.get(m.name));
            let name = match *key {
                "token" => "token space",
                "pixel" => "pixel space",
                _ => "one edit",
            };
            Some(Series {
                name: name.to_owned(),
                values: values.collect(),
            })
        });
        let unit = if m.unit.is_empty() {
            String::new()
        } else {
            format!(" [{}]", m.unit)
        };
        Chart {
            title: title.to_owned(),
            x: "edit".to_owned(),
            y: format!("{}{unit}", m.label),
            series: series.collect(),
            groups: Vec::new(),
        }
    });
    charts.collect()
}

/// Scale that each view wants, relative to the case's mean, for one case of one object; a consistent method's
/// bars are equally high.
#[must_use]
pub fn tone_chart(report: &Report, object: &str, case: &str) -> Option<Chart> {
    let case_name = case;
    let case = report.per_object.get(object)?.cases.get(case)?;
    let relative = |scales: &[f32]| {
        let mean = scales.iter().sum::<f32>() / scales.len().max(1) as f32;
        scales.iter().map(|s| Some(f64::from(s / mean))).collect()
    };
    let mut series = vec![Series {
        name: method_name("model").to_owned(),
        values: relative(&case.figures.tone.per_view),
    }];
    for key in ["unedited", "nearest"] {
        if let Some(figures) = case.trivial.get(key) {
            series.push(Series {
                name: method_name(key).to_owned(),
                values: relative(&figures.tone.per_view),
            });
        }
    }
    Some(Chart {
        title: format!(
            "{}, {case_name}: exposure that each view wants",
            object.replace('_', " ")
        ),
        x: "view".to_owned(),
        y: "exposure / mean exposure".to_owned(),
        series,
        groups: case.views.clone(),
    })
}

/// The spread of per-view scales of each object and method, in percent (100 times that of their logarithms).
#[must_use]
pub fn spread_chart(report: &Report) -> Chart {
    let objects: Vec<&String> = report.per_object.keys().collect();
    let mut series = vec![Series {
        name: method_name("model").to_owned(),
        values: report
            .per_object
            .values()
            .map(|o| Some(100.0 * o.figures.tone.spread?))
            .collect(),
    }];
    for key in ["unedited", "nearest"]
        .into_iter()
        .filter(|k| report.trivial.contains_key(*k))
    {
        let of = |o: &ObjectRecord| Some(100.0 * o.trivial.get(key)?.tone.spread?);
        series.push(Series {
            name: method_name(key).to_owned(),
            values: report.per_object.values().map(of).collect(),
        });
    }
    Chart {
        title: "How far apart the exposures are that single views want (lower is better)"
            .to_owned(),
        x: "object".to_owned(),
        y: "standard deviation [%]".to_owned(),
        series,
        groups: objects.into_iter().map(|n| n.replace('_', " ")).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charts_have_ink_and_survive_gaps() {
        let chart = |groups: Vec<String>| Chart {
            title: "t".into(),
            x: "x".into(),
            y: "y".into(),
            series: vec![
                Series {
                    name: "a".into(),
                    values: vec![Some(1.0), None, Some(3.0)],
                },
                Series {
                    name: "b".into(),
                    values: vec![],
                },
            ],
            groups,
        };
        let groups = ["u", "v", "w"].map(str::to_owned).to_vec();
        let image = draw(&[chart(vec![]), chart(groups)], (640, 300)).expect("drawn");
        let blue = |p: &&[f32; 3]| p[2] > p[0] + 0.3;
        let left = image
            .pixels
            .iter()
            .enumerate()
            .filter(|(i, p)| i % 640 < 320 && blue(p))
            .count();
        let right = image
            .pixels
            .iter()
            .enumerate()
            .filter(|(i, p)| i % 640 >= 320 && blue(p))
            .count();
        assert!(left > 50 && right > 500, "{left} {right}");
        let empty = Chart {
            series: vec![],
            ..chart(vec![])
        };
        draw(&[empty], (200, 200)).expect("nothing to show is no failure");
    }
}
