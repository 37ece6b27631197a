//! The materials of a room: colours and roughness that go together, varied by the seed.

use glam::Vec3;

use super::layout::RoomKind;
use super::paint::{Paint, Pattern, hue};
use super::random::Random;

/// The paints that the pieces of a room choose from.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoomPalette {
    pub floor: Paint,
    pub wall: Paint,
    /// One wall is papered differently.
    pub accent_wall: Paint,
    /// Which wall that is: index into [`super::shell::Wall::of`].
    pub accent_side: usize,
    pub ceiling: Paint,
    /// Door and window frames.
    pub trim: Paint,
    pub threshold: Paint,
    pub sky: Paint,
    pub curtain: Paint,
    pub wood: Paint,
    pub fronts: Paint,
    pub fabric: Paint,
    pub cushion: Paint,
    pub linen: Paint,
    pub rug: Paint,
    pub top: Paint,
    pub metal: Paint,
    pub screen: Paint,
    pub porcelain: Paint,
    /// Radiance of lamps.
    pub warm: Vec3,
}

impl RoomPalette {
    /// Materials for a room.
    pub fn random(kind: RoomKind, random: &mut Random) -> Self {
        use Pattern::*;
        let seed = random.seed();
        let new = |pattern, base: [f32; 3], accent: [f32; 3], roughness| {
            Paint::new(pattern, base.into(), accent.into(), roughness, seed)
        };
        let tint = random.unit();
        // A colour of the room's hue: whiteness 1 is grey.
        let tinted = |level: f32, whiteness: f32| {
            let colour = hue(tint).lerp(Vec3::ONE, whiteness);
            (colour * level / colour.max_element()).to_array()
        };
        let planks = Planks { width: random.range(0.13, 0.2), length: random.range(0.9, 1.4) };
        let gloss = random.range(-0.03, 0.03);
        let (floor, wall, accent_wall) = match kind {
            RoomKind::Living => (
                new(planks, [0.42, 0.25, 0.13], [0.3, 0.165, 0.08], 0.15 + gloss),
                new(Mottled, [0.68, 0.64, 0.57], [0.58, 0.54, 0.47], 0.55),
                new(Stripes { period: 0.32 }, tinted(0.55, 0.55), tinted(0.36, 0.4), 0.62),
            ),
            RoomKind::Bedroom => (
                new(planks, [0.58, 0.44, 0.29], [0.48, 0.35, 0.22], 0.4 + gloss),
                new(Mottled, tinted(0.66, 0.75), tinted(0.58, 0.7), 0.72),
                new(Stripes { period: 0.2 }, tinted(0.5, 0.35), tinted(0.62, 0.7), 0.66),
            ),
            RoomKind::Kitchen => (
                new(Checker { size: 0.33 }, [0.66, 0.64, 0.6], [0.2, 0.21, 0.23], 0.22 + gloss),
                new(Mottled, [0.7, 0.69, 0.62], [0.62, 0.6, 0.52], 0.85),
                new(Tiles { size: 0.22 }, tinted(0.6, 0.5), [0.5, 0.5, 0.48], 0.2),
            ),
            RoomKind::Study => (
                new(Tiles { size: 0.45 }, [0.42, 0.37, 0.33], [0.25, 0.24, 0.23], 0.27 + gloss),
                new(Mottled, [0.55, 0.6, 0.62], [0.47, 0.52, 0.55], 0.45),
                new(Grain, [0.36, 0.22, 0.13], [0.22, 0.12, 0.06], 0.35),
            ),
        };
        let dark_wood = random.unit() < 0.5;
        let (oak, walnut) = (([0.5, 0.34, 0.2], [0.38, 0.24, 0.13]), ([0.2, 0.11, 0.06], [0.12, 0.065, 0.035]));
        let (wood, fronts) = if dark_wood { (walnut, oak) } else { (oak, walnut) };
        let contrast = hue(tint + random.range(0.35, 0.65)).lerp(Vec3::ONE, 0.15) * 0.5;
        Self {
            floor,
            wall,
            accent_wall,
            accent_side: random.index(4),
            ceiling: new(Mottled, [0.8, 0.79, 0.77], [0.76, 0.75, 0.73], 0.88),
            trim: new(Flat, [0.72, 0.71, 0.68], [0.72, 0.71, 0.68], random.range(0.25, 0.4)),
            threshold: new(Grain, walnut.0, walnut.1, 0.35),
            sky: Paint::sky(Vec3::new(3.1, 3.7, 4.3) * random.range(0.9, 1.15)),
            curtain: new(Weave { period: 0.02 }, tinted(0.6, 0.45), tinted(0.45, 0.3), 0.85),
            wood: new(Grain, wood.0, wood.1, random.range(0.2, 0.4)),
            fronts: if kind == RoomKind::Kitchen {
                new(Panels { width: 0.5 }, tinted(0.62, 0.6), tinted(0.56, 0.6), 0.18)
            } else {
                new(Panels { width: 0.45 }, fronts.0, fronts.1, random.range(0.25, 0.45))
            },
            fabric: new(Weave { period: 0.045 }, tinted(0.38, 0.25), tinted(0.26, 0.2), 0.8),
            cushion: new(Stripes { period: 0.09 }, contrast.to_array(), [0.6, 0.57, 0.5], 0.75),
            linen: new(Weave { period: 0.06 }, [0.74, 0.73, 0.7], tinted(0.66, 0.75), 0.82),
            rug: new(Rug, contrast.to_array(), [0.55, 0.5, 0.42], 0.9),
            top: new(Marble, [0.62, 0.6, 0.57], [0.35, 0.34, 0.34], 0.12),
            metal: new(Flat, [0.12, 0.12, 0.125], [0.12, 0.12, 0.125], 0.3),
            screen: new(Flat, [0.035, 0.035, 0.04], [0.035, 0.035, 0.04], 0.09),
            porcelain: new(Mottled, contrast.to_array(), [0.6, 0.58, 0.55], 0.16),
            warm: Vec3::new(1.0, random.range(0.8, 0.88), random.range(0.58, 0.78)),
        }
    }
}
