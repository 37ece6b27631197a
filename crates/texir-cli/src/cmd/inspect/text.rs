//! What was found, in words.

use std::collections::BTreeMap;

use texir_core::capture::Split;
use texir_core::tbl::blur;

use super::findings::{ClassFindings, Findings, Inputs, ViewFindings};
use crate::console::count;

/// The findings in words, with a row each for as many cameras.
pub fn text(findings: &Findings, rows: usize) -> String {
    let Findings { origin, mesh, atlas, inputs, estimate, .. } = findings;
    let mut out = String::new();
    let mut line = |name: &str, value: String| out.push_str(&format!("{name:>16}  {value}\n"));
    line("capture", findings.capture.clone());
    let next = if origin.is_capture { "" } else { "; `texir import` makes a capture of it" };
    line("format", format!("{}{next}", origin.format));
    origin.assumed.iter().for_each(|assumed| line("assumed", assumed.clone()));
    line("mesh", format!("{}, {} triangles, {} vertices", mesh.file, mesh.triangles, mesh.vertices));
    let [x, y, z] = mesh.extent;
    line("extent", format!("{x:.2} × {y:.2} × {z:.2} m (z is up), {:.1} m² of surface", mesh.area));
    let [width, height] = atlas.size;
    line(
        "atlas",
        format!(
            "{width} × {height}, {:.1} % covered, {:.2} % of that overlapping, {} triangles outside, {:.0} texels per metre",
            100.0 * atlas.covered_fraction,
            100.0 * atlas.overlapping_fraction,
            atlas.outside_triangles,
            atlas.texels_per_metre
        ),
    );
    line("views", format!("{} training, {} novel", inputs.train, inputs.novel));
    if let Some(blur) = findings.blur.filter(|blur| *blur < blur::SHARP) {
        line("images", format!("as sharp as their pixels (point spread of {blur:.2} square pixels beyond)"));
    }
    line(
        "annotated",
        format!(
            "semantic {}, mask {}, room {} of {} views",
            inputs.semantic,
            inputs.mask,
            inputs.room,
            findings.views.len()
        ),
    );
    let class = |class: &ClassFindings| {
        let name = class.name.clone().unwrap_or_else(|| format!("class {}", class.id));
        format!("{name} {:.1} %", 100.0 * class.share)
    };
    if !findings.classes.is_empty() {
        line("classes", findings.classes.iter().map(class).collect::<Vec<_>>().join(", "));
    }
    let yes = |known| if known { "given" } else { "to be built" };
    line("HDR texture", yes(inputs.hdr_texture).to_owned());
    line(
        "truth",
        format!(
            "albedo of {} views, roughness of {} views, {}",
            inputs.albedo,
            inputs.roughness,
            if inputs.true_textures { "textures" } else { "no textures" }
        ),
    );
    line(
        "cost of a fit",
        format!(
            "{} rays to bake, {} to fit, about {:.1} GB of memory",
            count(estimate.bake_rays),
            count(estimate.fit_rays),
            estimate.memory_bytes as f64 / 1e9
        ),
    );
    out.push_str(&cameras(&findings.views, rows));
    if let Some(left @ 1..) = findings.views.len().checked_sub(rows) {
        out.push_str(&format!("… {left} more, with -v; {}\n", summary(findings)));
    }
    for warning in &findings.warnings {
        out.push_str(&format!("warning: {warning}\n"));
    }
    out.trim_end().to_owned()
}

/// All cameras in a line.
fn summary(findings: &Findings) -> String {
    let Inputs { train, novel, semantic, mask, .. } = findings.inputs;
    let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    findings.views.iter().for_each(|view| *sizes.entry((view.width, view.height)).or_default() += 1);
    let sizes: Vec<String> = sizes.iter().map(|((w, h), count)| format!("{count} of {w} × {h}")).collect();
    format!(
        "in all {train} train and {novel} novel, {}; {semantic} with semantics, {mask} with masks",
        sizes.join(", ")
    )
}

/// A table of as many cameras as there are to be `rows`.
fn cameras(views: &[ViewFindings], rows: usize) -> String {
    let views = &views[..rows.min(views.len())];
    let width = views.iter().map(|v| v.name.chars().count()).max().unwrap_or(0).max(6);
    let mut out =
        format!("\n{:<width$}  split  projection       size          open   backs  above floor  nearest\n", "camera");
    let metres = |value: Option<f32>| value.map_or("-".to_owned(), |v| format!("{v:.2} m"));
    for view in views {
        let split = match view.split {
            Split::Train => "train",
            Split::Novel => "novel",
        };
        let size = format!("{} × {}", view.width, view.height);
        out += &format!(
            "{:<width$}  {split}  {:<15}  {size:<11}  {:>3.0} %  {:>4.0} %  {:>11}  {:>7}\n",
            view.name,
            view.projection,
            100.0 * view.no_hit,
            100.0 * view.back_faces,
            metres(view.height_above_floor),
            metres(view.nearest)
        );
    }
    out
}
