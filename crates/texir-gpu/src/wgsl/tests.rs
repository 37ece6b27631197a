//! Every shader composes and validates; what is wrong is reported with its file and line.

use super::*;

const VARIANT: Variant =
    Variant { hierarchy: BvhStorage::Buffers, opacity: SceneOpacity::Opaque, roughness: RoughnessGradient::Exact };

fn message(sources: &[(&str, &str)]) -> String {
    match Library(sources).compose("pass", VARIANT) {
        Ok(_) => panic!("composed, though it should not"),
        Err(e) => e.to_string(),
    }
}

#[test]
fn every_entry_point_composes_and_validates() {
    let mut entries = Vec::new();
    for name in SHADERS.passes() {
        for variant in Variant::all() {
            let composed = SHADERS.compose(name, variant).unwrap_or_else(|e| panic!("{name}, {variant:?}: {e}"));
            assert!(!composed.module.entry_points.is_empty(), "{name} has no entry point");
            entries.extend(composed.module.entry_points.iter().map(|e| e.name.clone()));
        }
    }
    entries.sort();
    entries.dedup();
    let expected = [
        "clean",
        "conserve",
        "gather_cosine",
        "gather_environment",
        "gather_lights",
        "lookup",
        "lookup_vjp",
        "mean_target",
        "measure_noise",
        "primary",
        "project",
        "punctual",
        "quantile_target",
        "radiance_loss",
        "reduce",
        "reduce_vjp",
        "regress",
        "shade",
        "shade_vjp",
        "smooth_halves",
        "specular_table",
        "texels",
    ];
    assert_eq!(entries, expected);
}

#[test]
fn every_shader_on_disk_is_embedded() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shaders");
    for (folder, prefix) in [(root.clone(), ""), (root.join("shared"), "shared/")] {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "wgsl") {
                let name = format!("{prefix}{}", path.file_stem().unwrap().to_string_lossy());
                assert!(SHADERS.0.iter().any(|(n, _)| *n == name), "{name} is not in the library");
            }
        }
    }
}

#[test]
fn variants_change_the_source() {
    let source = |variant| SHADERS.compose("shade", variant).unwrap().source;
    let base = source(VARIANT);
    assert_ne!(base, source(Variant { hierarchy: BvhStorage::Textures, ..VARIANT }));
    assert_ne!(base, source(Variant { opacity: SceneOpacity::InParts, ..VARIANT }));
    assert_ne!(base, source(Variant { roughness: RoughnessGradient::Authors, ..VARIANT }));
}

#[test]
fn a_module_is_imported_once() {
    let sources = [
        ("pass", "#import a\n#import b\n@compute @workgroup_size(1) fn main() { _ = one(); }\n"),
        ("shared/a", "fn one() -> u32 { return 1u; }\n"),
        ("shared/b", "#import a\n"),
    ];
    let composed = Library(&sources).compose("pass", VARIANT).unwrap();
    assert_eq!(composed.source.matches("fn one").count(), 1);
}

#[test]
fn an_unknown_import_names_its_place_and_what_there_is() {
    let m = message(&[("pass", "#import a\n"), ("shared/a", "\n\n#import nowhere\n")]);
    assert!(m.starts_with("shared/a.wgsl:3: ") && m.contains("nowhere"), "{m}");
}

#[test]
fn a_syntax_error_is_mapped_back_to_its_file() {
    let m = message(&[("pass", "#import a\n"), ("shared/a", "const A = 1u;\nconst B = ;\n")]);
    assert!(m.starts_with("shared/a.wgsl:2:"), "{m}");
}

#[test]
fn a_type_error_is_mapped_back_to_its_file() {
    let m = message(&[
        ("pass", "#import a\n\n@compute @workgroup_size(1) fn main() {\n    var x: f32 = half();\n}\n"),
        ("shared/a", "fn half() -> u32 { return 1u; }\n"),
    ]);
    assert!(m.starts_with("pass.wgsl:4:"), "{m}");
}
