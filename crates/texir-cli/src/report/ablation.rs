//! The page of an ablation: figures of every variant, and what one view shows of it (paper, Table 3 and Figure 8).

use texir_core::eval::Table;

use super::page::{document, error_legend, escape, img, push};
use super::picture::Picture;
use crate::figures::FIGURES;

/// Everything on the page.
pub struct Ablation {
    /// Name of the capture.
    pub title: String,
    /// The view whose pictures are shown.
    pub view: String,
    /// From the least to the most.
    pub variants: Vec<Variant>,
    /// The true materials: their figures under the same light, and their pictures.
    pub truth: Option<(Table, Pictures)>,
}

/// A way to fit.
pub struct Variant {
    /// What it is called.
    pub name: &'static str,
    /// What it leaves out.
    pub note: &'static str,
    /// Its figures.
    pub table: Table,
    /// What the view shows.
    pub pictures: Pictures,
}

/// Materials as a view sees them.
pub struct Pictures {
    /// Albedo.
    pub albedo: Picture,
    /// Perceptual roughness.
    pub roughness: Picture,
    /// Where roughness differs from the truth.
    pub error: Option<Picture>,
}

/// The whole page.
pub fn html(ablation: &Ablation) -> String {
    let summary = "What each part of the method is worth: the same capture, fitted without it.";
    document(&ablation.title, summary, |page| {
        table(page, ablation);
        push!(page, "<h2>{}</h2>\n<p class=\"note\">Materials as this view sees them.</p>\n", escape(&ablation.view));
        error_legend(page);
        let truth = ablation.truth.iter().map(|(_, pictures)| ("true materials", "", pictures));
        for (name, note, pictures) in truth.chain(ablation.variants.iter().map(|v| (v.name, v.note, &v.pictures))) {
            row(page, name, note, pictures);
        }
    })
}

fn table(page: &mut String, ablation: &Ablation) {
    let shown = || FIGURES.iter().filter(|figure| !figure.minor);
    page.push_str(
        "<div class=\"card scroll\" style=\"margin-top:34px\"><table class=\"figures\">\n<thead><tr><th></th>",
    );
    shown().for_each(|figure| push!(page, "<th>{}</th>", figure.name));
    page.push_str("</tr></thead>\n<tbody>\n");
    let variants = ablation.variants.iter().map(|v| (v.name, &v.table));
    for (name, table) in variants.chain(ablation.truth.iter().map(|(table, _)| ("true materials, same light", table))) {
        push!(page, "<tr><th scope=\"row\">{name}</th>");
        for figure in shown() {
            match (figure.of)(table) {
                Some(s) => push!(page, "<td>{:.2} dB / {:.3}</td>", s.psnr, s.ssim),
                None => page.push_str("<td></td>"),
            }
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody></table></div>\n<p class=\"note\" style=\"margin-top:12px\">PSNR / SSIM.</p>\n");
}

fn row(page: &mut String, name: &str, note: &str, Pictures { albedo, roughness, error }: &Pictures) {
    push!(page, "<section class=\"card view\"><header><h3>{name}</h3><span class=\"note\">{note}</span></header>\n");
    page.push_str("<div class=\"columns\">\n");
    for (what, picture) in
        [("Albedo", Some(albedo)), ("Roughness", Some(roughness)), ("Roughness error", error.as_ref())]
    {
        if let Some(picture) = picture {
            push!(
                page,
                "<figure>{}<figcaption>{what}</figcaption></figure>\n",
                img(picture, format_args!("{what}, {name}"))
            );
        }
    }
    page.push_str("</div></section>\n");
}
