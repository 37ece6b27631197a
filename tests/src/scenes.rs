//! Small scenes made in code.

use glam::{Mat4, Quat, Vec2, Vec3};
use texir_core::atlas::Atlas;
use texir_core::backend::Backend;
use texir_core::camera::{Camera, Projection};
use texir_core::lights::Lights;
use texir_core::mesh::Mesh;
use texir_core::raster::Rgb;

/// Columns and rows of charts in the atlas of [`Builder`].
const CHARTS: usize = 12;

/// Collects quads and triangles, each with a chart of its own.
#[derive(Debug, Default)]
pub struct Builder {
    mesh: Mesh,
    charts: usize,
}

impl Builder {
    fn chart(&mut self) -> impl Fn(f32, f32) -> Vec2 + use<> {
        assert!(self.charts < CHARTS * CHARTS, "the atlas is full");
        let corner = Vec2::new((self.charts % CHARTS) as f32, (self.charts / CHARTS) as f32);
        self.charts += 1;
        move |s, t| (corner + 0.08 + 0.84 * Vec2::new(s, t)) / CHARTS as f32
    }

    /// A quad; the corners run counter-clockwise seen from the side that `normals` point to.
    pub fn quad(&mut self, corners: [Vec3; 4], normals: [Vec3; 4]) {
        let base = self.mesh.positions.len() as u32;
        let chart = self.chart();
        self.mesh.positions.extend(corners);
        self.mesh.normals.extend(normals);
        self.mesh.uvs.extend([chart(0.0, 0.0), chart(1.0, 0.0), chart(1.0, 1.0), chart(0.0, 1.0)]);
        for triangle in [[base, base + 1, base + 2], [base, base + 2, base + 3]] {
            self.mesh.triangles.push(triangle);
            if self.mesh.face_normal(self.mesh.triangles.len() as u32 - 1) == Vec3::ZERO {
                // Two corners coincide, as at the poles of a sphere.
                self.mesh.triangles.pop();
            }
        }
    }

    /// An axis-aligned box, facing outwards or (a room) inwards.
    pub fn cuboid(&mut self, low: Vec3, high: Vec3, inwards: bool) {
        for axis in 0..3 {
            for far in [false, true] {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let corner = |s: f32, t: f32| {
                    let mut p = low;
                    p[axis] = if far { high[axis] } else { low[axis] };
                    p[u] = low[u] + s * (high[u] - low[u]);
                    p[v] = low[v] + t * (high[v] - low[v]);
                    p
                };
                let outwards = Vec3::AXES[axis] * if far { 1.0 } else { -1.0 };
                let normal = if inwards { -outwards } else { outwards };
                let mut corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
                if normal[axis] < 0.0 {
                    corners.reverse();
                }
                self.quad(corners, [normal; 4]);
            }
        }
    }

    /// A smooth-shaded sphere of 6 × 10 quads.
    pub fn sphere(&mut self, centre: Vec3, radius: f32) {
        const RINGS: usize = 6;
        const SEGMENTS: usize = 10;
        let at = |ring: usize, segment: usize| {
            let (theta, phi) = (
                std::f32::consts::PI * ring as f32 / RINGS as f32,
                std::f32::consts::TAU * (segment % SEGMENTS) as f32 / SEGMENTS as f32,
            );
            Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
        };
        for ring in 0..RINGS {
            for segment in 0..SEGMENTS {
                let normals =
                    [at(ring, segment), at(ring + 1, segment), at(ring + 1, segment + 1), at(ring, segment + 1)];
                self.quad(normals.map(|n| centre + radius * n), normals);
            }
        }
    }

    /// The mesh.
    pub fn finish(self) -> Mesh {
        self.mesh
    }
}

/// A closed 4 × 3 × 2.5 m room with three boxes and a sphere. No ray from inside leaves it.
pub fn furnished_room() -> Mesh {
    furnishings().finish()
}

/// The same surface by four times as many triangles, so many `times`.
pub fn subdivided(mesh: &Mesh, times: u32) -> Mesh {
    let mut mesh = mesh.clone();
    for _ in 0..times {
        let triangles = std::mem::take(&mut mesh.triangles);
        for [a, b, c] in triangles {
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[from, to]| {
                let (from, to) = (from as usize, to as usize);
                mesh.positions.push(0.5 * (mesh.positions[from] + mesh.positions[to]));
                mesh.normals.push((mesh.normals[from] + mesh.normals[to]).normalize());
                mesh.uvs.push(0.5 * (mesh.uvs[from] + mesh.uvs[to]));
                mesh.positions.len() as u32 - 1
            });
            mesh.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
    }
    mesh
}

/// [`furnished_room`] with flat normals, a lamp like a slanting strip below its ceiling, and a radiance atlas in which
/// that alone is bright. Its triangles' boxes are nearly empty, so that hierarchies keep them in several leaves each.
pub fn room_with_strip(size: usize) -> (Mesh, Rgb) {
    let mut b = furnishings();
    let (column, row) = (b.charts % CHARTS, b.charts / CHARTS);
    let (from, along, across) = (Vec3::new(0.3, 0.4, 1.9), Vec3::new(3.2, 2.3, 0.4), Vec3::new(-0.07, 0.1, 0.0));
    b.quad([from, from + across, from + across + along, from + along], [-Vec3::Z; 4]);
    let mut mesh = b.finish();
    mesh.flat_normals();
    let chart = size / CHARTS;
    let mut light = smooth_light(size).map(|l| l.map(|l| 0.05 * l));
    for y in row * chart..(row + 1) * chart {
        light.data[y * size + column * chart..][..chart].fill([9.0, 7.0, 4.0]);
    }
    (mesh, light)
}

fn furnishings() -> Builder {
    let mut b = Builder::default();
    b.cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 2.5), true);
    b.cuboid(Vec3::new(0.4, 0.3, 0.05), Vec3::new(1.1, 1.0, 0.8), false);
    b.cuboid(Vec3::new(2.6, 1.9, 0.05), Vec3::new(3.5, 2.6, 1.7), false);
    b.cuboid(Vec3::new(1.9, 0.2, 2.2), Vec3::new(2.5, 0.8, 2.4), false);
    b.sphere(Vec3::new(2.2, 1.4, 0.9), 0.45);
    b
}

/// Radiance that varies smoothly within each chart and by a factor of up to 8 between charts, so that sums are
/// sensitive to what is hit, and not to the last digit of where.
pub fn smooth_light(size: usize) -> Rgb {
    let mut light = Rgb::filled(size, size, [0.0; 3]);
    for y in 0..size {
        for x in 0..size {
            let (u, v) = ((x as f32 + 0.5) / size as f32, (y as f32 + 0.5) / size as f32);
            let chart = (v * CHARTS as f32) as u32 * CHARTS as u32 + (u * CHARTS as f32) as u32;
            let level = if texir_core::rng::hash(chart).is_multiple_of(7) { 4.0 } else { 0.5 };
            light.data[y * size + x] =
                [level * (1.0 + 0.3 * (7.0 * u).sin()), level * (0.8 + 0.2 * v), level * (0.5 + 0.4 * u * v)];
        }
    }
    light
}

/// The lights of a radiance atlas.
pub fn lights(backend: &mut dyn Backend, radiance: &Rgb) -> Lights {
    let atlas = Atlas::new(backend, radiance.size()).unwrap_or_else(|e| panic!("the scene has no texel map: {e}"));
    Lights::find(backend.scene(), &atlas, radiance).unwrap_or_else(|e| panic!("{e}"))
}

/// A panorama and a pinhole in [`furnished_room`], with poses that are not aligned to it.
pub fn cameras() -> [Camera; 2] {
    let pose = |x: f32, position: Vec3| {
        Mat4::from_rotation_translation(Quat::from_euler(glam::EulerRot::XYZ, 1.4, x, 0.1), position)
    };
    let pinhole = Projection::Pinhole { fx: 30.0, fy: 31.0, cx: 23.0, cy: 18.5 };
    [
        Camera {
            projection: Projection::Equirectangular,
            width: 64,
            height: 32,
            world_from_camera: pose(0.7, Vec3::new(1.5, 2.0, 1.6)),
        },
        Camera { projection: pinhole, width: 48, height: 36, world_from_camera: pose(-0.4, Vec3::new(3.3, 0.6, 1.1)) },
    ]
}
