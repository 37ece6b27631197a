//! The built-in synthetic flat: a furnished home with ground-truth materials, path-traced into a capture.
//!
//! Data flows one way: [`FlatOptions`] → floor plan (`layout`) → charts (`shell`, `furniture`) → mesh, atlas and
//! painted textures ([`Flat`], `atlas`, `paint`) → camera poses ([`panoramas`]) → light in the atlas (`irradiance`) →
//! images ([`render`]) → a capture folder ([`write`](write())). Everything follows from the seed.

mod atlas;
mod cameras;
mod chart;
mod emitters;
mod furniture;
mod irradiance;
mod layout;
mod options;
mod paint;
mod palette;
mod pathtrace;
mod random;
mod shell;
mod trace;
mod write;

#[cfg(test)]
mod tests;

pub use cameras::{Panorama, PanoramaOptions, panoramas};
pub use layout::{Room, RoomKind};
pub use options::RenderOptions;
pub use pathtrace::{Rendered, render};
pub use write::{FILES, write};

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::raster::{Gray, Labels, Rgb};
use random::Random;

/// Semantic classes; 0 is void.
pub mod class {
    /// Walls.
    pub const WALL: u16 = 1;
    /// Floors.
    pub const FLOOR: u16 = 2;
    /// Ceilings.
    pub const CEILING: u16 = 3;
    /// Door frames and leaves.
    pub const DOOR: u16 = 4;
    /// Windows: reveal, frame and pane.
    pub const WINDOW: u16 = 5;
    /// Lamps, their dark parts included.
    pub const LAMP: u16 = 6;
    /// Tables.
    pub const TABLE: u16 = 7;
    /// Chairs.
    pub const CHAIR: u16 = 8;
    /// Sofas and armchairs.
    pub const SOFA: u16 = 9;
    /// Beds.
    pub const BED: u16 = 10;
    /// Cabinets, wardrobes, kitchen fronts.
    pub const CABINET: u16 = 11;
    /// Bookshelves.
    pub const SHELF: u16 = 12;
    /// Rugs.
    pub const RUG: u16 = 13;
    /// Pictures.
    pub const PICTURE: u16 = 14;
    /// Vases, plants, books, fruit.
    pub const DECOR: u16 = 15;
    /// Curtains.
    pub const CURTAIN: u16 = 16;
    /// Screens.
    pub const SCREEN: u16 = 17;
}

/// Whether surfaces are patterned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PaintStyle {
    /// Boards, tiles, stripes, cloth, pictures.
    Patterned,
    /// One colour per surface; roughness still varies.
    Plain,
}

/// What flat to make.
#[derive(Clone, Copy, Debug)]
pub struct FlatOptions {
    /// Plan, furniture, materials and lamps follow from it.
    pub seed: u64,
    /// Number of rooms, 3 to 5.
    pub rooms: usize,
    /// Whether surfaces are patterned.
    pub paint: PaintStyle,
    /// How much roughness varies within a surface: 0 not at all, 1 moderately.
    pub roughness_variation: f32,
    /// Side of the atlas, texels: a multiple of 4, at least 256.
    pub atlas: usize,
}

impl Default for FlatOptions {
    fn default() -> Self {
        Self { seed: 1, rooms: 3, paint: PaintStyle::Patterned, roughness_variation: 1.0, atlas: 1024 }
    }
}

/// A furnished flat: one mesh with one non-overlapping atlas, and its true materials. World space, metres, +Z up.
#[derive(Debug)]
pub struct Flat {
    /// All surfaces, counter-clockwise towards the free space.
    pub mesh: Mesh,
    /// Linear albedo, in the atlas.
    pub albedo: Rgb,
    /// Perceptual roughness, in the atlas.
    pub roughness: Gray,
    /// Emitted radiance, in the atlas.
    pub emission: Rgb,
    /// Semantic classes, in the atlas; see [`class`].
    pub semantic: Labels,
    /// Room ids from 1, in the atlas.
    pub room: Labels,
    /// The rooms, by id.
    pub rooms: Vec<Room>,
    /// Density of the atlas.
    pub texels_per_metre: f32,
    charts: Vec<chart::Chart>,
    places: Vec<atlas::ChartRect>,
    /// The chart of every triangle.
    chart_of: Vec<u32>,
}

impl Flat {
    /// Makes the flat of the options. Errors on options out of range.
    pub fn generate(options: &FlatOptions) -> Result<Self> {
        if !layout::ROOMS.contains(&options.rooms) {
            return Err(Error::invalid(format!("a flat has 3 to 5 rooms, {} asked for", options.rooms)));
        }
        if options.atlas < 256 || !options.atlas.is_multiple_of(4) {
            let side = options.atlas;
            return Err(Error::invalid(format!(
                "the demo's atlas must be a multiple of 4 and at least 256, got {side}"
            )));
        }
        if !options.roughness_variation.is_finite() || options.roughness_variation < 0.0 {
            let value = options.roughness_variation;
            return Err(Error::invalid(format!("roughness_variation must be a number of at least 0, got {value}")));
        }
        let layout = layout::Layout::random(options.rooms, &mut Random::new(options.seed, 1));
        let mut random = Random::new(options.seed, 2);
        let palettes: Vec<_> =
            layout.rooms.iter().map(|room| palette::RoomPalette::random(room.kind, &mut random)).collect();
        let mut charts = Vec::new();
        shell::build(&mut charts, &layout, &palettes);
        for (index, palette) in palettes.iter().enumerate() {
            let mut random = Random::new(options.seed, 10 + index as u32);
            furniture::furnish(&mut charts, &layout, index, palette, &mut random);
        }
        atlas::build(charts, layout.rooms, options)
    }

    /// Semantic class and room of a triangle.
    fn labels(&self, triangle: u32) -> (u16, u16) {
        let look = &self.charts[self.chart_of[triangle as usize] as usize].look;
        (look.class, look.room)
    }
}
