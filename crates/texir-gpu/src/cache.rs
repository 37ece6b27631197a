//! Arrays that stay on the device between calls, found again by their content.
//!
//! A fit passes the same footprints, pyramids and groups in every step. Reading them through costs a small part of uploading
//! them, and is safe where the address of a host array, which may be freed and used again, is not.

use std::marker::PhantomData;

use bytemuck::Pod;
use texir_core::error::Result;

use crate::buffer::{View, keep};
use crate::gpu::Gpu;

/// Device memory of one cache; what was used longest ago is dropped first.
const CAPACITY_BYTES: u64 = 512 << 20;

/// Arrays of `T` on the device.
pub(crate) struct Cache<T> {
    /// Most recently used last.
    entries: Vec<(Fingerprint, View)>,
    of: PhantomData<T>,
}

impl<T> Default for Cache<T> {
    fn default() -> Self {
        Self { entries: Vec::new(), of: PhantomData }
    }
}

impl<T: Pod> Cache<T> {
    /// The device's copy of `data`, uploaded when there is none.
    pub fn get(&mut self, gpu: &Gpu, name: &str, data: &[T]) -> Result<View> {
        let print = fingerprint(bytemuck::cast_slice(data));
        let entry = match self.entries.iter().position(|(p, _)| *p == print) {
            Some(found) => self.entries.remove(found),
            None => (print, keep(gpu, name, data)?),
        };
        let view = entry.1.clone();
        self.entries.push(entry);
        let mut bytes: u64 = self.entries.iter().map(|(_, v)| v.bytes()).sum();
        while bytes > CAPACITY_BYTES && self.entries.len() > 1 {
            bytes -= self.entries.remove(0).1.bytes();
        }
        Ok(view)
    }

    /// How many there are.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.entries.len()
    }
}

/// Length and 128 bits of hash, all of which every byte has a say in: two different arrays of one program do not share
/// it.
type Fingerprint = (usize, [u64; 2]);

/// Hashes eight independent words at a time by folded multiplication, at about the speed of reading.
fn fingerprint(bytes: &[u8]) -> Fingerprint {
    const ODD: u64 = 0x9e37_79b9_7f4a_7c15;
    let fold = |a: u64, b: u64| {
        let product = u128::from(a) * u128::from(b);
        (product as u64) ^ (product >> 64) as u64
    };
    let mut lanes: [u64; 8] = std::array::from_fn(|i| ODD.wrapping_mul(2 * i as u64 + 1));
    let mut absorb = |block: &[u8; 64]| {
        for (i, lane) in lanes.iter_mut().enumerate() {
            let mut word = [0; 8];
            word.copy_from_slice(&block[8 * i..8 * i + 8]);
            *lane = fold(*lane ^ u64::from_le_bytes(word), ODD ^ (i as u64) << 1).wrapping_add(lane.rotate_left(23));
        }
    };
    let (blocks, rest) = bytes.as_chunks::<64>();
    blocks.iter().for_each(&mut absorb);
    let mut last = [0; 64];
    last[..rest.len()].copy_from_slice(rest);
    absorb(&last);
    let join = |h: u64, lane: &u64| fold(h ^ lane, ODD).wrapping_add(*lane);
    let start = bytes.len() as u64;
    (bytes.len(), [lanes.iter().fold(start, join), lanes.iter().rev().fold(start, join)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_and_the_length_count() {
        let data: Vec<u8> = (0..300u32).map(|i| (i * 7) as u8).collect();
        let print = fingerprint(&data);
        assert_eq!(print, fingerprint(&data.clone()));
        for i in 0..data.len() {
            let mut other = data.clone();
            other[i] ^= 1;
            assert_ne!(print, fingerprint(&other), "byte {i}");
        }
        assert_ne!(fingerprint(&[0; 64]), fingerprint(&[0; 65]));
    }
}
