//! OpenEXR: any layer layout in, one flat layer of ZIP-compressed 32-bit floats out.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, Chromaticities, SampleType, Text};
use exr::meta::header::Header;
use exr::prelude::{Encoding, FlatImage, FlatSamples, LayerAttributes, MetaData, ReadChannels, ReadLayers, Vec2, read};
use glam::Vec3;
use rayon::prelude::*;

use super::{ImageRows, bytes_of, check_size, most_memory, one_channel, primaries};
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};
use crate::raster::{Gray, Rgb};

/// Size of the display window, from the header.
pub(super) fn size(path: &Path) -> Result<[usize; 2]> {
    let meta = MetaData::read_from_file(path, false).map_err(|e| Error::cannot_read(path, e))?;
    for header in &meta.headers {
        check_size(path, header.layer_size.width(), header.layer_size.height())?;
        check_block(path, header)?;
    }
    match meta.headers.first() {
        Some(header) => {
            let (width, height) = header.shared_attributes.display_window.size.into();
            check_size(path, width, height)?;
            Ok([width, height])
        }
        None => Err(Error::file(path, "has no layer; expected an image")),
    }
}

/// Blocks are read whole, and may be higher than the image.
fn check_block(path: &Path, header: &Header) -> Result<()> {
    let (width, height) = match header.blocks {
        BlockDescription::Tiles(tiles) => tiles.tile_size.into(),
        BlockDescription::ScanLines => (header.layer_size.width(), header.compression.scan_lines_per_block()),
    };
    let bytes = width.saturating_mul(height).saturating_mul(header.channels.bytes_per_pixel);
    let limit = most_memory(bytes_of(path)?);
    if bytes as u64 <= limit {
        return Ok(());
    }
    Err(Error::file(
        path,
        format!(
            "has blocks of {width}×{height} pixels, {bytes} bytes each; expected at most {limit}: is the file damaged?"
        ),
    ))
}

/// Walks all blocks of compressed pixels; says what is wrong with the first that is not there.
pub(super) fn check_whole(path: &Path) -> std::result::Result<(), String> {
    let file = BufReader::new(File::open(path).map_err(|e| e.to_string())?);
    let blocks = exr::block::read(file, false).and_then(|reader| reader.all_chunks(false));
    blocks.and_then(|mut blocks| blocks.try_for_each(|block| block.map(drop))).map_err(|e| e.to_string())
}

/// Linear RGB of Rec. 709: colours of other primaries, where the header says so, are converted, and may come out
/// negative. Pixels that the file does not show are `unknown`: outside of its data window, and, unless it is 0, where
/// alpha is 0 (but not everywhere).
pub(super) fn read_rgb(path: &Path, unknown: f32) -> Result<Rgb> {
    let picked = read_channels(path, "channels R, G and B, or Y", unknown, |names| {
        let find = |name: &str| names.iter().position(|n| n == name);
        if let (Some(r), Some(g), Some(b)) = (find("R"), find("G"), find("B")) {
            return Some([r, g, b]);
        }
        if let Some(y) = find("Y") {
            return Some([y; 3]);
        }
        // A named layer in a single part: "ViewLayer.Combined.R", which holds what a camera sees, before others.
        let layers = names.iter().enumerate().filter_map(|(r, name)| {
            let layer = name.strip_suffix(".R")?;
            Some((layer, [r, find(&format!("{layer}.G"))?, find(&format!("{layer}.B"))?]))
        });
        layers.min_by_key(|(layer, _)| !layer.ends_with("Combined")).map(|(_, channels)| channels)
    })?;
    let Picked { mut raster, channels, chromaticities, alpha } = picked;
    if let Some(alpha) = alpha.filter(|alpha| unknown != 0.0 && alpha.iter().any(|a| *a != 0.0)) {
        raster.data.iter_mut().zip(alpha).filter(|(_, alpha)| *alpha == 0.0).for_each(|(rgb, _)| *rgb = [unknown; 3]);
    }
    // Y alone is as white as the file's white.
    let is_colour = channels[0] != channels[1];
    if let Some(chromaticities) = chromaticities.filter(|_| is_colour)
        && let Some(to_rec_709) = primaries::to_rec_709(&chromaticities).map_err(|what| Error::file(path, what))?
    {
        let convert = |rgb: [f32; 3]| (to_rec_709 * Vec3::from(rgb).as_dvec3()).as_vec3().to_array();
        raster.data.par_iter_mut().for_each(|rgb| *rgb = convert(*rgb));
    }
    Ok(raster)
}

pub(super) fn read_gray(path: &Path) -> Result<Gray> {
    size(path)?;
    let picked = read_channels(path, "one channel, or one named Y or R", 0.0, |names| {
        let find = |name: &str| names.iter().position(|n| n == name);
        let only = (names.len() == 1).then_some(0);
        if let Some(one) = only.or_else(|| find("Y")) {
            return Some([one; 3]);
        }
        let r = find("R")?;
        Some([r, find("G").unwrap_or(r), find("B").unwrap_or(r)])
    })?;
    one_channel(path, &picked.raster)
}

/// What [`read_channels`] found.
struct Picked {
    raster: Rgb,
    /// The channels' places in their layer.
    channels: [usize; 3],
    /// Of which primaries R, G and B are.
    chromaticities: Option<Chromaticities>,
    /// Opacity of each pixel, where they have an alpha channel beside them.
    alpha: Option<Vec<f32>>,
}

/// The three channels that `select` picks by name from the first layer that has them, placed in the display window: pixels
/// outside of the data window are `empty`.
fn read_channels(
    path: &Path,
    expected: &str,
    empty: f32,
    select: impl Fn(&[String]) -> Option<[usize; 3]>,
) -> Result<Picked> {
    let image: FlatImage = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_file(path)
        .map_err(|e| Error::cannot_read(path, e))?;
    let mut found = Vec::new();
    for layer in &image.layer_data {
        let channels = &layer.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        let Some(picked) = select(&names) else {
            found.extend(names);
            continue;
        };
        let mut planes = [&channels[0]; 3];
        for (plane, index) in planes.iter_mut().zip(picked) {
            *plane = &channels[index];
            if plane.sampling != Vec2(1, 1) {
                return Err(Error::file(
                    path,
                    format!("channel {} is subsampled; expected one value per pixel", names[index]),
                ));
            }
        }
        let window = image.attributes.display_window;
        let offset = layer.attributes.layer_position - window.position;
        let mut raster = Rgb::filled(window.size.width(), window.size.height(), [empty; 3]);
        let beside = names[picked[0]].strip_suffix(['R', 'Y']).map(|layer| format!("{layer}A"));
        let alpha =
            beside.and_then(|name| channels.iter().find(|c| c.name == *name.as_str() && c.sampling == Vec2(1, 1)));
        let mut opacity = alpha.map(|_| vec![0.0; raster.data.len()]);
        for (y, row) in raster.data.chunks_exact_mut(window.size.width()).enumerate() {
            let Some(source_y) = inside(y, offset.y(), layer.size.height()) else { continue };
            for (x, pixel) in row.iter_mut().enumerate() {
                let Some(source_x) = inside(x, offset.x(), layer.size.width()) else { continue };
                let index = source_y * layer.size.width() + source_x;
                *pixel = planes.map(|plane| sample(&plane.sample_data, index));
                if let (Some(alpha), Some(opacity)) = (alpha, &mut opacity) {
                    opacity[y * window.size.width() + x] = sample(&alpha.sample_data, index);
                }
            }
        }
        let chromaticities = image.attributes.chromaticities;
        return Ok(Picked { raster, channels: picked, chromaticities, alpha: opacity });
    }
    Err(Error::file(path, format!("has the channels {}; expected {expected}", found.join(", "))))
}

/// `at - offset`, when that lies in `0..length`.
fn inside(at: usize, offset: i32, length: usize) -> Option<usize> {
    usize::try_from(at as i64 - i64::from(offset)).ok().filter(|i| *i < length)
}

fn sample(samples: &FlatSamples, index: usize) -> f32 {
    match samples {
        FlatSamples::F16(values) => values[index].to_f32(),
        FlatSamples::F32(values) => values[index],
        FlatSamples::U32(values) => values[index] as f32,
    }
}

/// Writes linear RGB as OpenEXR: R, G, B, 32-bit float, ZIP.
pub fn write_rgb<'a>(path: impl AsRef<Path>, image: impl Into<ImageRows<'a, 3>>) -> Result<()> {
    write(path.as_ref(), image.into(), [("B", 2), ("G", 1), ("R", 0)])
}

/// Writes one linear channel as OpenEXR: Y, 32-bit float, ZIP.
pub fn write_gray<'a>(path: impl AsRef<Path>, image: impl Into<ImageRows<'a, 1>>) -> Result<()> {
    write(path.as_ref(), image.into(), [("Y", 0)])
}

/// Writes channels, in the order of their names, by their places in a pixel.
fn write<const N: usize>(path: &Path, image: ImageRows<'_, N>, channels: [(&str, usize); N]) -> Result<()> {
    let Encoding { compression, line_order, .. } = Encoding::SMALL_LOSSLESS;
    let order = channels.map(|(_, place)| place);
    let list = channels.iter().map(|(name, _)| ChannelDescription::named(*name, SampleType::F32)).collect();
    let [width, height] = image.size();
    let header = Header::new(Text::default(), (width, height), list)
        .with_encoding(compression, BlockDescription::ScanLines, line_order)
        .with_attributes(LayerAttributes::default());
    let lines = compression.scan_lines_per_block();
    let failed = |e: Error| exr::error::Error::Invalid(e.to_string().into());
    write_atomic(path, |sink| {
        exr::block::write(sink, [header].into_iter().collect(), true, |meta, chunks| {
            let compressed = |first: usize, pixels: &[[f32; N]]| {
                let index = BlockIndex {
                    layer: 0,
                    pixel_position: Vec2(0, first),
                    pixel_size: Vec2(width, pixels.len() / width),
                    level: Vec2(0, 0),
                };
                UncompressedBlock { index, data: planes(pixels, width, order) }.compress_to_chunk(&meta.headers)
            };
            let written = image.each(|rows, pixels| {
                let first = rows.start / lines;
                let blocks = pixels.par_chunks(lines * width).enumerate();
                let blocks: Vec<_> = blocks.map(|(k, block)| compressed((first + k) * lines, block)).collect();
                for (k, chunk) in blocks.into_iter().enumerate() {
                    let written = chunk.and_then(|chunk| chunks.write_chunk(first + k, chunk));
                    written.map_err(Error::invalid)?;
                }
                Ok(())
            });
            written.map_err(failed)
        })
    })
}

/// Some lines as OpenEXR has them: of every line one channel after another.
fn planes<const N: usize>(pixels: &[[f32; N]], width: usize, order: [usize; N]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(size_of_val(pixels));
    for line in pixels.chunks(width) {
        order.iter().for_each(|&c| bytes.extend(line.iter().flat_map(|pixel| pixel[c].to_ne_bytes())));
    }
    bytes
}
