//! The page's HTML. Nothing is fetched: style, pictures and charts are in the file.

use std::fmt::Display;

use texir_core::capture::Split;

use crate::figures::{FIGURES, Figure, lacks};

use super::picture::{ERROR_COLOURS, ERROR_RANGE, Picture, UNCOUNTED};
use super::{Report, Row, TextureFigure, ViewPanel};

/// Appends formatted text.
macro_rules! push {
    ($page:expr, $($text:tt)*) => { $page.push_str(&format!($($text)*)) };
}
pub(super) use push;

/// The whole page of a fit.
pub fn html(report: &Report) -> String {
    document(&report.title, &report.summary, |page| {
        tiles(page, report);
        figures(page, report);
        textures(page, report);
        rooms(page, report);
        curves(page, report);
        views(page, report);
        facts(page, report);
    })
}

/// A page of this house: head, title, what `body` appends, foot.
pub(super) fn document(title: &str, summary: &str, body: impl FnOnce(&mut String)) -> String {
    let mut page = String::from("<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n");
    page += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
    push!(page, "<title>{} · texir</title>\n", escape(title));
    push!(page, "<style>\n{}</style>\n<main>\n", include_str!("style.css"));
    page.push_str("<header>\n<p class=\"eyebrow\">texir · inverse rendering</p>\n");
    push!(page, "<h1>{}</h1>\n<p class=\"lede\">{}</p>\n</header>\n", escape(title), escape(summary));
    body(&mut page);
    push!(page, "<footer>Written by texir {}.</footer>\n</main>\n", env!("CARGO_PKG_VERSION"));
    page
}

fn tiles(page: &mut String, report: &Report) {
    page.push_str("<div class=\"tiles\">\n");
    let evaluation = &report.evaluation;
    for Figure { name, of, .. } in FIGURES.iter().filter(|f| !f.minor) {
        let Some(score) = of(&evaluation.result) else { continue };
        let name = name.split(',').next().unwrap_or(name);
        push!(page, "<div class=\"card tile\"><div class=\"label\">{name}</div>");
        push!(page, "<div class=\"value\">{:.2}<small>dB</small></div>", score.psnr);
        match evaluation.true_materials.as_ref().and_then(of) {
            Some(true_materials) => {
                push!(page, "<div class=\"beside\">true materials {:.2}</div>", true_materials.psnr)
            }
            None => push!(page, "<div class=\"beside\">SSIM {:.3}</div>", score.ssim),
        }
        page.push_str("</div>\n");
    }
    page.push_str("</div>\n");
}

fn figures(page: &mut String, report: &Report) {
    let evaluation = &report.evaluation;
    page.push_str(
        "<div class=\"card scroll\"><table class=\"figures\">\n<thead><tr><th></th><th colspan=\"3\">Result</th>",
    );
    if evaluation.true_materials.is_some() {
        page.push_str("<th class=\"true-materials\" colspan=\"3\">True materials, same light</th>");
    }
    page.push_str("</tr>\n<tr><th></th><th>PSNR, dB</th><th>SSIM</th><th>MSE</th>");
    if evaluation.true_materials.is_some() {
        page.push_str(
            "<th class=\"true-materials\">PSNR, dB</th><th class=\"true-materials\">SSIM</th><th class=\"true-materials\">MSE</th>",
        );
    }
    page.push_str("</tr></thead>\n<tbody>\n");
    for Figure { name, minor, of } in &FIGURES {
        let Some(score) = of(&evaluation.result) else { continue };
        let class = if *minor { " class=\"minor\"" } else { "" };
        push!(page, "<tr{class}><th scope=\"row\">{name}</th>");
        push!(page, "<td class=\"strong\">{:.2}</td><td>{:.4}</td><td>{:.4}</td>", score.psnr, score.ssim, score.mse);
        if let Some(true_materials) = &evaluation.true_materials {
            match of(true_materials) {
                Some(s) => {
                    for (value, digits) in [(s.psnr, 2), (s.ssim, 4), (s.mse, 4)] {
                        push!(page, "<td class=\"true-materials\">{value:.digits$}</td>");
                    }
                }
                None => page.push_str("<td class=\"true-materials\" colspan=\"3\"></td>"),
            }
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody></table></div>\n");
    push!(
        page,
        "<p class=\"note\" style=\"margin-top:12px\">Light sources are left out. Images and albedo are compared as shown on this \
         page, clamp(x<sup>1/2.2</sup>, 0, 1); roughness as it is. PSNR is that of the mean squared error over views; {} \
         rays a pixel. {}</p>\n",
        evaluation.samples,
        lacks(evaluation).unwrap_or(
            "True materials are rendered with the same lighting, atlas and renderer. A fit can exceed them in renderings, as \
             fitted materials also compensate for errors in the lighting."
        )
    );
}

fn textures(page: &mut String, report: &Report) {
    page.push_str("<h2>Textures</h2>\n<p class=\"note\">What was recovered, in the atlas of the mesh.</p>\n<div class=\"textures\">\n");
    for TextureFigure { name, note, picture } in &report.textures {
        push!(page, "<figure>{}", img(picture, name));
        push!(page, "<figcaption><b>{name}</b> {}</figcaption></figure>\n", escape(note));
    }
    page.push_str("</div>\n");
}

fn rooms(page: &mut String, report: &Report) {
    let Some(plan) = &report.rooms else { return };
    page.push_str("<h2>Rooms</h2>\n<p class=\"note\">Found in the mesh, seen from above. Surfaces of one class in one room share their roughness prior.</p>\n");
    push!(page, "<div class=\"card plan\"><figure>{}</figure></div>\n", img(plan, "Floor plan with rooms"));
}

fn curves(page: &mut String, report: &Report) {
    if report.curves.is_empty() {
        return;
    }
    page.push_str("<h2>Loss</h2>\n<p class=\"note\">Mean of each epoch, logarithmic. Each stage has its own loss: heights do not compare between charts.</p>\n<div class=\"key\">");
    for (name, variable) in [("total", "total"), ("image term", "image"), ("smoothness term", "smooth")] {
        push!(page, "<span style=\"--c:var(--{variable})\">{name}</span>");
    }
    page.push_str("</div>\n<div class=\"curves\">\n");
    for curve in &report.curves {
        push!(
            page,
            "<div class=\"card curve\"><header><h3>Stage {:?}</h3><span>ends at {:.4}</span></header>{}</div>\n",
            curve.stage,
            curve.last,
            curve.svg
        );
    }
    page.push_str("</div>\n");
}

fn views(page: &mut String, report: &Report) {
    page.push_str("<h2>Views</h2>\n<p class=\"note\">All pictures share one tone curve. Albedo is shown after the scaling used for its score.</p>\n");
    error_legend(page);
    page.push_str("<nav aria-label=\"Views\">");
    for (i, view) in report.views.iter().enumerate() {
        push!(page, "<a class=\"{}\" href=\"#view-{i}\">{}</a>", split(view.split).0, escape(&view.name));
    }
    page.push_str("</nav>\n");
    for (i, view) in report.views.iter().enumerate() {
        panel(page, i, view);
    }
}

/// What the colours of error maps mean.
pub(super) fn error_legend(page: &mut String) {
    let stops: Vec<String> = ERROR_COLOURS.iter().map(|c| css_colour(*c)).collect();
    push!(
        page,
        "<div class=\"legend\"><span>Error 0</span><span class=\"ramp\" style=\"background:linear-gradient(90deg,{})\"></span>\
         <span>{ERROR_RANGE} and more, of 1</span><span class=\"swatch\" style=\"background:{}\"></span><span>not counted</span></div>\n",
        stops.join(","),
        css_colour(UNCOUNTED)
    );
}

fn panel(page: &mut String, index: usize, view: &ViewPanel) {
    let (class, name) = split(view.split);
    push!(
        page,
        "<section class=\"card view\" id=\"view-{index}\"><header><h3>{}</h3><span class=\"badge {class}\">{name}</span></header>\n<div class=\"columns\">\n",
        escape(&view.name)
    );
    for Row { label, score, columns, truth, result, error } in &view.rows {
        push!(page, "<div class=\"row\"><b>{label}</b>");
        if let Some(s) = score {
            push!(page, "<span>PSNR {:.2} dB · SSIM {:.3}</span>", s.psnr, s.ssim);
        }
        page.push_str("</div>\n");
        let [truth_name, result_name] = *columns;
        for (picture, column) in [(truth.as_ref(), truth_name), (Some(result), result_name), (error.as_ref(), "Error")]
        {
            match picture {
                Some(picture) => push!(
                    page,
                    "<figure>{}<figcaption>{column}</figcaption></figure>\n",
                    img(picture, format_args!("{label}, {}, {}", column.to_lowercase(), escape(&view.name)))
                ),
                None => push!(page, "<figure><div class=\"missing\">no ground truth</div></figure>\n"),
            }
        }
    }
    page.push_str("</div></section>\n");
}

fn facts(page: &mut String, report: &Report) {
    page.push_str(
        "<h2>Run</h2>\n<div class=\"facts\">\n<div class=\"card\"><h3>Facts</h3><table style=\"margin-top:10px\">\n",
    );
    for (name, value) in &report.facts {
        push!(page, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value));
    }
    push!(
        page,
        "</table></div>\n<div class=\"card\"><h3>Settings</h3><pre>{}</pre></div>\n</div>\n",
        escape(report.settings.trim())
    );
}

pub(super) fn img(picture: &Picture, alt: impl Display) -> String {
    let Picture { width, height, data_uri } = picture;
    format!("<img src=\"{data_uri}\" width=\"{width}\" height=\"{height}\" alt=\"{alt}\" loading=\"lazy\">")
}

/// Class and name of a split.
fn split(split: Split) -> (&'static str, &'static str) {
    match split {
        Split::Train => ("train", "training view"),
        Split::Novel => ("novel", "novel view"),
    }
}

fn css_colour([r, g, b]: [u8; 3]) -> String {
    format!("rgb({r} {g} {b})")
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
