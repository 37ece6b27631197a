//! Every format against the same two-triangle square, and every kind of bad mesh.

mod polygons;

use std::path::PathBuf;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use tempfile::TempDir;

use super::*;

/// The unit square in z = 2, its atlas over [0, ½]², v down.
fn square() -> Mesh {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    Mesh {
        positions: corners.map(|(x, y)| Vec3::new(x, y, 2.0)).to_vec(),
        normals: vec![Vec3::Z; 4],
        uvs: corners.map(|(x, y)| Vec2::new(x, 1.0 - y) / 2.0).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

fn file(folder: &TempDir, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    path
}

fn read_text(name: &str, content: impl AsRef<[u8]>) -> Result<MeshFile> {
    let folder = tempfile::tempdir().unwrap();
    read_mesh(file(&folder, name, content))
}

fn message(result: Result<MeshFile>) -> String {
    result.unwrap_err().to_string()
}

/// The corners of all triangles: what must agree however vertices are shared.
fn soup(mesh: &Mesh) -> Vec<[[f32; 8]; 3]> {
    let vertex = |i: u32| {
        let (p, n, uv) = (mesh.positions[i as usize], mesh.normals[i as usize], mesh.uvs[i as usize]);
        [p.x, p.y, p.z, n.x, n.y, n.z, uv.x, uv.y]
    };
    mesh.triangles.iter().map(|t| t.map(vertex)).collect()
}

const OBJ: &str = "
v 0 0 2\nv 1 0 2\nv 1 1 2\nv 0 1 2
vt 0 0.5\nvt 0.5 0.5\nvt 0.5 1\nvt 0 1
vn 0 0 1
";

#[test]
fn obj_polygons_objects_and_materials_become_one_mesh_with_v_down() {
    let MeshFile { mesh, warnings } = read_text("a.obj", format!("{OBJ}f 1/1/1 2/2/1 3/3/1 4/4/1\n")).unwrap();
    assert_eq!(soup(&mesh), soup(&square()));
    assert_eq!(mesh.positions.len(), 4, "corners with equal indices are one vertex");
    assert!(warnings.is_empty(), "{warnings:?}");

    for end in ["\n", "\r\n", ""] {
        let continued = format!("{OBJ}f 1/1/1 2/2/1 \\\r\n3/3/1 \\\n  4/4/1{end}");
        assert_eq!(soup(&read_text("a.obj", continued).unwrap().mesh), soup(&square()), "ended by {end:?}");
    }
    let error = message(read_text("a.obj", format!("{OBJ}f 1/1/1 2/2/1 \\\n3/3/9\n")));
    assert!(error.contains("line 12"), "{error}");

    let split =
        format!("mtllib none.mtl\n{OBJ}o a\nusemtl x\nf 1/1/1 2/2/1 3/3/1\no b\nusemtl y\nf 1/1/1 3/3/1 4/4/1\n");
    assert_eq!(soup(&read_text("a.obj", split).unwrap().mesh), soup(&square()));
}

#[test]
fn obj_names_and_comments_may_be_in_any_code_page() {
    let of = |first: &[u8]| {
        read_text("a.obj", [first, b"\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"].concat())
    };
    for first in [&b"# K\xfcche"[..], b"#\xe9t\xe9", b"o K\xfcche", b"usemtl Eiche_gr\xfcn", b"  g B\xf6den W\xe4nde"] {
        assert_eq!(of(first).unwrap().mesh.triangles, [[0, 1, 2]]);
    }
    // UTF-16.
    let error = message(of(b"\xff\xfev\0 \0"));
    assert!(error.contains("line 1: a line cannot be read as text"), "{error}");
}

#[test]
fn obj_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    obj::write(&path, &square()).unwrap();
    assert_eq!(read_mesh(&path).unwrap().mesh, square());
}

#[test]
fn missing_normals_are_flat_and_said_so() {
    let MeshFile { mesh, warnings } = read_text("a.obj", format!("{OBJ}f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")).unwrap();
    assert_eq!((soup(&mesh), warnings), (soup(&square()), vec![]));
    // Faces with normals keep them; one without is flat, in the same object as well.
    for object in ["", "o b\n"] {
        let half = format!("{OBJ}vn 1 0 0\no a\nf 1/1/2 2/2/2 3/3/2\n{object}f 1/1 3/3 4/4\nf 1/1/2 3/3/2 4/4/2\n");
        let MeshFile { mesh, warnings } = read_text("a.obj", half).unwrap();
        for (triangle, normal) in [(0, Vec3::X), (1, Vec3::Z), (2, Vec3::X)] {
            assert_eq!(mesh.corner_normals(triangle), [normal; 3]);
        }
        assert!(warnings.len() == 1 && warnings[0].contains("1 of 3"), "{warnings:?}");
    }
    // A corner is enough.
    let corner = format!("{OBJ}vn 1 0 0\nf 1/1/2 2/2/2 3/3/2\nf 1/1 3/3/2 4/4/2\n");
    let MeshFile { mesh, warnings } = read_text("a.obj", corner).unwrap();
    assert_eq!([0, 1].map(|t| mesh.corner_normals(t)), [[Vec3::X; 3], [Vec3::Z; 3]]);
    assert!(warnings.len() == 1 && warnings[0].contains("1 of 2"), "{warnings:?}");
}

#[test]
fn faces_without_texture_coordinates_have_no_texels_and_leave_the_others_theirs() {
    let some = format!("{OBJ}f 1/1/1 2/2/1 3/3/1\nf 1//1 3//1 4//1\nf 1/1/1 3/3/1 4/4/1\n");
    let MeshFile { mesh, warnings } = read_text("a.obj", some).unwrap();
    let square = square();
    let expected = [square.corner_uvs(0), [Vec2::ZERO; 3], square.corner_uvs(1)];
    assert_eq!([0, 1, 2].map(|t| mesh.corner_uvs(t)), expected);
    assert_eq!(mesh.normals, vec![Vec3::Z; mesh.positions.len()]);
    assert!(warnings.len() == 1 && warnings[0].contains("a.obj: 1 of 3 triangles have no texture"), "{warnings:?}");
    // A triangle with one place that is none must not span an area to the atlas's corner.
    let spoilt = format!("{OBJ}vt nan 0\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/5/1\n");
    let MeshFile { mesh, warnings } = read_text("a.obj", spoilt).unwrap();
    assert_eq!([0, 1].map(|t| mesh.corner_uvs(t)), [square.corner_uvs(0), [Vec2::ZERO; 3]]);
    assert_eq!([0, 1].map(|t| mesh.corners(t)), [0, 1].map(|t| square.corners(t)));
    assert!(warnings.len() == 1 && warnings[0].contains("1 of 2 triangles"), "{warnings:?}");
}

/// Of a fan of faces, one that lacks its normals costs a few vertices, not those of all others.
#[test]
fn faces_of_one_form_share_their_vertices() {
    let rim = |i: usize| (i as f32 / 50.0).sin_cos();
    let vertices: String = (0..100).map(rim).map(|(x, y)| format!("v {x} {y} 0\nvt {x} {y}\n")).collect();
    let fan = |flat: usize| -> String {
        let face = |i: usize| {
            let n = if i == flat { "" } else { "/1" };
            format!("f 1/1{n} {i}/{i}{n} {}/{}{n}\n", i + 1, i + 1)
        };
        (2..100).map(face).collect()
    };
    let vertices_of = |flat| {
        let text = format!("vn 0 0 1\n{vertices}{}", fan(flat));
        read_text("a.obj", text).unwrap().mesh.positions.len()
    };
    assert_eq!(vertices_of(0), 100);
    // The face has its own, and those on either side of it no longer share the hub.
    assert!((101..110).contains(&vertices_of(50)), "{}", vertices_of(50));
}

const PLY_VERTICES: &str = "0 0 2 0 0 1 0 0.5\n1 0 2 0 0 1 0.5 0.5\n1 1 2 0 0 1 0.5 1\n0 1 2 0 0 1 0 1\n";

fn ply_header(format: &str, s: &str, t: &str) -> String {
    let floats = ["x", "y", "z", "nx", "ny", "nz", s, t].map(|p| format!("property float {p}\n")).concat();
    format!(
        "ply\nformat {format} 1.0\ncomment made here\nelement vertex 4\n{floats}element edge 1\nproperty int a\n\
         element face 1\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

#[test]
fn ply_ascii_and_binary_with_every_name_of_texture_coordinates() {
    for (s, t) in [("s", "t"), ("u", "v"), ("texture_u", "texture_v")] {
        // Without a final newline, as some programs write it.
        let text = format!("{}{PLY_VERTICES}5\n0 4 0 1 2 3", ply_header("ascii", s, t));
        assert_eq!(soup(&read_text("a.ply", text).unwrap().mesh), soup(&square()), "{s} {t}");
    }
    let numbers = PLY_VERTICES.split_whitespace().map(|n| n.parse::<f32>().unwrap());
    for (format, little) in [("binary_little_endian", true), ("binary_big_endian", false)] {
        let int = |i: i32| if little { i.to_le_bytes() } else { i.to_be_bytes() };
        let mut bytes = ply_header(format, "s", "t").into_bytes();
        bytes.extend(numbers.clone().flat_map(|n| if little { n.to_le_bytes() } else { n.to_be_bytes() }));
        bytes.extend(int(5));
        bytes.extend([0, 4]);
        bytes.extend([0, 1, 2, 3].into_iter().flat_map(int));
        assert_eq!(soup(&read_text("a.ply", &bytes).unwrap().mesh), soup(&square()), "{format}");
        bytes.truncate(bytes.len() - 3);
        let error = message(read_text("cut.ply", bytes));
        assert!(error.contains("cut.ply") && error.contains("face"), "{error}");
    }
}

/// As scanners and other programs write them: with some properties, with others among them, and with coordinates in
/// faces alone.
#[test]
fn binary_ply_of_any_properties() {
    let square = square();
    for properties in [
        "x y z",
        "x y z red",
        "quality x y z",
        "x y z nx ny nz",
        "nx ny nz x y z red",
        "x y z s t",
        "s t x y z nx ny nz",
    ] {
        let names: Vec<&str> = properties.split(' ').collect();
        for per_corner in [false, true] {
            let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\n".to_vec();
            let kind = |name: &str| if name == "red" { "uchar" } else { "float" };
            bytes.extend(names.iter().flat_map(|n| format!("property {} {n}\n", kind(n)).into_bytes()));
            let corners = if per_corner { "property list uchar float texcoord\n" } else { "" };
            bytes.extend(
                format!("element face 1\nproperty list uchar int vertex_indices\n{corners}end_header\n").bytes(),
            );
            for line in PLY_VERTICES.lines() {
                let numbers: Vec<f32> = line.split(' ').map(|n| n.parse().unwrap()).collect();
                for name in &names {
                    match ["x", "y", "z", "nx", "ny", "nz", "s", "t"].iter().position(|known| known == name) {
                        Some(place) => bytes.extend(numbers[place].to_le_bytes()),
                        None if *name == "red" => bytes.push(200),
                        None => bytes.extend(9f32.to_le_bytes()),
                    }
                }
            }
            bytes.extend([4u8].into_iter().chain([0, 1, 2, 3].into_iter().flat_map(i32::to_le_bytes)));
            if per_corner {
                bytes.push(8);
                bytes.extend([0.0, 0.5, 0.5, 0.5, 0.5, 1.0, 0.0, 1.0f32].into_iter().flat_map(f32::to_le_bytes));
            }
            match read_text("a.ply", bytes) {
                Ok(read) => assert_eq!(soup(&read.mesh), soup(&square), "{properties}, per corner: {per_corner}"),
                // Without coordinates it is read as far as to know that, and to be unwrapped.
                Err(error) => {
                    assert!(error.to_string().contains("no texture coordinates"), "{properties}: {error}");
                    assert!(!per_corner && !names.contains(&"s"), "{properties}");
                }
            }
        }
    }
}

#[test]
fn ply_texture_coordinates_per_face_corner() {
    let text = |uvs: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
             element face 1\nproperty list uchar uint vertex_index\nproperty list uchar float texcoord\nend_header\n\
             0 0 2\n1 0 2\n1 1 2\n0 1 2\n4 0 1 2 3 {uvs}\n"
        )
    };
    let mesh = read_text("a.ply", text("8 0 0.5 0.5 0.5 0.5 1 0 1")).unwrap().mesh;
    assert_eq!(soup(&mesh), soup(&square()), "and flat normals");
    let error = message(read_text("a.ply", text("6 0 0.5 0.5 0.5 0.5 1")));
    assert!(error.contains("a.ply") && error.contains("face 0 has 6") && error.contains("expected 8"), "{error}");
}

/// The square as a glTF with its buffer beside it: two primitives and a point, under two nodes, the inner one mirrored
/// when asked. `tamper` may spoil the document.
fn read_gltf(mirrored: bool, tamper: impl FnOnce(&mut serde_json::Value)) -> Result<MeshFile> {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, x) = (square(), if mirrored { -1.0 } else { 1.0 });
    let floats = mesh.positions.iter().flat_map(|p| [p.x * x, p.y, p.z - 1.0]);
    let floats = floats.chain(mesh.normals.iter().flat_map(|n| n.to_array()));
    let floats = floats.chain(mesh.uvs.iter().flat_map(|uv| uv.to_array()));
    let order = if mirrored { [0, 2, 1] } else { [0, 1, 2] };
    let indices = mesh.triangles.iter().flat_map(|t| order.map(|corner| t[corner] as u16));
    let mut bytes: Vec<u8> = floats.flat_map(f32::to_le_bytes).collect();
    bytes.extend(indices.flat_map(u16::to_le_bytes));
    file(&folder, "a.bin", &bytes);
    let attributes = serde_json::json!({"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2});
    let accessor = |offset: usize, component: u32, count: u32, kind: &str| serde_json::json!({"bufferView": 0, "byteOffset": offset, "componentType": component, "count": count, "type": kind});
    let mut positions = accessor(0, 5126, 4, "VEC3");
    positions["min"] = serde_json::json!([-1, 0, 1]);
    positions["max"] = serde_json::json!([1, 1, 1]);
    let mut document = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"translation": [0.0, 0.0, 1.0], "children": [1]}, {"mesh": 0, "scale": [x, 1.0, 1.0]}],
        "meshes": [{"primitives": [
            {"attributes": attributes, "indices": 3, "mode": 4},
            {"attributes": attributes, "indices": 4},
            {"attributes": {"POSITION": 0}, "mode": 0}
        ]}],
        "buffers": [{"byteLength": bytes.len(), "uri": "a.bin"}],
        "bufferViews": [{"buffer": 0, "byteLength": bytes.len()}],
        "accessors": [
            positions,
            accessor(48, 5126, 4, "VEC3"),
            accessor(96, 5126, 4, "VEC2"),
            accessor(128, 5123, 3, "SCALAR"),
            accessor(134, 5123, 3, "SCALAR")
        ]
    });
    tamper(&mut document);
    read_mesh(file(&folder, "a.gltf", document.to_string()))
}

#[test]
fn gltf_primitives_are_joined_under_their_nodes_transforms() {
    for mirrored in [false, true] {
        let MeshFile { mesh, warnings } = read_gltf(mirrored, |_| {}).unwrap();
        // Per triangle the corners may start elsewhere: winding and values count.
        for t in 0..2 {
            assert_eq!(mesh.face_normal(t), Vec3::Z, "mirrored {mirrored}");
            let sorted = |mesh: &Mesh| {
                let mut corners = soup(mesh)[t as usize];
                corners.sort_by(|a, b| a.partial_cmp(b).unwrap());
                corners
            };
            assert_eq!(sorted(&mesh), sorted(&square()), "mirrored {mirrored}");
        }
        assert!(warnings[0].contains("Points"), "{warnings:?}");
    }
}

#[test]
fn gltf_rotations_of_any_length_turn_and_do_no_more() {
    let turned = |rotation: [f32; 4]| read_gltf(false, |document| document["nodes"][1]["rotation"] = rotation.into());
    // A quarter about z.
    let unit = turned([0.0, 0.0, 0.5f32.sqrt(), 0.5f32.sqrt()]).unwrap().mesh;
    let [longer, plain] = [turned([0.0, 0.0, 3.0, 3.0]), read_gltf(false, |_| {})].map(|read| read.unwrap().mesh);
    let same = |a: &Mesh, b: &Mesh| a.positions.iter().zip(&b.positions).all(|(a, b)| a.distance(*b) < 1e-6);
    assert!(same(&unit, &longer) && !same(&unit, &plain));
    let error = message(turned([0.0; 4]));
    assert!(error.contains("rotation of node 1 is [0.0, 0.0, 0.0, 0.0]; expected a quaternion"), "{error}");
}

/// The square's corners in another order, wound as OpenGL has it, and the triangles that come of them.
#[test]
fn strips_and_fans_are_wound_as_lists_are() {
    for mirrored in [false, true] {
        // (mode, corners, triangles): the last two repeat corners, to end one strip and begin another.
        for (mode, corners, count) in
            [(5, &[1u16, 2, 0, 3][..], 2), (6, &[0, 1, 2, 3], 2), (5, &[1, 2, 0, 0, 0, 2, 3], 2), (6, &[0, 1, 2], 1)]
        {
            let MeshFile { mesh, warnings } = read_gltf(mirrored, |document| {
                let corners: Vec<u16> = match (mirrored, mode) {
                    (false, _) => corners.to_vec(),
                    // In the node's own frame all is wound the other way.
                    (true, 6) => [&corners[..1], &corners[1..].iter().rev().copied().collect::<Vec<_>>()].concat(),
                    (true, _) => [&corners[..1], corners].concat(),
                };
                let bytes: Vec<u8> = corners.iter().flat_map(|i| i.to_le_bytes()).collect();
                let uri = format!("data:application/octet-stream;base64,{}", BASE64.encode(&bytes));
                let push = |list: &mut serde_json::Value, value| list.as_array_mut().unwrap().push(value);
                push(&mut document["buffers"], serde_json::json!({"byteLength": bytes.len(), "uri": uri}));
                push(&mut document["bufferViews"], serde_json::json!({"buffer": 1, "byteLength": bytes.len()}));
                let accessor = serde_json::json!(
                    {"bufferView": 1, "componentType": 5123, "count": corners.len(), "type": "SCALAR"}
                );
                push(&mut document["accessors"], accessor);
                let primitives = document["meshes"][0]["primitives"].as_array_mut().unwrap();
                primitives.truncate(1);
                (primitives[0]["mode"], primitives[0]["indices"]) = (mode.into(), 5.into());
            })
            .unwrap();
            assert!(warnings.is_empty(), "{warnings:?}");
            assert_eq!(mesh.triangles.len(), count, "mode {mode}, {corners:?}");
            assert!((0..count).all(|t| mesh.face_normal(t as u32) == Vec3::Z), "mode {mode}, {corners:?}, {mirrored}");
            let area: f32 = (0..count).map(|t| mesh.area(t as u32)).sum();
            assert_eq!(area, 0.5 * count as f32, "no triangle is there twice");
        }
    }
}

#[test]
fn what_gltf_says_in_vain_is_warned_about() {
    let MeshFile { mesh, warnings } = read_gltf(false, |document| {
        document["materials"] = serde_json::json!([{"alphaMode": "MASK"}, {"alphaMode": "OPAQUE"}]);
        document["meshes"][0]["primitives"][0]["targets"] = serde_json::json!([{"POSITION": 0}]);
        document["skins"] = serde_json::json!([{"joints": [0]}]);
        document["nodes"][1]["skin"] = 0.into();
    })
    .unwrap();
    assert_eq!(mesh.triangles.len(), 2);
    for part in ["1 materials are transparent", "1 primitives have morph targets", "1 nodes have a skin"] {
        assert!(warnings.iter().any(|w| w.contains("a.gltf") && w.contains(part)), "{part:?} is not in: {warnings:?}");
    }
    assert!(!read_gltf(false, |_| {}).unwrap().warnings.iter().any(|w| w.contains("skin") || w.contains("alphaMode")));
}

#[test]
fn gltf_values_that_are_all_zero_need_not_stand_in_the_file() {
    let zeros = |document: &mut serde_json::Value| {
        let accessors = document["accessors"].as_array_mut().unwrap();
        let zero = [0.0; 3];
        accessors
            .push(serde_json::json!({"componentType": 5126, "count": 4, "type": "VEC3", "min": zero, "max": zero}));
    };
    let read = read_gltf(false, |document| {
        zeros(document);
        document["meshes"][0]["primitives"][0]["targets"] = serde_json::json!([{"POSITION": 5}]);
    });
    let (MeshFile { mesh, warnings }, plain) = (read.unwrap(), read_gltf(false, |_| {}).unwrap().mesh);
    assert_eq!(mesh.positions, plain.positions);
    assert!(warnings.iter().any(|told| told.contains("morph targets")), "{warnings:?}");
    // A surface has none of it.
    let error = message(read_gltf(false, |document| {
        zeros(document);
        document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 5.into();
    }));
    assert!(error.contains("POSITION has no bufferView"), "{error}");
    // Other values are as necessary as ever.
    let error = message(read_gltf(false, |document| document["accessors"][1]["bufferView"] = 7.into()));
    assert!(error.contains("a.gltf") && error.contains("accessors[1].bufferView"), "{error}");
}

#[test]
fn damaged_gltf_is_an_error_that_says_where() {
    let spoil = |pointer: &'static str, value: serde_json::Value| {
        message(read_gltf(false, |document| *document.pointer_mut(pointer).unwrap() = value))
    };
    for (pointer, value, expected) in [
        ("/accessors/0/count", 4000.into(), "POSITION reaches beyond"),
        ("/accessors/0/componentType", 5123.into(), "POSITION is 4 × Vec3 of U16"),
        ("/accessors/3/count", 4000.into(), "indices reaches beyond"),
        ("/accessors/3/byteOffset", 8.into(), "uses vertex"),
        ("/nodes/1", serde_json::json!({"children": [0]}), "reached twice"),
        ("/buffers/0/uri", "not%20there.bin".into(), "buffers[0]: its file not there.bin cannot be read"),
        ("/buffers/0/uri", "%ff.bin".into(), "buffers[0]: uri \"%ff.bin\" is no text"),
        ("/buffers/0/uri", "data:;base64,!".into(), "buffers[0] cannot be read"),
        ("/buffers/0/byteLength", 4000.into(), "buffers[0], a.bin, has 140 bytes; expected 4000"),
    ] {
        let error = spoil(pointer, value);
        assert!(error.contains("a.gltf") && error.contains(expected), "{pointer}: {error}");
    }
    let error = message(read_text("a.glb", b"glTF\x02\0\0\0\x04\0\0\0"));
    assert!(error.contains("a.glb") && error.contains("damaged"), "{error}");
}

#[test]
fn a_mesh_without_texture_coordinates_is_told_to_unwrap() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
               element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let without_uvs = |document: &mut serde_json::Value| {
        for primitive in ["0", "1"] {
            let attributes = document.pointer_mut(&format!("/meshes/0/primitives/{primitive}/attributes")).unwrap();
            attributes.as_object_mut().unwrap().remove("TEXCOORD_0");
        }
    };
    for result in
        [read_text("a.obj", format!("{OBJ}f 1//1 2//1 3//1\n")), read_text("a.ply", ply), read_gltf(false, without_uvs)]
    {
        let error = message(result);
        assert!(error.contains("no texture coordinates") && error.contains("atlas"), "{error}");
    }
}

#[test]
fn degenerate_triangles_are_dropped_and_counted() {
    let text =
        format!("{OBJ}v 2 0 2\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 1/1/1 3/3/1\nf 1/1/1 2/2/1 5/3/1\nf 1/1/1 3/3/1 4/4/1\n");
    let MeshFile { mesh, warnings } = read_text("a.obj", text).unwrap();
    assert_eq!(soup(&mesh), soup(&square()));
    assert!(warnings[0].contains("a.obj") && warnings[0].contains("2 of 4"), "{warnings:?}");
    let error = message(read_text("a.obj", format!("{OBJ}f 1/1/1 1/1/1 3/3/1\n")));
    assert!(error.contains("all 1 triangles have no area"), "{error}");
}

#[test]
fn unusable_numbers_and_indices_are_errors_with_their_place() {
    for (from, to, expected) in [
        ("v 1 0 2", "v nan 0 2", "vertex 1 is at [NaN, 0, 2]"),
        ("vt 0.5 0.5", "vt inf 0.5", "has no texture coordinates, or none that are finite"),
        ("vn 0 0 1", "vn 0 0 x", "line 10: a `vn` line"),
        ("f 1/1/1", "f 1/1/x", "line 11: an `f` line"),
        ("f 1/1/1", "f 9/1/1", "line 11 names `v` 9, and lines 1 to 11 have 4 of them"),
        ("f 1/1/1", "f 1/9/1", "line 11 names `vt` 9"),
        ("f 1/1/1", "f 1/1/2", "line 11 names `vn` 2"),
        (
            "f 1/1/1",
            "o a\nf 1/1/1 2/2/1 3/3/1\nf 1/1/2 1/1/1 2/2/1\no b\nf 1/1/1",
            "line 13 names `vn` 2, and lines 1 to 14",
        ),
        ("f 1/1/1", "f -5/1/1", "line 11 names `v` -5, after 4 of them"),
        ("f 1/1/1", "f 1/0/1", "line 11 names `vt` 0"),
        ("f 1/1/1", "f 1/1/6148914691236517205", "line 11 names `vn` 6148914691236517205"),
        ("f 1/1/1", "f 1/1/-9223372036854775808", "line 11 names `vn` -9223372036854775808"),
    ] {
        let error = message(read_text("a.obj", format!("{OBJ}f 1/1/1 2/2/1 3/3/1\n").replacen(from, to, 1)));
        assert!(error.contains("a.obj") && error.contains(expected), "{to}: {error}");
    }
    let text = format!("{}{PLY_VERTICES}5\n0 3 0 1 4\n", ply_header("ascii", "s", "t"));
    let error = message(read_text("a.ply", text));
    assert!(error.contains("a.ply") && error.contains("[0, 1, 4]") && error.contains("below 4"), "{error}");
    for (name, content) in [("a.obj", ""), ("a.obj", "v 0 0 0\n"), ("a.ply", "ply\nformat ascii 1.0\nend_header\n")] {
        let error = message(read_text(name, content));
        assert!(error.contains(name) && error.contains("no triangles"), "{error}");
    }
    for name in ["a.stl", "a.ply", "a.glb"] {
        assert!(message(read_text(name, "junk")).contains(name));
        assert!(message(read_mesh(Path::new("none").join(name))).contains(name));
    }
}

#[test]
fn atlas_report_measures_cover_overlap_and_overhang() {
    let mesh = square();
    let report = atlas_report(&mesh, [64; 2]);
    assert_eq!(
        report,
        AtlasReport { covered_fraction: 0.25, overlapping_fraction: 0.0, outside_unit_square_triangles: 0 }
    );

    // A third triangle over half of the second.
    let mut overlapping = mesh.clone();
    overlapping.positions.extend([Vec3::ZERO, Vec3::X, Vec3::Y]);
    overlapping.normals.extend([Vec3::Z; 3]);
    overlapping.uvs.extend([mesh.uvs[0], mesh.uvs[2], (mesh.uvs[0] + mesh.uvs[3]) / 2.0]);
    overlapping.triangles.push([4, 5, 6]);
    let report = atlas_report(&overlapping, [256; 2]);
    assert!((report.overlapping_fraction - 0.25).abs() < 0.01, "{report:?}");

    let mut shifted = mesh;
    shifted.uvs[3].y -= 0.1;
    assert_eq!(atlas_report(&shifted, [64; 2]).outside_unit_square_triangles, 1);
}

#[test]
fn surfaces_that_share_the_atlas_many_times_over_are_told_at_once() {
    // As many squares as take minutes if all are gone through to the last texel; the last leaves the unit square.
    let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    let copies = 100_000;
    let mut mesh = Mesh {
        positions: square.map(|at| at.extend(0.0)).to_vec(),
        normals: vec![Vec3::Z; 4],
        uvs: square.to_vec(),
        triangles: [[0, 1, 2], [0, 2, 3]].repeat(copies),
    };
    mesh.positions.push(Vec3::ONE);
    mesh.normals.push(Vec3::Z);
    mesh.uvs.push(Vec2::new(2.0, 0.5));
    mesh.triangles.push([1, 4, 2]);
    let report = atlas_report(&mesh, [1024; 2]);
    assert_eq!((report.covered_fraction, report.outside_unit_square_triangles), (1.0, 1));
    assert!(report.overlapping_fraction > 0.99, "{report:?}");
}

#[test]
fn elements_of_a_ply_without_properties_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mesh.ply");
    let text = "ply\nformat ascii 1.0\nelement nothing 9000000000000\nelement vertex 1\nproperty float x\n\
                property float y\nproperty float z\nend_header\n0 0 0\n";
    std::fs::write(&path, text).unwrap();
    let error = read_mesh(&path).unwrap_err().to_string();
    assert!(error.contains("mesh.ply") && error.contains("\"nothing\" has no properties"), "{error}");
}
