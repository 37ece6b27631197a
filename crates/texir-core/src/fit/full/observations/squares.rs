//! The squares that images are cut into, within which pixels may share their light samples.

use glam::Vec2;

use crate::camera::Camera;
use crate::fit::settings::FullSettings;
use crate::specular_table::STRATA;

/// Strata of a pixel or of a block, per axis.
pub const AXIS: usize = 2;
const _: () = assert!(AXIS * AXIS == STRATA, "the strata of a pixel form a square");

/// The squares that an image is cut into, row by row. Near the poles of a panorama, whose columns crowd there, they
/// have more pixels in a row, so that they are as wide there as anywhere.
#[derive(Debug)]
pub struct Squares {
    /// Pixels in a row of the image.
    width: usize,
    /// Rows of pixels in a square.
    pub edge: usize,
    /// By row of squares: pixels across one.
    across: Vec<usize>,
    /// By row of squares: the number of the first; at last that of all.
    first: Vec<usize>,
}

impl Squares {
    /// Those about `angle` radians wide, of whole pixels.
    pub fn new(camera: &Camera, angle: f32) -> Self {
        // Beyond what rounding makes of one pixel in a row for one in a column.
        const ROUNDING: f32 = 1e-3;
        let edge = (angle / camera.pixel_angle()).round().max(1.0) as usize;
        let across = |row: usize| {
            let middle = ((row * edge) as f32 + 0.5 * edge as f32).min(camera.height as f32 - 0.5);
            let Vec2 { x, y } = camera.pixels_per_radian(middle);
            // Where pixels are higher than that, they are not put together to be as wide as high.
            let side = if angle * y < 1.0 { angle * y } else { edge as f32 };
            ((side * x / y + ROUNDING) as usize).clamp(1, camera.width)
        };
        let across: Vec<usize> = (0..camera.height.div_ceil(edge)).map(across).collect();
        let first = |squares: &mut usize, across: &usize| {
            let first = *squares;
            *squares += camera.width.div_ceil(*across);
            Some(first)
        };
        let all = across.iter().map(|across| camera.width.div_ceil(*across)).sum();
        let first = across.iter().scan(0, first).chain([all]).collect();
        Self { width: camera.width, edge, across, first }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.first[self.across.len()]
    }

    /// The number of one in a row and a column of them.
    pub fn number(&self, [row, column]: [usize; 2]) -> usize {
        self.first[row] + column
    }

    /// Row and column of a pixel's.
    pub fn of(&self, pixel: usize) -> [usize; 2] {
        let row = pixel / self.width / self.edge;
        [row, pixel % self.width / self.across[row]]
    }

    /// Squares in a row of them.
    fn columns(&self, row: usize) -> usize {
        self.first[row + 1] - self.first[row]
    }

    /// The numbers of those at most `reach` rows and columns away from one, that one among them. The image's sides
    /// join, as a panorama's do; what that brings together in another image lies in other directions.
    pub fn around(&self, [row, column]: [usize; 2], reach: usize) -> impl Iterator<Item = usize> {
        let middle = 2 * column + 1;
        (row.saturating_sub(reach)..(row + reach + 1).min(self.across.len())).flat_map(move |other| {
            let columns = self.columns(other);
            // Above and below, the column of the same direction.
            let column = middle * columns / (2 * self.columns(row));
            let reach = reach.min((columns - 1) / 2);
            (0..=2 * reach).map(move |step| self.first[other] + (column + columns + step - reach) % columns)
        })
    }

    /// How far a pixel is off the middle of the `k`th quadrant of its square, squared, in shares of the square's sides;
    /// compares within one square.
    pub fn off_quadrant(&self, pixel: usize, k: usize) -> f32 {
        let [row, column] = self.of(pixel);
        let off = |at: usize, start: usize, side: usize, half: usize| {
            ((at - start) as f32 + 0.5) / side as f32 - (0.25 + 0.5 * half as f32)
        };
        let across = self.across[row];
        let down = off(pixel / self.width, row * self.edge, self.edge, k / AXIS);
        let right = off(pixel % self.width, column * across, across, k % AXIS);
        down * down + right * right
    }
}

impl FullSettings {
    /// The squares of a view within which light samples are shared.
    pub fn squares(&self, camera: &Camera) -> Squares {
        Squares::new(camera, self.block_angle.to_radians())
    }

    /// Rays that the light samples of a view take in all rounds.
    pub fn rays(&self, camera: &Camera) -> u64 {
        let of_round = |round: Self| {
            let blocks = round.squares(camera).count();
            blocks as u64 * round.tables() * u64::from(round.sampling(0, 0).rays())
        };
        self.rounds().into_iter().map(of_round).sum()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use glam::Mat4;

    use super::*;
    use crate::camera::Projection;

    fn camera(projection: Projection, [width, height]: [usize; 2]) -> Camera {
        Camera { projection, width, height, world_from_camera: Mat4::IDENTITY }
    }

    /// Those of `edge` pixels of a photo `side` pixels wide and high.
    pub fn of_photo(side: usize, edge: usize) -> Squares {
        let photo = Projection::Pinhole { fx: 8.1, fy: 8.1, cx: 4.0, cy: 4.0 };
        Squares::new(&camera(photo, [side; 2]), edge as f32 / 8.1)
    }

    #[test]
    fn squares_of_a_panorama_are_as_wide_as_high_up_to_its_poles() {
        for edge in [1, 2, 5] {
            let panorama = camera(Projection::Equirectangular, [512, 256]);
            let squares = Squares::new(&panorama, edge as f32 * 1.001 * panorama.pixel_angle());
            let rows = 256usize.div_ceil(edge);
            for row in 0..rows {
                let sin = (std::f32::consts::PI * ((row as f32 + 0.5) * edge as f32).min(255.5) / 256.0).sin();
                let width = squares.across[row] as f32 * sin / edge as f32;
                // A pixel more would be too wide, or there is none.
                let widest = width + 1.01 * sin / edge as f32 > 1.0 || squares.columns(row) == 1;
                assert!(width < 1.01 && widest, "row {row} of {rows}: {width}");
            }
            assert_eq!(squares.across[rows / 2], edge);
            let share = squares.count() as f32 * (edge * edge) as f32 / panorama.pixels() as f32;
            assert!((0.63..0.8).contains(&share), "edge {edge}: {share}");
        }
        // Pixels wider than squares are put together only where they are narrower.
        let panorama = camera(Projection::Equirectangular, [512, 256]);
        let narrow = Squares::new(&panorama, 0.5 * panorama.pixel_angle());
        let sin = |row: usize| (std::f32::consts::PI * (row as f32 + 0.5) / 256.0).sin();
        assert!((0..256).all(|row| (narrow.across[row] == 1) == (sin(row) > 0.25)));
        // Negative control: a photo's are of as many pixels everywhere.
        assert!(of_photo(8, 2).across.iter().all(|across| *across == 2) && of_photo(8, 2).count() == 16);
    }

    #[test]
    fn light_samples_for_metals_are_counted() {
        let mut settings = FullSettings::default();
        let panorama = camera(Projection::Equirectangular, [64, 32]);
        let rays = settings.rays(&panorama);
        settings.metallic.enabled = true;
        assert_eq!((rays > 0, settings.rays(&panorama)), (true, 2 * rays));
    }

    #[test]
    fn squares_around_one_at_a_pole_lie_in_the_same_direction() {
        let panorama = camera(Projection::Equirectangular, [512, 256]);
        let squares = Squares::new(&panorama, 1.001 * panorama.pixel_angle());
        let angle = |number: usize| {
            let row = squares.first.partition_point(|first| *first <= number) - 1;
            ((number - squares.first[row]) as f32 + 0.5) / squares.columns(row) as f32
        };
        for at in [[2, 3], [40, 100], [128, 511], [250, 0]] {
            let own = squares.first[at[0]] + at[1];
            let nearer_to_pole = if at[0] < 128 { at[0] - 1 } else { at[0] + 1 };
            let around: Vec<usize> = squares.around(at, 1).collect();
            assert!(around.len() == 9 && around.contains(&own));
            for other in around {
                let apart = (angle(other) - angle(own)).abs();
                let widest = 1.0 / squares.columns(nearer_to_pole) as f32;
                assert!(apart.min(1.0 - apart) < 1.6 * widest, "{at:?}: {apart}");
            }
        }
    }
}
