//! Procedural materials: albedo, roughness and emission as functions of the place on a chart.

use glam::{Vec2, Vec3};

use super::PaintStyle;
use super::random::lattice;

/// Bounds of every ground-truth albedo: nothing real is black or perfectly white.
const ALBEDO: (f32, f32) = (0.03, 0.85);
/// Bounds of every ground-truth roughness.
const ROUGHNESS: (f32, f32) = (0.06, 0.95);

/// What is drawn on a surface. Lengths in metres.
#[derive(Clone, Copy, Debug)]
pub(super) enum Pattern {
    /// One colour.
    Flat,
    /// Boards along s, with gaps in between.
    Planks { width: f32, length: f32 },
    /// Square tiles; the accent is the grout.
    Tiles { size: f32 },
    /// Tiles in base and accent by turns.
    Checker { size: f32 },
    /// Wallpaper: upright stripes.
    Stripes { period: f32 },
    /// Plaster: cloudy.
    Mottled,
    /// Cloth: a fine weave of base and accent.
    Weave { period: f32 },
    /// Wood grain along t.
    Grain,
    /// A border and diamonds.
    Rug,
    /// Spines of books, each in a colour of its own.
    Books,
    /// Abstract art.
    Picture,
    /// Stone with veins.
    Marble,
    /// A cabinet front: panels of the given width with a shadow gap.
    Panels { width: f32 },
    /// Light that falls off towards the bottom, as the sky does in a window.
    Sky,
}

/// A material with its variation over the surface. Colours are linear.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    pub pattern: Pattern,
    pub base: Vec3,
    pub accent: Vec3,
    /// Perceptual roughness of the base.
    pub roughness: f32,
    /// Emitted radiance.
    pub emission: Vec3,
    /// Tells two surfaces of the same pattern apart.
    pub seed: u32,
}

/// The material of one texel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Texel {
    pub albedo: Vec3,
    pub roughness: f32,
    pub emission: Vec3,
}

impl Paint {
    /// One colour, not emitting.
    pub fn flat(base: Vec3, roughness: f32) -> Self {
        Self { pattern: Pattern::Flat, base, accent: base, roughness, emission: Vec3::ZERO, seed: 1 }
    }

    /// A pattern of two colours, not emitting.
    pub fn new(pattern: Pattern, base: Vec3, accent: Vec3, roughness: f32, seed: u32) -> Self {
        Self { pattern, base, accent, roughness, emission: Vec3::ZERO, seed }
    }

    /// A light source of one radiance.
    pub fn light(emission: Vec3) -> Self {
        Self { emission, ..Self::flat(Vec3::splat(0.6), 0.5) }
    }

    /// A window pane: brighter towards its top.
    pub fn sky(radiance: Vec3) -> Self {
        Self { pattern: Pattern::Sky, ..Self::light(radiance) }
    }

    /// The material at `st` on a chart of `size` metres. `variation` scales how much roughness varies within the
    /// surface.
    pub fn at(&self, st: Vec2, size: Vec2, style: PaintStyle, variation: f32) -> Texel {
        let (albedo, relief) = self.draw(st, size);
        let albedo = match style {
            PaintStyle::Patterned => albedo,
            PaintStyle::Plain => self.base,
        };
        // Wear: broad patches that were polished or dulled, whatever the pattern.
        let wear = 0.35 * (clouds(st * 1.3, self.seed ^ 0x77) - 0.5) * self.roughness.min(0.5);
        let emission = match self.pattern {
            Pattern::Sky => self.emission * (0.75 + 0.5 * st.y / size.y.max(1e-3)),
            _ => self.emission,
        };
        Texel {
            albedo: albedo.clamp(Vec3::splat(ALBEDO.0), Vec3::splat(ALBEDO.1)),
            roughness: (self.roughness + variation * (relief + wear)).clamp(ROUGHNESS.0, ROUGHNESS.1),
            emission,
        }
    }

    /// Albedo, and what the pattern adds to the roughness.
    fn draw(&self, st: Vec2, size: Vec2) -> (Vec3, f32) {
        let (base, accent, seed) = (self.base, self.accent, self.seed);
        match self.pattern {
            Pattern::Flat | Pattern::Sky => (base, 0.0),
            Pattern::Planks { width, length } => {
                let row = (st.y / width).floor();
                let along = st.x / length + lattice(row as i32, 7, seed);
                let board = lattice(row as i32, along.floor() as i32, seed ^ 1);
                let grain = clouds(Vec2::new(st.x * 2.0, st.y * 45.0) + board * 50.0, seed ^ 2);
                let edge = (st.y - row * width).min((along - along.floor()) * length);
                if edge < 0.012 {
                    (base * 0.3, 0.3)
                } else {
                    (base.lerp(accent, board) * (0.8 + 0.4 * grain), 0.06 * (board - 0.5))
                }
            }
            Pattern::Tiles { size: tile } => {
                let id = (st / tile).floor();
                let inside = st - id * tile;
                if inside.min_element() < 0.022 {
                    (accent, 0.5)
                } else {
                    let shade = lattice(id.x as i32, id.y as i32, seed);
                    (base * (0.82 + 0.3 * shade), 0.05 * (shade - 0.5))
                }
            }
            Pattern::Checker { size: tile } => {
                let id = (st / tile).floor();
                let dark = (id.x + id.y).rem_euclid(2.0) > 0.5;
                let veins = 0.9 + 0.2 * clouds(st * 9.0, seed);
                if dark { (accent * veins, 0.06) } else { (base * veins, 0.0) }
            }
            Pattern::Stripes { period } => {
                let phase = (st.x / period).fract();
                let fine = clouds(st * 14.0, seed) - 0.5;
                if phase < 0.5 { (base * (1.0 + 0.08 * fine), 0.0) } else { (accent * (1.0 + 0.08 * fine), -0.08) }
            }
            Pattern::Mottled => {
                let cloud = clouds(st * 2.2, seed);
                (base.lerp(accent, smooth(0.25, 0.75, cloud)), 0.12 * (cloud - 0.5))
            }
            Pattern::Weave { period } => {
                let p = st / period * std::f32::consts::TAU;
                let thread = 0.5 + 0.5 * p.x.sin() * p.y.sin();
                (base.lerp(accent, thread * 0.7 + 0.3 * clouds(st * 7.0, seed)), 0.0)
            }
            Pattern::Grain => {
                let rings = (clouds(Vec2::new(st.x * 6.0, st.y * 0.9), seed) * 9.0).fract();
                let fine = clouds(Vec2::new(st.x * 60.0, st.y * 3.0), seed ^ 3);
                (base.lerp(accent, 0.6 * rings + 0.4 * fine), 0.05 * (rings - 0.5))
            }
            Pattern::Rug => {
                let edge = st.min(size - st).min_element();
                let p = (st - size * 0.5) / 0.34;
                let diamond = ((p.x.abs() + p.y.abs()).fract() - 0.5).abs() * 2.0;
                let pile = 0.85 + 0.3 * clouds(st * 40.0, seed);
                let inner = base.lerp(accent, smooth(0.35, 0.6, diamond));
                let colour = if (0.1..0.2).contains(&edge) { accent } else { inner };
                (colour * pile, 0.0)
            }
            Pattern::Books => {
                let slot = 0.045;
                let id = (st.x / slot).floor();
                let pick = |channel: i32| lattice(id as i32, channel, seed);
                let colour = hue(pick(0)) * (0.15 + 0.5 * pick(1));
                let height = size.y * (0.72 + 0.28 * pick(2));
                let band = ((st.y / size.y) - 0.7).abs() < 0.05;
                if st.y > height || st.x - id * slot < 0.004 {
                    (Vec3::splat(0.05), 0.2)
                } else if band {
                    (accent, -0.1)
                } else {
                    (colour, 0.25 * (pick(3) - 0.5))
                }
            }
            Pattern::Picture => {
                let p = st / size.max_element().max(1e-3);
                let sky = clouds(p * 3.5, seed);
                let mut colour = base.lerp(accent, smooth(0.3, 0.7, sky + 0.4 * (p.y - 0.4)));
                for i in 0..4 {
                    let centre = Vec2::new(lattice(i, 0, seed), lattice(i, 1, seed)) * size / size.max_element();
                    if p.distance(centre) < 0.08 + 0.12 * lattice(i, 2, seed) {
                        colour = hue(lattice(i, 3, seed)) * 0.6;
                    }
                }
                (colour, 0.0)
            }
            Pattern::Marble => {
                let warp = clouds(st * 3.0, seed) * 2.5;
                let vein = ((st.x * 1.4 + st.y * 2.1 + warp) * 2.0).sin().abs();
                (accent.lerp(base, smooth(0.0, 0.35, vein)), 0.06 * (1.0 - vein))
            }
            Pattern::Panels { width } => {
                let count = (size.x / width).round().max(1.0);
                let at = (st.x / size.x.max(1e-3) * count).fract() * size.x / count;
                let edge = at.min(size.x / count - at).min(st.y).min(size.y - st.y);
                let (mid, grain) = (size.x / count * 0.5, clouds(Vec2::new(st.x * 30.0, st.y * 2.0), seed));
                if edge < 0.012 {
                    (base * 0.3, 0.3)
                } else if (at - mid).abs() < 0.09 && (st.y - size.y * 0.86).abs() < 0.015 {
                    (Vec3::splat(0.12), -0.15)
                } else {
                    (base.lerp(accent, grain * 0.6), 0.0)
                }
            }
        }
    }
}

/// A saturated colour of a hue in [0, 1).
pub(super) fn hue(h: f32) -> Vec3 {
    let wheel = |offset: f32| ((h + offset).fract() * 6.0 - 3.0).abs() - 1.0;
    Vec3::new(wheel(0.0), wheel(2.0 / 3.0), wheel(1.0 / 3.0)).clamp(Vec3::splat(0.08), Vec3::splat(0.9))
}

fn smooth(lo: f32, hi: f32, x: f32) -> f32 {
    let t = ((x - lo) / (hi - lo)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Three octaves of value noise, in [0, 1].
fn clouds(p: Vec2, seed: u32) -> f32 {
    (noise(p, seed) * 4.0 + noise(p * 2.1, seed ^ 0x51) * 2.0 + noise(p * 4.3, seed ^ 0xa3)) / 7.0
}

fn noise(p: Vec2, seed: u32) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let w = f * f * (3.0 - 2.0 * f);
    let at = |dx: i32, dy: i32| lattice(cell.x as i32 + dx, cell.y as i32 + dy, seed);
    let lower = at(0, 0) * (1.0 - w.x) + at(1, 0) * w.x;
    let upper = at(0, 1) * (1.0 - w.x) + at(1, 1) * w.x;
    lower * (1.0 - w.y) + upper * w.y
}
