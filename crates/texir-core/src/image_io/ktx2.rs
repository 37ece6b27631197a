//! KTX2 with half-float texels: what engines upload as it is (KTX File Format Specification 2.0).

use std::io::Write;
use std::path::Path;

use half::f16;
use ktx2::dfd::{Basic, Block};
use ktx2::{Format, Header, Index, LevelIndex};

use super::ImageRows;
use crate::atomic_file::write_atomic;
use crate::error::{Error, Result};

/// The largest half float.
pub const BRIGHTEST_HALF: f32 = 65504.0;

/// Writes linear RGB as uncompressed R16G16B16A16_SFLOAT, one level, alpha 1. Values above [`BRIGHTEST_HALF`] take that
/// one.
pub fn write_ktx2<'a>(path: impl AsRef<Path>, image: impl Into<ImageRows<'a, 3>>) -> Result<()> {
    const FORMAT: Format = Format::R16G16B16A16_SFLOAT;
    const TEXEL_BYTES: usize = 8;
    let (path, image) = (path.as_ref(), image.into());
    let [width, height] = image.size();
    let (basic, type_size) =
        Basic::from_format(FORMAT).map_err(|e| Error::file(path, format!("cannot be described: {e:?}")))?;
    let block = Block::Basic(basic).to_vec();
    let descriptor_bytes = 4 + block.len();
    let descriptor_at = Header::LENGTH + LevelIndex::LENGTH;
    let texels_at = (descriptor_at + descriptor_bytes).next_multiple_of(TEXEL_BYTES);
    let texel_bytes = (width * height * TEXEL_BYTES) as u64;
    let header = Header {
        format: Some(FORMAT),
        type_size,
        pixel_width: width as u32,
        pixel_height: height as u32,
        pixel_depth: 0,
        layer_count: 0,
        face_count: 1,
        level_count: 1,
        supercompression_scheme: None,
        index: Index {
            dfd_byte_offset: descriptor_at as u32,
            dfd_byte_length: descriptor_bytes as u32,
            kvd_byte_offset: 0,
            kvd_byte_length: 0,
            sgd_byte_offset: 0,
            sgd_byte_length: 0,
        },
    };
    let level =
        LevelIndex { byte_offset: texels_at as u64, byte_length: texel_bytes, uncompressed_byte_length: texel_bytes };
    let half = |v: f32| f16::from_f32(v.min(BRIGHTEST_HALF)).to_le_bytes();
    let head: [&[u8]; 5] = [
        &header.as_bytes(),
        &level.as_bytes(),
        &(descriptor_bytes as u32).to_le_bytes(),
        &block,
        &[0; TEXEL_BYTES][..texels_at - descriptor_at - descriptor_bytes],
    ];
    write_atomic(path, |sink| {
        sink.write_all(&head.concat()).map_err(Error::invalid)?;
        image.each(|_, pixels| {
            let texels = pixels.iter().map(|[r, g, b]| [half(*r), half(*g), half(*b), half(1.0)].concat());
            texels.into_iter().try_for_each(|texel| sink.write_all(&texel)).map_err(Error::invalid)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Rgb;

    #[test]
    fn an_independent_reader_finds_what_was_written() {
        let image = Rgb::new(3, 2, (0..6).map(|i| [i as f32 * 0.25, 1e6, 0.1]).collect()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.ktx2");
        write_ktx2(&path, &image).unwrap();
        let reader = ktx2::Reader::new(std::fs::read(&path).unwrap()).unwrap();
        let header = reader.header();
        assert_eq!((header.pixel_width, header.pixel_height, header.level_count), (3, 2, 1));
        assert_eq!((header.format, header.type_size), (Some(Format::R16G16B16A16_SFLOAT), 2));
        assert_eq!(reader.basic_dfd().unwrap().transfer_function, Some(ktx2::TransferFunction::Linear));
        let level = reader.levels().next().unwrap();
        let half = |i: usize| f16::from_le_bytes([level.data[2 * i], level.data[2 * i + 1]]).to_f32();
        assert_eq!(level.data.len(), 6 * 8);
        for i in 0..6 {
            assert_eq!([half(4 * i), half(4 * i + 1), half(4 * i + 3)], [i as f32 * 0.25, BRIGHTEST_HALF, 1.0]);
            assert!((half(4 * i + 2) - 0.1).abs() < 1e-4);
        }
    }
}
