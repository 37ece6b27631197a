//! What every command makes of a good capture.

use std::ffi::OsString;
use std::path::Path;

use serde_json::Value;
use texir_core::image_io::{read_gray, read_labels, read_rgb, write_rgb};
use texir_core::raster::{Gray, Rgb};

use crate::room::{ATLAS, Capture, HEIGHT, VIEWS, WIDTH, names};
use crate::texir::{fit, quickly, run, succeed};

/// Everything that a fit with ground truth leaves behind.
const FILES: [&str; 15] = [
    "albedo.exr",
    "emission.exr",
    "hdr_texture.exr",
    "hdr_texture_mask.png",
    "irradiance.exr",
    "log.jsonl",
    "materials.json",
    "mesh.obj",
    "metrics.json",
    "report.html",
    "roughness.exr",
    "rooms.png",
    "run.json",
    "scene.glb",
    "settings.toml",
];

fn sorted(mut names: Vec<&str>) -> Vec<&str> {
    names.sort_unstable();
    names
}

/// Reads an EXR of the atlas' size; its values are finite and not negative, and some are above 0.
#[track_caller]
fn assert_light(path: &Path, size: [usize; 2]) {
    let image = read_rgb(path).unwrap();
    assert_eq!(image.size(), size, "{}", path.display());
    assert!(image.data.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{}", path.display());
    assert!(image.data.iter().flatten().any(|v| *v > 0.0), "{} is black", path.display());
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e} in {text}"))
}

/// Result and true materials have all rows of the table, and true materials render better than anything else.
#[track_caller]
fn assert_metrics(metrics: &Value) {
    for table in ["result", "true_materials"] {
        for pointer in
            ["train/albedo/per_image", "train/albedo/global", "train/roughness", "train/image", "novel/image"]
        {
            for figure in ["psnr", "ssim", "mse"] {
                let value = metrics.pointer(&format!("/{table}/{pointer}/{figure}")).and_then(Value::as_f64);
                assert!(value.is_some_and(f64::is_finite), "{table}/{pointer}/{figure} is {value:?}");
            }
        }
    }
    let psnr = |table: &str, of: &str| metrics.pointer(&format!("/{table}/train/{of}/psnr")).unwrap().as_f64().unwrap();
    assert!(psnr("true_materials", "roughness") > psnr("result", "roughness"), "two epochs cannot find the truth");
    assert!(psnr("true_materials", "image") > 20.0, "true materials render to {} dB", psnr("true_materials", "image"));
    assert_eq!(metrics["views"].as_array().unwrap().len(), VIEWS.len());
}

#[test]
fn inspect_sums_up_many_views() {
    let capture = Capture::new();
    let inspect = |more: &[&str]| {
        let more: Vec<_> = more.iter().map(AsRef::as_ref).collect();
        succeed(&[&["inspect".as_ref(), capture.path().as_os_str()], &more[..]].concat()).out
    };
    let add = |from: usize, to: usize| {
        capture.edit(|document| {
            for i in from..to {
                std::fs::copy(capture.file("hdr/a.exr"), capture.file(&format!("hdr/more_{i}.exr"))).unwrap();
                let matrix = document["frames"][0]["transform_matrix"].clone();
                let frame = serde_json::json!({ "file_path": format!("hdr/more_{i}.exr"), "transform_matrix": matrix, "split": "train" });
                document["frames"].as_array_mut().unwrap().push(frame);
            }
        });
    };
    add(VIEWS.len(), 30);
    let all = inspect(&[]);
    assert!(all.contains("\nmore_29 ") && !all.contains("with -v"), "{all}");
    add(30, 32);
    let some = inspect(&[]);
    let summary = "… 2 more, with -v; in all 31 train and 1 novel, 32 of 32 × 16; 4 with semantics, 4 with masks";
    assert!(some.contains("\nmore_29 ") && !some.contains("\nmore_30 ") && some.contains(summary), "{some}");
    let all = inspect(&["-v"]);
    assert!(all.contains("\nmore_31 ") && !all.contains("with -v"), "{all}");
}

#[test]
fn inspect_says_what_is_there() {
    let capture = Capture::new();
    let said = succeed(&["inspect".as_ref(), capture.path().as_os_str(), "--json".as_ref()]);
    let found = json(&said.out);
    for (pointer, expected) in [
        ("/mesh/triangles", 24),
        ("/inputs/train", 3),
        ("/inputs/novel", 1),
        ("/inputs/semantic", 4),
        ("/inputs/albedo", 4),
        ("/views/0/width", WIDTH),
        ("/atlas/outside_triangles", 0),
    ] {
        assert_eq!(found.pointer(pointer).and_then(Value::as_u64), Some(expected as u64), "{pointer} in {}", said.out);
    }
    assert_eq!(found["inputs"]["true_textures"], true);
    assert_eq!(found["classes"][0]["name"], Value::Null);
    assert_eq!(found["warnings"], serde_json::json!([]));
    assert_eq!(capture.outputs(), [""; 0], "a dry run writes nothing");

    capture.edit(|document| document["classes"] = "nyu40".into());
    let said = succeed(&["inspect".as_ref(), capture.path().as_os_str()]);
    assert!(said.out.contains("wall ") && said.out.contains("floor ") && said.out.contains("unknown "), "{}", said.out);
}

#[test]
fn fit_render_eval_and_report_on_the_cpu() {
    let capture = Capture::new();
    let out = capture.out("out");
    let said = succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--json"]));
    assert_eq!(names(&out), sorted(FILES.to_vec()));
    assert_eq!(capture.outputs(), ["out"], "no staging folder stays");
    assert_metrics(&json(&said.out));
    assert_metrics(&json(&std::fs::read_to_string(out.join("metrics.json")).unwrap()));
    assert_textures(&out);
    assert_scene(&out.join("scene.glb"));
    assert_log_and_settings(&out);
    assert_self_contained(&out.join("report.html"));
    assert_readable(&out);

    render(&capture, &out);
    let arguments = ["eval".as_ref(), out.as_os_str(), "--spp".as_ref(), "256".as_ref(), "--json".as_ref()];
    let said = succeed(&[&arguments[..], &["--backend".as_ref(), "cpu".as_ref()]].concat());
    assert_metrics(&json(&said.out));
    assert_eq!(json(&said.out)["samples"], 256);
    assert!(!said.err.contains("--spp is"), "{}", said.err);
    std::fs::remove_file(out.join("report.html")).unwrap();
    let said = succeed(&["report".as_ref(), out.as_os_str(), "--spp".as_ref(), "8".as_ref(), "-q".as_ref()]);
    said.complains(&["--spp is 8", "96 rays per pixel"]);
    assert!(said.out.contains("report.html") && said.out.contains("Novel views"), "{}", said.out);
    assert_self_contained(&out.join("report.html"));
}

#[test]
fn edited_textures_are_exported() {
    let capture = Capture::new();
    let out = capture.out("out");
    succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--no-eval", "--quiet"]));
    let scene = std::fs::read(out.join("scene.glb")).unwrap();
    let other = capture.out("other.glb");
    let export = ["export".as_ref(), out.as_os_str(), "-o".as_ref(), other.as_os_str()];
    assert!(succeed(&export).out.contains("other.glb"));
    assert!(std::fs::read(&other).unwrap() == scene, "nothing was edited");
    let red = read_rgb(out.join("albedo.exr")).unwrap().map(|_| [0.8, 0.1, 0.1]);
    write_rgb(out.join("albedo.exr"), &red).unwrap();
    succeed(&["export".as_ref(), out.as_os_str()]);
    let edited = std::fs::read(out.join("scene.glb")).unwrap();
    assert!(edited != scene);
    assert_scene(&out.join("scene.glb"));
    run(&["export".as_ref(), out.as_os_str(), "-o".as_ref(), out.join("albedo.exr").as_os_str()]).complains(&[".glb"]);
    assert!(read_rgb(out.join("albedo.exr")).unwrap() == red, "not replaced");
}

#[test]
fn a_fit_of_a_mesh_that_its_capture_lacks_is_evaluated_later() {
    let capture = Capture::new();
    let (out, mesh) = (capture.out("out"), capture.out("elsewhere.obj"));
    std::fs::rename(capture.file("mesh.obj"), &mesh).unwrap();
    let with_mesh = ["--mesh", mesh.to_str().unwrap(), "--backend", "cpu", "--no-eval", "--quiet"];
    succeed(&fit(&capture.path(), &out, &with_mesh));
    succeed(&["eval".as_ref(), out.as_os_str(), "--backend".as_ref(), "cpu".as_ref(), "--quiet".as_ref()]);
    assert!(out.join("metrics.json").is_file());
}

#[test]
fn textures_are_evaluated_through_another_mesh_of_their_atlas() {
    let capture = Capture::new();
    let out = capture.out("out");
    succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--no-eval", "--quiet"]));
    let text = std::fs::read_to_string(out.join("mesh.obj")).unwrap();
    let other = capture.out("other.obj");
    let through = [&out, &other].map(|path| path.as_os_str());
    let evaluate = [
        "eval".as_ref(),
        through[0],
        "--mesh".as_ref(),
        through[1],
        "--json".as_ref(),
        "--backend".as_ref(),
        "cpu".as_ref(),
    ];
    let moved = |line: &str, prefix: &str, by: f32| match line.strip_prefix(prefix) {
        Some(numbers) => {
            let numbers = numbers.split_whitespace().map(|n| (n.parse::<f32>().unwrap() + by).to_string());
            format!("{prefix}{}\n", numbers.collect::<Vec<_>>().join(" "))
        }
        None => format!("{line}\n"),
    };
    let edited = |prefix: &str, by: f32| text.lines().map(|line| moved(line, prefix, by)).collect::<String>();
    let albedo = |said: &str| json(said).pointer("/result/train/albedo/per_image/psnr").unwrap().as_f64().unwrap();

    std::fs::write(&other, &text).unwrap();
    let same = albedo(&succeed(&evaluate).out);
    std::fs::write(&other, edited("v ", 0.3)).unwrap();
    let off = albedo(&succeed(&evaluate).out);
    assert!(off < same - 1.0, "{off} through a mesh half a metre away, {same} through the fit's own");
    assert!(!out.join("metrics.json").exists(), "figures through another mesh are not those of the fit");

    std::fs::write(&other, edited("vt ", 0.01)).unwrap();
    run(&evaluate).complains(&["other.obj", "triangle 0", "in the atlas"]);
    let fewer = text.lines().rev().skip(1).map(|line| format!("{line}\n")).collect::<Vec<_>>();
    std::fs::write(&other, fewer.into_iter().rev().collect::<String>()).unwrap();
    run(&evaluate).complains(&["other.obj", "triangles, not"]);
}

#[test]
fn what_a_fit_corrects_is_corrected_when_it_is_evaluated() {
    let capture = Capture::new();
    let out = capture.out("out");
    let dim = capture.file("hdr/b.exr");
    let image = read_rgb(&dim).unwrap().map(|rgb| rgb.map(|l| 0.4 * l));
    write_rgb(&dim, &image).unwrap();
    let fitted = succeed(&fit(&capture.path(), &out, &["--backend", "cpu", "--json", "--solve-exposure", "--sharpen"]));
    fitted.complains(&["--sharpen: too few textured surfaces"]);
    let stored = json(&std::fs::read_to_string(out.join("corrections.json")).unwrap());
    let scale = |view: &str| stored[view]["scale"][0].as_f64().unwrap();
    assert!((scale("b") / scale("a") - 2.5).abs() < 0.2, "{stored}");
    assert!(stored.get("novel").is_none() && stored["a"]["transform_matrix"][3][3] == 1.0, "{stored}");
    assert_eq!(stored["b"]["blur"], 0.0, "nothing is undone that is not known");
    let psnr = |text: &str| json(text).pointer("/result/train/image/psnr").unwrap().as_f64().unwrap();
    let evaluate = ["eval".as_ref(), out.as_os_str(), "--json".as_ref(), "--backend".as_ref(), "cpu".as_ref()];
    let evaluated = psnr(&succeed(&evaluate).out);
    assert!((evaluated - psnr(&fitted.out)).abs() < 0.02, "{evaluated} is not {}", psnr(&fitted.out));
    // Negative control: the dim view compared as it is.
    std::fs::remove_file(out.join("corrections.json")).unwrap();
    let uncorrected = psnr(&succeed(&evaluate).out);
    assert!(uncorrected < evaluated - 1.0, "{uncorrected} and {evaluated}");
    // What somebody wrote there by hand is checked.
    std::fs::write(out.join("corrections.json"), r#"{"b": {"scale": [1, 0, 1], "transform_matrix": []}}"#).unwrap();
    run(&evaluate).complains(&["corrections.json", "view \"b\"", "scale [1.0, 0.0, 1.0]", "positive"]);
    let blurred = r#"{"b": {"scale": [1, 1, 1], "blur": 7, "transform_matrix": []}}"#;
    std::fs::write(out.join("corrections.json"), blurred).unwrap();
    run(&evaluate).complains(&["corrections.json", "view \"b\"", "blur 7", "square pixels"]);
}

#[test]
fn views_that_are_exposed_alike_stay_as_they_are() {
    let capture = Capture::new();
    let built = |name: &str, more: &[&str]| {
        let to = capture.out(name);
        let arguments: Vec<OsString> =
            ["tbl".into(), capture.path().into(), "-o".into(), to.clone().into(), "--backend".into(), "cpu".into()]
                .into_iter()
                .chain(more.iter().map(OsString::from))
                .collect();
        let said = succeed(&arguments);
        (std::fs::read(to).unwrap(), said.err)
    };
    let (plain, _) = built("plain.exr", &[]);
    let (solved, said) = built("solved.exr", &["--solve-exposure"]);
    assert!(said.contains("stay as they are") && !said.contains("radiance ×"), "{said}");
    assert!(solved == plain, "the HDR texture changed");
    // Negative control.
    let dim = capture.file("hdr/b.exr");
    write_rgb(&dim, &read_rgb(&dim).unwrap().map(|rgb| rgb.map(|l| 0.95 * l))).unwrap();
    let (_, said) = built("unequal.exr", &["--solve-exposure"]);
    assert!(said.contains("b  radiance × 1.05") && !said.contains("stay as they are"), "{said}");
}

#[test]
fn an_ablation_compares_every_variant_and_keeps_what_is_done() {
    let capture = Capture::new();
    let out = capture.out("ablation");
    let arguments = quickly("ablate", &capture.path(), &out, &["--backend", "cpu", "--json"]);
    let said = json(&succeed(&arguments).out);
    let names: Vec<&str> = said.as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect();
    let expected = ["joint", "without-stage-1", "without-stage-2", "without-stage-3", "source-tbl", "paper", "full"];
    assert_eq!(names, expected);
    let roughness = |i: usize| said[i]["evaluation"]["result"]["train"]["roughness"]["psnr"].as_f64().unwrap();
    assert!((0..7).all(|i| roughness(i) > 0.0), "{said}");
    assert!(roughness(2) != roughness(5) && roughness(4) != roughness(5), "{said}");
    let page = std::fs::read_to_string(out.join("ablation.html")).unwrap();
    assert!(expected.iter().all(|name| page.contains(&format!("<h3>{name}</h3>"))));
    assert!(out.join("full/confidence.exr").is_file() && !out.join("paper/confidence.exr").exists());
    assert!(std::fs::read_to_string(out.join("full/materials.json")).unwrap().contains("diffuse"));

    let written = |name: &str| std::fs::metadata(out.join(name)).unwrap().modified().unwrap();
    let before = written("paper/albedo.exr");
    std::fs::remove_file(out.join("full/metrics.json")).unwrap();
    assert_eq!(json(&succeed(&arguments).out), said, "what is missing is made anew, alike");
    assert_eq!(written("paper/albedo.exr"), before, "what is there stays");
    let paper = out.join("paper");
    succeed(&[
        "eval".as_ref(),
        paper.as_os_str(),
        "--spp".as_ref(),
        "96".as_ref(),
        "--backend".as_ref(),
        "cpu".as_ref(),
    ]);
    assert_eq!(json(&succeed(&arguments).out), said, "what was evaluated with other rays is evaluated again");
    assert_eq!(written("paper/albedo.exr"), before, "and not fitted");
    let image = capture.file("hdr/a.exr");
    std::fs::write(&image, std::fs::read(&image).unwrap()).unwrap();
    succeed(&arguments);
    let again = written("paper/albedo.exr");
    assert_ne!(again, before, "unless a file of the capture was written since");
    let other = Capture::new();
    succeed(&quickly("ablate", &other.path(), &out, &["--backend", "cpu", "--json"]));
    assert_ne!(written("paper/albedo.exr"), again, "unless it is of another capture");
}

fn assert_textures(out: &Path) {
    for name in ["albedo.exr", "irradiance.exr", "hdr_texture.exr", "emission.exr"] {
        assert_light(&out.join(name), [ATLAS, ATLAS]);
    }
    let roughness = read_gray(out.join("roughness.exr")).unwrap();
    assert_eq!(roughness.size(), [ATLAS, ATLAS]);
    assert!(roughness.data.iter().all(|r| (0.0..=1.0).contains(r)));
    let coverage = read_labels(out.join("hdr_texture_mask.png")).unwrap();
    assert!([0, 255].iter().all(|level| coverage.data.contains(level)), "texels seen, and texels outside the charts");
}

/// The GLB in a loader that is not ours: three textures of the atlas' size, and a lamp.
fn assert_scene(path: &Path) {
    let (document, buffers, images) = gltf::import(path).unwrap();
    assert!(document.extensions_used().any(|e| e == "KHR_materials_emissive_strength"));
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    let reader = primitive.reader(|buffer| Some(&buffers[buffer.index()].0));
    assert_eq!(reader.read_indices().unwrap().into_u32().count(), 24 * 3);
    assert!(reader.read_tex_coords(0).is_some() && reader.read_tex_coords(1).is_some());
    let material = primitive.material();
    let pbr = material.pbr_metallic_roughness();
    assert_eq!((pbr.metallic_factor(), pbr.roughness_factor()), (0.0, 1.0));
    assert!(material.emissive_strength().unwrap() > 1.0);
    for (what, texture) in [
        ("base colour", pbr.base_color_texture()),
        ("metallic-roughness", pbr.metallic_roughness_texture()),
        ("emission", material.emissive_texture()),
    ] {
        let image = &images[texture.unwrap().texture().source().index()];
        assert_eq!((image.width, image.height), (ATLAS as u32, ATLAS as u32), "{what}");
        assert!(image.pixels.iter().any(|byte| *byte > 0), "{what} is black");
    }
}

/// Two epochs of each stage in the log, and settings from which the same fit can be run again.
fn assert_log_and_settings(out: &Path) {
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    let stages: Vec<Value> = log.lines().map(|line| json(line)["stage"].clone()).collect();
    assert_eq!(stages, ["I", "I", "II", "II", "III", "III"]);
    let settings: toml::Table = std::fs::read_to_string(out.join("settings.toml")).unwrap().parse().unwrap();
    assert_eq!(settings["fit"]["atlas_size"].as_integer(), Some(ATLAS as i64));
    assert_eq!(settings["fit"]["paper"]["optimiser"]["epochs"].as_integer(), Some(2));
}

/// One page that loads nothing.
fn assert_self_contained(path: &Path) {
    let page = std::fs::read_to_string(path).unwrap();
    // The namespace of SVG is a name, which no browser fetches.
    let page = page.replace("http://www.w3.org/", "");
    for external in ["http://", "https://", "src=\"//", "@import", "<link"] {
        assert!(!page.contains(external), "{external} in the report");
    }
    assert!(page.contains("data:image/png;base64,") && page.contains("<svg"));
    for name in VIEWS {
        assert!(page.contains(name), "view {name} is not in the report");
    }
}

/// Outputs are as readable as any new file.
fn assert_readable(out: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let ordinary = out.with_file_name("ordinary");
        std::fs::write(&ordinary, "").unwrap();
        for name in FILES {
            assert_eq!(mode(&out.join(name)), mode(&ordinary), "{name}");
        }
        std::fs::remove_file(ordinary).unwrap();
    }
}

fn render(capture: &Capture, out: &Path) {
    let folder = capture.out("renders");
    let cameras = capture.file("transforms.json");
    succeed(&[
        "render".as_ref(),
        out.as_os_str(),
        "--cameras".as_ref(),
        cameras.as_os_str(),
        "-o".as_ref(),
        folder.as_os_str(),
        "--spp".as_ref(),
        "4".as_ref(),
        "--backend".as_ref(),
        "cpu".as_ref(),
    ]);
    for name in VIEWS {
        assert_light(&folder.join(format!("{name}.exr")), [WIDTH, HEIGHT]);
        assert!(folder.join(format!("{name}.png")).is_file());
    }
    assert_eq!(names(&folder).len(), 2 * VIEWS.len());
}

/// The medians of a map over the middles of the room's charts but the lamp's, and what is true there.
fn by_chart(map: &Rgb, truth: &Rgb) -> Vec<[[f32; 3]; 2]> {
    let side = ATLAS / 4;
    let of = |chart: usize| {
        [map, truth].map(|map| {
            let at = |k: usize| *map.at(chart % 4 * side + 5 + k % 6, chart / 4 * side + 5 + k / 6);
            let texels: Vec<[f32; 3]> = (0..36).map(at).collect();
            std::array::from_fn(|c| {
                let mut channel: Vec<f32> = texels.iter().map(|v| v[c]).collect();
                channel.sort_by(f32::total_cmp);
                channel[18]
            })
        })
    };
    (0..11).map(of).collect()
}

#[test]
fn a_fit_finds_what_the_room_is_made_of() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out"));
    let quick = ["--set", "fit.atlas_size=64", "--set", "fit.irradiance_samples=256", "--no-eval"];
    let paths = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str()];
    succeed(&[&paths[..], &quick.map(AsRef::as_ref)].concat());
    let albedo =
        by_chart(&read_rgb(out.join("albedo.exr")).unwrap(), &read_rgb(capture.file("albedo_tex.exr")).unwrap());
    let rough = |path: &Path| read_gray(path).unwrap().map(|r| [*r; 3]);
    let roughness = by_chart(&rough(&out.join("roughness.exr")), &rough(&capture.file("roughness_tex.exr")));
    for (chart, [found, truth]) in albedo.into_iter().enumerate() {
        let close = (0..3).all(|c| (found[c] / truth[c] - 1.0).abs() < 0.15);
        assert!(close, "albedo of chart {chart} is {found:?}; its paint is {truth:?}");
    }
    // The box, from chart 6 on, shows too little to tell.
    for (chart, [[found, ..], [truth, ..]]) in roughness.into_iter().enumerate().take(6) {
        assert!((found - truth).abs() < 0.06, "roughness of chart {chart} is {found}; it was painted with {truth}");
    }
}

#[test]
fn paper_mode_goes_down() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out"));
    let how = [
        "--mode",
        "paper",
        "--no-eval",
        "--set",
        "fit.atlas_size=64",
        "--set",
        "fit.irradiance_samples=256",
        "--set",
        "fit.paper.specular_samples=32",
        "--set",
        "fit.paper.optimiser.epochs=40",
    ];
    let paths = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str()];
    succeed(&[&paths[..], &how.map(AsRef::as_ref)].concat());
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    // Each stage goes down, by less than this at least, and takes the roughness of what shows highlights where it is.
    for (stage, share) in [("I", 0.85), ("II", 0.75), ("III", 0.5)] {
        let losses: Vec<f64> = log
            .lines()
            .map(json)
            .filter(|epoch| epoch["stage"] == stage)
            .map(|epoch| epoch["loss"].as_f64().unwrap())
            .collect();
        let [first, last] = [losses[0], losses[losses.len() - 1]];
        assert!(losses.len() == 40 && last < share * first, "stage {stage} goes from {first} to {last}");
    }
    let albedo =
        by_chart(&read_rgb(out.join("albedo.exr")).unwrap(), &read_rgb(capture.file("albedo_tex.exr")).unwrap());
    let rough = |path: &Path| read_gray(path).unwrap().map(|r| [*r; 3]);
    let roughness = by_chart(&rough(&out.join("roughness.exr")), &rough(&capture.file("roughness_tex.exr")));
    // The floor's. Of walls without highlights the paper's stages know nothing.
    let ([found, truth], [[r, ..], [painted, ..]]) = (albedo[0], roughness[0]);
    assert!((0..3).all(|c| (found[c] / truth[c] - 1.0).abs() < 0.15), "albedo of the floor is {found:?} for {truth:?}");
    assert!((r - painted).abs() < 0.08, "roughness of the floor is {r} for {painted}");
}

#[test]
fn tbl_and_bake_of_a_capture_and_of_a_mesh_agree_on_both_backends() {
    let capture = Capture::new();
    let (texture, mesh) = (capture.out("light.exr"), capture.file("mesh.obj"));
    let input = capture.path();
    succeed(&["tbl".as_ref(), input.as_os_str(), "-o".as_ref(), texture.as_os_str(), "--size".as_ref(), "64".as_ref()]);
    assert_light(&texture, [ATLAS, ATLAS]);
    assert!(capture.out("light_mask.png").is_file());

    let mut maps: Vec<Rgb> = Vec::new();
    for (input, backend) in [(&input, "cpu"), (&mesh, "cpu"), (&mesh, "gpu")] {
        let output = capture.out("irradiance.exr");
        let with = ["--tbl".as_ref(), texture.as_os_str(), "-o".as_ref(), output.as_os_str()];
        let how = ["--spp", "32", "--size", "32", "--no-denoise", "--backend", backend].map(AsRef::as_ref);
        succeed(&[&["bake".as_ref(), input.as_os_str()], &with[..], &how[..]].concat());
        assert_light(&output, [32, 32]);
        maps.push(read_rgb(&output).unwrap());
        std::fs::remove_file(output).unwrap();
    }
    assert_eq!(maps[0], maps[1], "a mesh with a texture is what a capture with it is");
    let close = |(a, b): (&[f32; 3], &[f32; 3])| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-3 * a.max(1e-3));
    let agreeing = maps[1].data.iter().zip(&maps[2].data).filter(|&texels| close(texels)).count();
    // Traversals differ by rounding: few rays pass a corner on the other side, but one is seen in a texel of 32.
    assert!(agreeing * 100 >= 98 * maps[1].data.len(), "{agreeing} of {} texels agree", maps[1].data.len());

    let clean = capture.out("clean.exr");
    let how = ["--spp", "32", "--size", "32", "--backend", "cpu", "--fill-buried", "-o"].map(AsRef::as_ref);
    let from = ["bake".as_ref(), mesh.as_os_str(), "--tbl".as_ref(), texture.as_os_str()];
    succeed(&[&from[..], &how[..], &[clean.as_os_str()]].concat());
    let clean = read_rgb(&clean).unwrap();
    let total = |map: &Rgb| map.data.iter().map(|e| e[1]).sum::<f32>();
    assert_ne!(clean, maps[1], "denoising changes texels");
    assert!((total(&clean) / total(&maps[1]) - 1.0).abs() < 0.03, "{} of {}", total(&clean), total(&maps[1]));
}

#[test]
fn a_bake_to_an_error_says_what_is_left_of_it() {
    let capture = Capture::new();
    let (input, output) = (capture.path(), capture.out("light.exr"));
    let bake = |spp: &str, error: &str| {
        let from = ["bake".as_ref(), input.as_os_str(), "-o".as_ref()];
        let how = ["--size", "32", "--backend", "cpu", "--error-map", "--json", "--spp", spp, "--error", error]
            .map(AsRef::as_ref);
        let summary = json(&succeed(&[&from[..], &[output.as_os_str()], &how[..]].concat()).out);
        let texels = summary["texels"].as_f64().unwrap();
        (
            summary["rays"].as_f64().unwrap() / texels,
            read_rgb(&output).unwrap(),
            read_gray(capture.out("light_error.exr")).unwrap(),
        )
    };
    let (few, map, errors) = bake("1024", "0.2");
    assert!((64.0..512.0).contains(&few), "{few} rays per texel");
    assert_eq!((map.size(), errors.size()), ([32, 32], [32, 32]));
    assert!(errors.data.iter().all(|e| e.is_finite() && *e >= 0.0) && errors.data.iter().any(|e| *e > 0.0));
    let (most, _, smaller) = bake("256", "0.0001");
    assert_eq!(most, 256.0);
    let total = |errors: &Gray| errors.data.iter().sum::<f32>();
    assert!(total(&smaller) < total(&errors), "{} and {}", total(&smaller), total(&errors));
}

#[test]
fn a_fit_on_the_gpu_takes_its_settings_from_a_file() {
    let capture = Capture::new();
    let (config, out, input) = (capture.out("quick.toml"), capture.out("out"), capture.path());
    std::fs::write(
        &config,
        "backend = \"gpu\"\n[fit]\nmode = \"paper\"\natlas_size = 64\nirradiance_samples = 32\n\
         [fit.paper]\nspecular_samples = 4\n[fit.paper.optimiser]\nepochs = 1\n[fit.paper.stage_two]\nenabled = false\n",
    )
    .unwrap();
    let arguments = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str(), "--no-eval".as_ref()];
    succeed(&[&arguments[..], &["--config".as_ref(), config.as_os_str()]].concat());
    let left_out = ["metrics.json", "report.html"];
    let expected: Vec<&str> = FILES.into_iter().filter(|name| !left_out.contains(name)).collect();
    assert_eq!(names(&out), sorted(expected));
    assert_textures(&out);
    assert_scene(&out.join("scene.glb"));
    let log = std::fs::read_to_string(out.join("log.jsonl")).unwrap();
    assert_eq!(log.lines().map(|line| json(line)["stage"].clone()).collect::<Vec<_>>(), ["I", "III"]);
}

#[test]
fn full_mode_is_the_default_and_its_backends_agree() {
    let capture = Capture::new();
    let input = capture.path();
    let maps = ["cpu", "gpu"].map(|backend| {
        let out = capture.out(backend);
        let quick =
            ["--set", "fit.atlas_size=64", "--set", "fit.irradiance_samples=64", "--no-eval", "--backend", backend];
        let paths = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str()];
        succeed(&[&paths[..], &quick.map(AsRef::as_ref)].concat());
        assert_textures(&out);
        let settings: toml::Table = std::fs::read_to_string(out.join("settings.toml")).unwrap().parse().unwrap();
        assert_eq!(settings["fit"]["mode"].as_str(), Some("full"));
        ["albedo.exr", "roughness.exr"].map(|name| texir_core::image_io::read_rgb(out.join(name)).unwrap().data)
    });
    for (cpu, gpu) in maps[0].iter().zip(&maps[1]) {
        let close = |(a, b): &(&[f32; 3], &[f32; 3])| (0..3).all(|c| (a[c] - b[c]).abs() < 0.05);
        let agreeing = cpu.iter().zip(gpu).filter(close).count();
        assert!(agreeing * 100 >= 95 * cpu.len(), "{agreeing} of {} texels agree", cpu.len());
    }
}

#[test]
fn no_metal_is_found_where_there_is_none() {
    let capture = Capture::new();
    let (input, out) = (capture.path(), capture.out("out"));
    let quick = ["--metallic", "--set", "fit.atlas_size=64", "--set", "fit.irradiance_samples=64", "--no-eval"];
    let paths = ["fit".as_ref(), input.as_os_str(), "-o".as_ref(), out.as_os_str()];
    succeed(&[&paths[..], &quick.map(AsRef::as_ref)].concat());
    let metallic = texir_core::image_io::read_gray(out.join("metallic.exr")).unwrap();
    assert_eq!(metallic.size(), [64, 64]);
    assert!(metallic.data.iter().all(|&m| m == 0.0));
}

#[test]
fn the_seed_decides_the_result() {
    let capture = Capture::new();
    let input = capture.path();
    let albedo = |name: &str, seed: &str| {
        let out = capture.out(name);
        succeed(&fit(&input, &out, &["--backend", "cpu", "--no-eval", "--seed", seed]));
        std::fs::read(out.join("albedo.exr")).unwrap()
    };
    let first = albedo("first", "7");
    assert!(first == albedo("again", "7"), "the same seed gives the same bytes");
    assert!(first != albedo("other", "8"), "another seed gives other samples");
}

#[test]
fn a_bake_within_a_budget_has_the_bits_of_one_without() {
    let capture = Capture::new();
    let (input, texture, mesh) = (capture.path(), capture.out("light.exr"), capture.file("mesh.obj"));
    succeed(&["tbl".as_ref(), input.as_os_str(), "-o".as_ref(), texture.as_os_str(), "--size".as_ref(), "64".as_ref()]);
    let bake = |output: &Path, more: &[&str]| {
        let from = ["bake".as_ref(), mesh.as_os_str(), "--tbl".as_ref(), texture.as_os_str()];
        // More texels than the budget allows at a time.
        let how = ["--size", "768", "--spp", "4", "--error-map", "--fill-buried", "--backend", "cpu", "-o"];
        let more: Vec<_> = more.iter().map(AsRef::as_ref).collect();
        run(&[&from[..], &how.map(AsRef::as_ref), &[output.as_os_str()], &more].concat())
    };
    for name in ["map.exr", "map.hdr", "map.ktx2"] {
        let [whole, parts] = ["whole", "parts"].map(|folder| capture.out(folder).join(name));
        assert_eq!(bake(&whole, &[]).code, Some(0));
        let said = bake(&parts, &["--max-memory", "105MiB"]);
        assert_eq!(said.code, Some(0), "{said:#?}");
        assert!(std::fs::read(&whole).unwrap() == std::fs::read(&parts).unwrap(), "{name} differs");
        let errors = [whole, parts].map(|map| std::fs::read(map.with_file_name("map_error.exr")).unwrap());
        assert!(errors[0] == errors[1], "errors of {name} differ");
    }
    let left = std::fs::read_dir(capture.out("parts")).unwrap().map(|entry| entry.unwrap().file_name());
    assert!(left.into_iter().all(|name| !name.to_string_lossy().contains("partial")), "scratch files are gone");

    let refused = bake(&capture.out("small.exr"), &["--max-memory", "20MiB"]);
    assert_eq!(refused.code, Some(1), "{refused:#?}");
    refused.complains(&["limit of memory is 20.0 MiB", "needs about", "raise it"]);
    assert!(!capture.out("small.exr").exists() && !capture.out("small.exr.partial").exists());
}
