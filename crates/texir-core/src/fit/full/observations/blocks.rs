//! Which pixels share their light samples. A lobe blurs what it reflects, so that over a flat surface the specular
//! radiance changes slowly from one pixel to the next: cost follows the angle that a capture covers, not the size of
//! its images.

use glam::Vec3;

use crate::backend::ShadePoint;
use crate::fit::full::observations::squares::Squares;
use crate::specular_table::STRATA;

/// Normals of pixels that share samples differ by less than the angle of this cosine.
const SAME_WAY: f32 = 0.98;
/// How far pixels that share samples may lie off each other's tangent plane, as a share of their distance.
const FLAT: f32 = 0.1;

/// What a pixel sees, as far as it decides whose reflections it can share.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Where, in world space.
    pub position: Vec3,
    /// Its unit normal.
    pub normal: Vec3,
    /// Its semantic class.
    pub class: u16,
    /// Whether the pixel sees another surface besides.
    pub mixed: bool,
}

impl Patch {
    /// What a pixel sees whose strata show these points: the first, and whether all others are parts of its surface.
    pub fn of(points: &[ShadePoint; STRATA], class: u16) -> Self {
        let at = |point: &ShadePoint| {
            let (position, normal) = (point.position.into(), point.normal.into());
            Self { position, normal, class, mixed: false }
        };
        let first = at(&points[0]);
        Self { mixed: points.iter().any(|point| !first.like(&at(point))), ..first }
    }

    /// Whether both are parts of one flat surface of one class. Pixels across an edge match only each other: what lies
    /// beyond it may reflect a window that the surface does not.
    pub fn like(&self, other: &Self) -> bool {
        let apart = other.position - self.position;
        self.mixed == other.mixed
            && self.class == other.class
            && self.normal.dot(other.normal) >= SAME_WAY
            && self.normal.dot(apart).abs() <= FLAT * apart.length()
    }
}

/// Pixels by what they share.
pub struct Blocks {
    /// The block of each pixel.
    pub of: Vec<u32>,
    /// Per block, the pixels (indices into the image) that its four rays' points are taken from; point k is stratum k
    /// of its pixel.
    pub corners: Vec<[usize; STRATA]>,
    /// What the first pixel of each block sees.
    pub patches: Vec<Patch>,
    /// Row and column of each block's square.
    places: Vec<[usize; 2]>,
    squares: Squares,
    /// The first block of each square, row by row; its others follow.
    first: Vec<u32>,
}

impl Blocks {
    /// The blocks whose squares are at most `reach` rows and columns away, its own among them.
    pub fn around(&self, block: usize, reach: usize) -> impl Iterator<Item = usize> {
        self.squares.around(self.places[block], reach).flat_map(|square| {
            let end = self.first.get(square + 1).map_or(self.corners.len(), |first| *first as usize);
            self.first[square] as usize..end
        })
    }
}

/// Gathers those of the `pixels` (indices into an image, ascending) that lie in one of its `squares` and see a like
/// patch.
pub fn group_pixels(pixels: &[usize], patches: &[Patch], squares: Squares) -> Blocks {
    let mut order: Vec<usize> = (0..pixels.len()).collect();
    order.sort_by_cached_key(|&i| squares.of(pixels[i]));
    let (mut of, mut places) = (vec![0; pixels.len()], Vec::new());
    let (mut corners, mut first_patches) = (Vec::new(), Vec::new());
    for members in order.chunk_by(|&a, &b| squares.of(pixels[a]) == squares.of(pixels[b])) {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for &i in members {
            match groups.iter_mut().find(|group| patches[group[0]].like(&patches[i])) {
                Some(group) => group.push(i),
                None => groups.push(vec![i]),
            }
        }
        for group in groups {
            group.iter().for_each(|&i| of[i] = corners.len() as u32);
            first_patches.push(patches[group[0]]);
            places.push(squares.of(pixels[group[0]]));
            corners.push(std::array::from_fn(|k| {
                let off = |a: &usize, b: &usize| squares.off_quadrant(*a, k).total_cmp(&squares.off_quadrant(*b, k));
                group.iter().map(|&i| pixels[i]).min_by(off).unwrap_or_default()
            }));
        }
    }
    // Blocks are in the order of their squares.
    let first =
        (0..squares.count()).map(|square| places.partition_point(|place| squares.number(*place) < square) as u32);
    Blocks { first: first.collect(), of, corners, patches: first_patches, places, squares }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::fit::full::observations::squares::AXIS;
    use crate::fit::full::observations::squares::tests::of_photo;

    const WIDTH: usize = 8;

    fn wall(pixel: usize) -> Patch {
        let position = Vec3::new((pixel % WIDTH) as f32, (pixel / WIDTH) as f32, 0.0);
        Patch { position, normal: Vec3::Z, class: 1, mixed: false }
    }

    fn shared(patch: impl Fn(usize) -> Patch, edge: usize) -> Blocks {
        let pixels: Vec<usize> = (0..WIDTH * WIDTH).collect();
        let patches: Vec<Patch> = pixels.iter().map(|&p| patch(p)).collect();
        group_pixels(&pixels, &patches, of_photo(WIDTH, edge))
    }

    #[test]
    fn a_flat_wall_is_shared_by_squares_that_are_sampled_all_over() {
        let blocks = shared(wall, 4);
        assert_eq!(blocks.corners.len(), 4);
        for pixel in 0..WIDTH * WIDTH {
            assert_eq!(blocks.of[pixel] as usize, pixel / WIDTH / 4 * 2 + pixel % WIDTH / 4);
        }
        for (b, corners) in blocks.corners.iter().enumerate() {
            let quadrants = corners.map(|p| {
                assert_eq!(blocks.of[p] as usize, b);
                [p / WIDTH % 4 / 2, p % WIDTH % 4 / 2]
            });
            assert_eq!(quadrants, [[0, 0], [0, 1], [1, 0], [1, 1]]);
        }
    }

    #[test]
    fn edges_classes_and_steps_are_not_shared_across() {
        let fold = |p: usize| match wall(p).position {
            at if at.x < 3.0 => wall(p),
            at => Patch { position: Vec3::new(3.0, at.y, at.x), normal: Vec3::X, class: 1, mixed: false },
        };
        let label = |p: usize| Patch { class: u16::from(p % WIDTH < 3), ..wall(p) };
        let step =
            |p: usize| Patch { position: wall(p).position + Vec3::Z * f32::from(u8::from(p % WIDTH < 3)), ..wall(p) };
        for blocks in [shared(fold, 4), shared(label, 4), shared(step, 4)] {
            assert_eq!(blocks.corners.len(), 6);
            for row in 0..WIDTH {
                assert_ne!(blocks.of[row * WIDTH + 2], blocks.of[row * WIDTH + 3]);
                assert_eq!(blocks.of[row * WIDTH + 1], blocks.of[row * WIDTH + 2]);
            }
        }
    }

    #[test]
    fn pixels_across_an_edge_are_not_shared_with_those_beside_it() {
        // The wall ends within the pixels of column 3: their right strata see what is a metre behind it.
        let point = |at: Vec3| ShadePoint { position: at.into(), normal: Vec3::Z.into(), ..ShadePoint::default() };
        let seen = |behind: f32| {
            move |p: usize| {
                let at = wall(p).position;
                let points = std::array::from_fn(|k| {
                    let right = (k % AXIS) as f32;
                    let depth = if p % WIDTH == 3 { behind * right } else { 0.0 };
                    point(at + Vec3::new(0.5 * right, 0.5 * (k / AXIS) as f32, -depth))
                });
                Patch::of(&points, 1)
            }
        };
        let blocks = shared(seen(1.0), 4);
        assert_eq!(blocks.corners.len(), 6);
        for (p, block) in blocks.of.iter().enumerate() {
            let is_edge = |p: usize| p % WIDTH == 3;
            assert!(blocks.corners[*block as usize].iter().all(|corner| is_edge(*corner) == is_edge(p)), "pixel {p}");
        }
        assert_eq!(shared(seen(0.0), 4).corners.len(), 4, "the same without an edge");
    }

    #[test]
    fn blocks_around_one_are_those_of_the_squares_around_it() {
        let mixed = |p: usize| Patch { class: (p % 2) as u16, ..wall(p) };
        let blocks = shared(mixed, 2);
        let side = WIDTH / 2;
        for (block, at) in blocks.places.iter().enumerate() {
            let mut around: Vec<usize> = blocks.around(block, 1).collect();
            around.sort_unstable();
            let near = |a: usize, b: usize| a.abs_diff(b) <= 1;
            let wraps = |a: usize, b: usize| near(a, b) || a.abs_diff(b) == side - 1;
            let expected = (0..blocks.corners.len())
                .filter(|&other| near(at[0], blocks.places[other][0]) && wraps(at[1], blocks.places[other][1]));
            assert_eq!(around, expected.collect::<Vec<_>>());
        }
        assert_eq!(
            blocks.around(0, 100).collect::<std::collections::BTreeSet<_>>().len(),
            blocks.around(0, 100).count()
        );
    }

    #[test]
    fn blocks_of_one_pixel_are_the_pixels() {
        let pixels = [3, 5, 17];
        let blocks = group_pixels(&pixels, &pixels.map(wall), of_photo(WIDTH, 1));
        assert_eq!(blocks.of, [0, 1, 2]);
        assert_eq!(blocks.corners, pixels.map(|p| [p; STRATA]));
    }
}
