//! Furniture and lamps: where they fit, and what they are made of.

use glam::{Vec2, Vec3};

use super::chart::{Chart, Faces, Frame, Look, Rect, ball, block, cylinder};
use super::class;
use super::layout::{CEILING, Layout, Room, RoomKind};
use super::paint::{Paint, Pattern};
use super::palette::RoomPalette;
use super::random::Random;
use super::shell::Wall;

/// Clearance in front of a doorway, metres.
const DOOR_CLEARANCE: f32 = 0.9;
/// Objects against a wall keep this distance, so that no two surfaces coincide, metres.
const GAP: f32 = 1.0 / 64.0;

/// Fills a room.
pub(super) fn furnish(out: &mut Vec<Chart>, layout: &Layout, index: usize, palette: &RoomPalette, random: &mut Random) {
    let mut site = Site::new(out, layout, index, palette, random);
    site.door_leaves();
    match layout.rooms[index].kind {
        RoomKind::Living => {
            site.screen();
            site.bookshelf();
            site.sofa();
            site.coffee_corner();
            site.floor_lamp();
            site.cabinet(1.1, 0.9);
            site.armchair();
            site.pendants(2);
        }
        RoomKind::Bedroom => {
            site.bed();
            site.cabinet(1.4, 2.1);
            site.cabinet(0.9, 0.8);
            site.floor_lamp();
            site.plant();
            site.panel();
        }
        RoomKind::Kitchen => {
            site.counter();
            site.dining();
            site.plant();
            site.spots();
        }
        RoomKind::Study => {
            site.bookshelf();
            site.desk();
            site.armchair();
            site.plant();
            site.panel();
        }
    }
    site.pictures();
}

/// A room being furnished.
struct Site<'a> {
    out: &'a mut Vec<Chart>,
    layout: &'a Layout,
    index: usize,
    room: Room,
    palette: &'a RoomPalette,
    random: &'a mut Random,
    /// Where something stands or must stay free.
    blocked: Vec<Rect>,
    /// Where tall things must not stand: before windows.
    views: Vec<Rect>,
    /// Where tall things stand: no pictures behind them.
    tall: Vec<Rect>,
}

impl<'a> Site<'a> {
    fn new(
        out: &'a mut Vec<Chart>,
        layout: &'a Layout,
        index: usize,
        palette: &'a RoomPalette,
        random: &'a mut Random,
    ) -> Self {
        let (mut blocked, mut views) = (Vec::new(), Vec::new());
        for opening in layout.openings.iter().filter(|opening| opening.touches(index)) {
            if opening.is_window() {
                views.push(opening.plan.grown(0.45));
            } else {
                let across = if opening.across_x { Vec2::X } else { Vec2::Y };
                let reach = across * DOOR_CLEARANCE;
                blocked.push(Rect::new(opening.plan.lo - reach, opening.plan.hi + reach));
            }
        }
        let room = layout.rooms[index];
        Self { out, layout, index, room, palette, random, blocked, views, tall: Vec::new() }
    }

    fn look(&self, paint: Paint, class: u16) -> Look {
        Look { paint, class, room: self.room.id }
    }

    fn block(&mut self, look: Look, frame: Frame, lo: [f32; 3], hi: [f32; 3], faces: Faces) {
        block(self.out, look, frame, lo.into(), hi.into(), faces);
    }

    /// Round legs at the corners of a rectangle that starts at the frame's origin.
    fn legs(&mut self, look: Look, frame: Frame, size: Vec2, radius: f32, height: f32) {
        for corner in [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE] {
            let at = radius + corner * (size - 2.0 * radius);
            let foot = frame.moved(at.extend(0.0));
            cylinder(
                self.out,
                look,
                foot,
                radius,
                (0.0, height),
                Faces::ALL.without(Faces::BOTTOM).without(Faces::TOP),
            );
        }
    }

    /// Marks the rectangle as taken if it is free and in the room.
    fn claim(&mut self, plan: Rect, margin: f32, tall: bool) -> bool {
        let room = self.room.rect();
        let inside = plan.lo.cmpge(room.lo).all() && plan.hi.cmple(room.hi).all();
        let wanted = plan.grown(margin);
        if !inside
            || self.blocked.iter().any(|other| wanted.overlaps(other))
            || (tall && self.views.iter().any(|other| plan.overlaps(other)))
        {
            return false;
        }
        self.blocked.push(plan);
        if tall {
            self.tall.push(plan);
        }
        true
    }

    /// A free place of `width` × `depth` metres against a wall: its frame has the origin on the floor at the corner
    /// from which x runs along the wall and y into the room. `None` if the room is too full.
    fn against_wall(&mut self, width: f32, depth: f32, tall: bool) -> Option<Frame> {
        let mut spots: Vec<(usize, f32)> = Vec::new();
        let walls = Wall::of(self.room.rect());
        for (side, wall) in walls.iter().enumerate() {
            let mut at = GAP;
            while at + width + GAP <= wall.length {
                spots.push((side, at));
                at += 0.125;
            }
        }
        self.random.shuffle(&mut spots);
        spots.into_iter().find_map(|(side, at)| {
            let wall = walls[side];
            let corner = wall.origin + wall.right * (at + width) + wall.inward * GAP;
            let frame = Frame::facing(corner, wall.inward);
            self.claim(footprint(frame, width, depth), 0.04, tall).then_some(frame)
        })
    }

    /// A free place in the open, `margin` metres from everything; the frame's origin is the lower left corner.
    fn in_the_open(&mut self, width: f32, depth: f32, margin: f32) -> Option<Frame> {
        (0..200).find_map(|attempt| {
            let free = (self.room.rect().size() - Vec2::new(width, depth)).max(Vec2::ZERO);
            // Near the middle first, anywhere later.
            let spread = attempt as f32 / 200.0;
            let at = Vec2::new(self.random.range(-0.5, 0.5), self.random.range(-0.5, 0.5)) * spread + 0.5;
            let origin = self.room.lo + free * at;
            let frame = Frame::facing(origin.extend(0.0), Vec3::Y);
            self.claim(footprint(frame, width, depth), margin, false).then_some(frame)
        })
    }

    /// Door leaves, opened at a right angle into this room, for the doorways that it is the second room of.
    fn door_leaves(&mut self) {
        let room = self.room.rect();
        for opening in self.layout.openings.clone() {
            if opening.rooms.1 != Some(self.index) || opening.plan.size().max_element() > 1.0 {
                continue;
            }
            for wall in Wall::of(room) {
                let Some(cut) = wall.cut(&opening) else { continue };
                let width = cut.size().x - 0.05;
                let hinge = wall.origin + wall.right * (cut.hi.x + 0.06) + wall.inward * 0.01;
                let frame = Frame::facing(hinge, wall.inward);
                let plan = footprint(frame, 0.04, width);
                if plan.lo.cmpge(room.lo).all() && plan.hi.cmple(room.hi).all() {
                    let look =
                        self.look(Paint { pattern: Pattern::Panels { width: 2.0 }, ..self.palette.trim }, class::DOOR);
                    self.block(look, frame, [0.0, 0.0, 0.01], [0.04, width, cut.hi.y - 0.02], Faces::ALL);
                    let knob = self.look(self.palette.metal, class::DOOR);
                    for x in [-0.03, 0.07] {
                        ball(self.out, knob, frame.moved(Vec3::new(x, width - 0.07, 1.05)), 0.028);
                    }
                    self.blocked.push(plan.grown(0.25));
                }
            }
        }
    }

    fn sofa(&mut self) {
        let Some(frame) = self.against_wall(2.1, 0.9, false) else { return };
        self.seat(frame, 2.1, 0.9, 3);
    }

    fn armchair(&mut self) {
        let Some(frame) = self.against_wall(0.9, 0.85, false) else { return };
        self.seat(frame, 0.9, 0.85, 1);
    }

    /// A sofa of `seats` seats with its back to the wall.
    fn seat(&mut self, frame: Frame, width: f32, depth: f32, seats: usize) {
        let fabric = self.look(self.palette.fabric, class::SOFA);
        let cushion = self.look(self.palette.cushion, class::SOFA);
        let arm = 0.17;
        let upright = Faces::STANDING;
        self.block(fabric, frame, [0.0, 0.0, 0.0], [arm, depth, 0.6], upright);
        self.block(fabric, frame, [width - arm, 0.0, 0.0], [width, depth, 0.6], upright);
        let between = upright.without(Faces::LEFT).without(Faces::RIGHT);
        self.block(fabric, frame, [arm, 0.0, 0.0], [width - arm, 0.2, 0.82], upright);
        self.block(fabric, frame, [arm, 0.2, 0.0], [width - arm, depth - 0.03, 0.28], between.without(Faces::BACK));
        let each = (width - 2.0 * arm) / seats as f32;
        for i in 0..seats {
            let x = arm + each * i as f32;
            let faces = Faces::STANDING.without(Faces::BACK);
            self.block(fabric, frame, [x + 0.006, 0.2, 0.28], [x + each - 0.006, depth - 0.01, 0.44], faces);
            let plush = Vec2::new(x + 0.5 * each - 0.21, x + 0.5 * each + 0.21);
            self.block(cushion, frame, [plush.x, 0.2, 0.442], [plush.y, 0.33, 0.79], Faces::ALL.without(Faces::BACK));
        }
    }

    fn screen(&mut self) {
        let fit = [1.7, 1.5].into_iter().find_map(|width| Some((width, self.against_wall(width, 0.42, true)?)));
        let Some((width, frame)) = fit else { return };
        let fronts = self.look(self.palette.fronts, class::CABINET);
        let screen = self.look(self.palette.screen, class::SCREEN);
        let metal = self.look(self.palette.metal, class::SCREEN);
        self.block(fronts, frame, [0.0, 0.0, 0.0], [width, 0.42, 0.48], Faces::STANDING);
        self.block(metal, frame, [0.55, 0.1, 0.48], [0.95, 0.26, 0.5], Faces::STANDING);
        self.block(metal, frame, [0.72, 0.15, 0.5], [0.78, 0.19, 0.56], Faces::STANDING.without(Faces::TOP));
        self.block(screen, frame, [0.2, 0.14, 0.56], [1.3, 0.2, 1.2], Faces::ALL);
        self.vase(frame.moved(Vec3::new(width - 0.13, 0.2, 0.48)), 0.26);
    }

    fn cabinet(&mut self, width: f32, height: f32) {
        let Some(frame) = self.against_wall(width, 0.5, height > 1.2) else { return };
        let fronts = self.look(self.palette.fronts, class::CABINET);
        let top = self.look(self.palette.top, class::CABINET);
        self.block(fronts, frame, [0.0, 0.0, 0.0], [width, 0.48, height], Faces::STANDING.without(Faces::TOP));
        self.block(top, frame, [-0.008, -0.008, height], [width + 0.008, 0.5, height + 0.03], Faces::ALL);
        if height < 1.2 {
            let decor = self.look(self.palette.porcelain, class::DECOR);
            ball(self.out, decor, frame.moved(Vec3::new(0.2, 0.25, height + 0.028 + 0.09)), 0.09);
            self.table_lamp(frame.moved(Vec3::new(width - 0.25, 0.24, height + 0.03)));
        }
    }

    fn bookshelf(&mut self) {
        let (width, depth, height, board) = (1.2, 0.34, 1.96, 0.03);
        let Some(frame) = self.against_wall(width, depth, true) else { return };
        let wood = self.look(self.palette.wood, class::SHELF);
        let inner = width - board;
        let side = Faces::STANDING;
        self.block(wood, frame, [0.0, 0.0, 0.0], [board, depth, height], side);
        self.block(wood, frame, [inner, 0.0, 0.0], [width, depth, height], side);
        let across = Faces::ALL.without(Faces::LEFT).without(Faces::RIGHT);
        self.block(wood, frame, [board, 0.0, 0.06], [inner, 0.015, height], Faces::ALL);
        for level in 0..5 {
            let z = 0.06 + 0.46 * level as f32;
            self.block(wood, frame, [board, 0.015, z], [inner, depth - 0.01, z + board], across.without(Faces::BACK));
            if level < 4 {
                self.books(frame.moved(Vec3::new(board, 0.015, z + board)), inner - board);
            }
        }
    }

    /// A row of books over part of a shelf, and sometimes an ornament beside it.
    fn books(&mut self, frame: Frame, width: f32) {
        let length = width * self.random.range(0.45, 0.95);
        let paint = Paint::new(Pattern::Books, Vec3::splat(0.3), Vec3::new(0.6, 0.5, 0.25), 0.45, self.random.seed());
        let look = self.look(paint, class::DECOR);
        let from = self.random.range(0.01, 0.02);
        let height = self.random.range(0.28, 0.36);
        self.block(look, frame, [from, 0.03, 0.0], [from + length - 0.02, 0.25, height], Faces::STANDING);
        if width - length > 0.3 {
            self.vase(frame.moved(Vec3::new(0.5 * (length + width), 0.16, 0.0)), 0.24);
        }
    }

    /// A turned vase, closed at the bottom by what it stands on.
    fn vase(&mut self, frame: Frame, height: f32) {
        let shape = [(0.45, 0.0), (0.75, 0.2), (0.8, 0.4), (0.55, 0.65), (0.3, 0.8), (0.4, 1.0)];
        let profile: Vec<(f32, f32)> = shape.iter().map(|&(r, z)| (r * height * 0.45, z * height)).collect();
        let look = self.look(self.palette.porcelain, class::DECOR);
        self.out.push(Chart::revolve(look, frame, &profile, 20));
        let rim = profile[profile.len() - 1];
        self.out.push(Chart::disc(look, frame.moved(Vec3::Z * rim.1), rim.0, 20, false));
    }

    fn plant(&mut self) {
        let Some(frame) = self.against_wall(0.5, 0.5, true) else { return };
        let centre = frame.moved(Vec3::new(0.25, 0.25, 0.0));
        let pot = self.look(self.palette.porcelain, class::DECOR);
        let soil = self.look(Paint::flat(Vec3::new(0.07, 0.05, 0.035), 0.9), class::DECOR);
        self.out.push(Chart::revolve(pot, centre, &[(0.13, 0.0), (0.19, 0.36)], 20));
        self.out.push(Chart::disc(soil, centre.moved(Vec3::Z * 0.36), 0.19, 20, false));
        let leaf = Paint::new(
            Pattern::Mottled,
            Vec3::new(0.07, 0.2, 0.05),
            Vec3::new(0.16, 0.34, 0.08),
            0.4,
            self.random.seed(),
        );
        let leaf = self.look(leaf, class::DECOR);
        let stem = self.look(self.palette.wood, class::DECOR);
        cylinder(self.out, stem, centre.moved(Vec3::Z * 0.36), 0.02, (0.0, 0.4), Faces::ALL.without(Faces::BOTTOM));
        for (offset, radius) in [([0.0, 0.0, 0.82], 0.2), ([0.08, 0.05, 1.07], 0.15), ([-0.07, -0.03, 1.22], 0.11)] {
            ball(self.out, leaf, centre.moved(offset.into()), radius);
        }
    }

    /// A rug with a low table on it.
    fn coffee_corner(&mut self) {
        let Some(frame) = self.in_the_open(1.3, 0.75, 0.35) else { return };
        let rug = self.look(self.palette.rug, class::RUG);
        let reach = frame.moved(Vec3::new(-0.33, -0.33, 0.0));
        self.block(rug, reach, [0.0; 3], [1.96, 1.41, 0.008], Faces::STANDING);
        let wood = self.look(self.palette.wood, class::TABLE);
        let top = self.look(self.palette.top, class::TABLE);
        self.block(top, frame, [0.0, 0.0, 0.39], [1.3, 0.75, 0.43], Faces::ALL);
        self.legs(wood, frame.moved(Vec3::new(0.04, 0.04, 0.008)), Vec2::new(1.22, 0.67), 0.03, 0.382);
        self.vase(frame.moved(Vec3::new(0.35, 0.4, 0.43)), 0.24);
        let globe = self.look(self.palette.porcelain, class::DECOR);
        ball(self.out, globe, frame.moved(Vec3::new(0.95, 0.3, 0.43 + 0.078)), 0.08);
    }

    fn table(&mut self, frame: Frame, size: Vec2) {
        let wood = self.look(self.palette.wood, class::TABLE);
        self.block(wood, frame, [0.0, 0.0, 0.71], [size.x, size.y, 0.75], Faces::ALL);
        self.legs(wood, frame.moved(Vec3::new(0.04, 0.04, 0.0)), size - 0.08, 0.032, 0.71);
    }

    /// A chair centred on `at`, facing the direction `angle` (0: +y) of the world.
    fn chair(&mut self, at: Vec3, angle: f32) {
        let frame = Frame::turned(at, angle).moved(Vec3::new(-0.21, -0.21, 0.0));
        let wood = self.look(self.palette.wood, class::CHAIR);
        let seat = self.look(self.palette.fabric, class::CHAIR);
        self.legs(wood, frame, Vec2::splat(0.42), 0.02, 0.43);
        self.block(seat, frame, [0.0, 0.0, 0.43], [0.42, 0.42, 0.48], Faces::ALL);
        self.block(wood, frame, [0.0, 0.0, 0.5], [0.42, 0.03, 0.92], Faces::ALL);
        for x in [0.04, 0.38] {
            let post = frame.moved(Vec3::new(x, 0.018, 0.48));
            cylinder(self.out, wood, post, 0.012, (0.0, 0.02), Faces::ALL.without(Faces::BOTTOM).without(Faces::TOP));
        }
    }

    fn dining(&mut self) {
        let size = Vec2::new(1.2, 0.8);
        let fit = [0.2, 0.06].into_iter().find_map(|margin| self.in_the_open(size.x, size.y + 0.9, margin));
        let Some(frame) = fit else { return };
        let frame = frame.moved(Vec3::new(0.0, 0.45, 0.0));
        self.table(frame, size);
        for x in [0.32, 0.88] {
            for (y, angle) in [(-0.08, 0.0), (size.y + 0.08, std::f32::consts::PI)] {
                let turn = angle + self.random.range(-0.2, 0.2);
                self.chair(frame.point(Vec3::new(x, y, 0.0)), turn);
            }
        }
        let bowl = self.look(self.palette.porcelain, class::DECOR);
        let centre = frame.moved(Vec3::new(0.6, 0.4, 0.75));
        self.out.push(Chart::revolve(bowl, centre, &[(0.06, 0.0), (0.13, 0.03), (0.17, 0.09)], 20));
        self.out.push(Chart::disc(bowl, centre.moved(Vec3::Z * 0.09), 0.17, 20, false));
        for (i, offset) in
            [Vec2::new(0.0, 0.07), Vec2::new(-0.07, -0.04), Vec2::new(0.06, -0.05)].into_iter().enumerate()
        {
            let colour = [Vec3::new(0.6, 0.3, 0.03), Vec3::new(0.5, 0.05, 0.04), Vec3::new(0.3, 0.45, 0.06)][i];
            let fruit = self.look(Paint::flat(colour, 0.3), class::DECOR);
            ball(self.out, fruit, centre.moved(offset.extend(0.14)), 0.06);
        }
        self.pendant(frame.point(Vec3::new(0.6, 0.4, 0.0)).truncate(), 1.6, 0.11, 24.0);
    }

    fn desk(&mut self) {
        let Some(frame) = self.against_wall(1.5, 0.7, false) else { return };
        self.table(frame, Vec2::new(1.5, 0.7));
        let screen = self.look(self.palette.screen, class::SCREEN);
        self.block(screen, frame, [0.45, 0.12, 0.75], [0.75, 0.3, 0.765], Faces::STANDING);
        self.block(screen, frame, [0.57, 0.18, 0.765], [0.63, 0.22, 0.85], Faces::STANDING.without(Faces::TOP));
        self.block(screen, frame, [0.28, 0.18, 0.85], [0.92, 0.22, 1.22], Faces::ALL);
        self.table_lamp(frame.moved(Vec3::new(1.27, 0.25, 0.75)));
        let at = frame.point(Vec3::new(0.6, 0.8, 0.0));
        let angle = (-frame.y.x).atan2(frame.y.y) + std::f32::consts::PI;
        self.chair(at, angle);
        self.blocked.push(footprint(frame.moved(Vec3::new(0.3, 0.5, 0.0)), 0.6, 0.6));
    }

    fn bed(&mut self) {
        let length = 2.05;
        let fit = [1.5, 1.3, 1.0].into_iter().find_map(|width| Some((width, self.against_wall(width, length, false)?)));
        let Some((width, frame)) = fit else { return };
        let wood = self.look(self.palette.wood, class::BED);
        let linen = self.look(self.palette.linen, class::BED);
        let blanket = self.look(self.palette.fabric, class::BED);
        let pillow = self.look(self.palette.cushion, class::BED);
        self.block(wood, frame, [0.0, 0.0, 0.0], [width, 0.06, 0.8], Faces::STANDING);
        self.block(wood, frame, [0.0, 0.06, 0.0], [width, length, 0.3], Faces::STANDING.without(Faces::BACK));
        self.block(
            linen,
            frame,
            [0.03, 0.06, 0.3],
            [width - 0.03, length - 0.03, 0.5],
            Faces::STANDING.without(Faces::BACK),
        );
        self.block(blanket, frame, [0.015, 0.75, 0.32], [width - 0.015, length - 0.015, 0.535], Faces::ALL);
        for x in [0.08, 0.5 * width + 0.04] {
            self.block(pillow, frame, [x, 0.1, 0.502], [x + 0.5 * width - 0.12, 0.5, 0.62], Faces::ALL);
        }
    }

    fn counter(&mut self) {
        let room = self.room.rect().size();
        for width in [2.6, 2.0, 1.5] {
            if width > room.max_element() - 0.2 {
                continue;
            }
            let Some(frame) = self.against_wall(width, 0.62, true) else { continue };
            let fronts = self.look(self.palette.fronts, class::CABINET);
            let top = self.look(self.palette.top, class::CABINET);
            let metal = self.look(self.palette.metal, class::CABINET);
            self.block(fronts, frame, [0.0, 0.0, 0.0], [width, 0.6, 0.86], Faces::STANDING.without(Faces::TOP));
            self.block(top, frame, [-0.006, -0.006, 0.86], [width + 0.006, 0.62, 0.9], Faces::ALL);
            self.block(metal, frame, [0.2, 0.1, 0.9], [0.75, 0.52, 0.906], Faces::STANDING);
            self.block(fronts, frame, [0.0, 0.0, 1.45], [width, 0.34, 2.1], Faces::ALL);
            self.vase(frame.moved(Vec3::new(width - 0.3, 0.3, 0.9)), 0.28);
            let kettle = self.look(self.palette.porcelain, class::DECOR);
            ball(self.out, kettle, frame.moved(Vec3::new(0.98, 0.3, 0.898 + 0.1)), 0.1);
            return;
        }
    }

    fn floor_lamp(&mut self) {
        let Some(frame) = self.against_wall(0.42, 0.42, true) else { return };
        let centre = frame.moved(Vec3::new(0.21, 0.21, 0.0));
        let metal = self.look(self.palette.metal, class::LAMP);
        cylinder(self.out, metal, centre, 0.14, (0.0, 0.025), Faces::STANDING);
        cylinder(self.out, metal, centre, 0.014, (0.025, 1.4), Faces::ALL.without(Faces::BOTTOM).without(Faces::TOP));
        self.shade(centre.moved(Vec3::Z * 1.4), 0.17, 0.26, 14.0);
    }

    fn table_lamp(&mut self, frame: Frame) {
        let body = self.look(self.palette.porcelain, class::LAMP);
        let profile = [(0.05, 0.0), (0.075, 0.06), (0.05, 0.14), (0.015, 0.2)];
        self.out.push(Chart::revolve(body, frame, &profile, 20));
        self.shade(frame.moved(Vec3::Z * 0.2), 0.11, 0.16, 18.0);
    }

    /// A glowing, closed lampshade that stands on the frame's origin.
    fn shade(&mut self, frame: Frame, radius: f32, height: f32, radiance: f32) {
        let look = self.look(Paint::light(self.palette.warm * radiance), class::LAMP);
        self.out.push(Chart::revolve(look, frame, &[(radius, 0.0), (radius * 0.8, height)], 20));
        self.out.push(Chart::disc(look, frame.moved(Vec3::Z * height), radius * 0.8, 20, false));
        self.out.push(Chart::disc(look, frame, radius, 20, true));
    }

    /// A glowing ball on a cord.
    fn pendant(&mut self, at: Vec2, height: f32, radius: f32, radiance: f32) {
        let frame = Frame::facing(at.extend(0.0), Vec3::Y);
        let metal = self.look(self.palette.metal, class::LAMP);
        let light = self.look(Paint::light(self.palette.warm * radiance), class::LAMP);
        let cord = Faces::ALL.without(Faces::BOTTOM).without(Faces::TOP);
        cylinder(self.out, metal, frame, 0.008, (height + radius - 0.002, CEILING), cord);
        let rose = Faces::ALL.without(Faces::TOP);
        cylinder(self.out, metal, frame, 0.05, (CEILING - 0.025, CEILING), rose);
        ball(self.out, light, frame.moved(Vec3::Z * height), radius);
    }

    fn pendants(&mut self, count: usize) {
        let (rect, along) = (self.room.rect(), self.room.rect().size());
        let axis = if along.x > along.y { Vec2::X } else { Vec2::Y };
        for i in 0..count {
            let part = (i as f32 + 0.5) / count as f32 - 0.5;
            let radiance = self.random.range(42.0, 55.0);
            self.pendant(rect.centre() + axis * part * along, 2.15, 0.1, radiance);
        }
    }

    /// A flat ceiling lamp.
    fn panel(&mut self) {
        let centre = self.room.rect().centre();
        let frame = Frame::facing((centre - Vec2::new(0.3, 0.2)).extend(0.0), Vec3::Y);
        let metal = self.look(self.palette.metal, class::LAMP);
        let light = self.look(Paint::light(self.palette.warm * 24.0), class::LAMP);
        let hung = Faces::ALL.without(Faces::TOP);
        self.block(metal, frame, [0.0, 0.0, CEILING - 0.05], [0.6, 0.4, CEILING], hung);
        self.block(light, frame, [0.02, 0.02, CEILING - 0.065], [0.58, 0.38, CEILING - 0.05], hung);
    }

    /// Small, bright lamps in the ceiling.
    fn spots(&mut self) {
        let (rect, metal) = (self.room.rect(), self.look(self.palette.metal, class::LAMP));
        let light = self.look(Paint::light(self.palette.warm * 140.0), class::LAMP);
        for part in [Vec2::new(0.25, 0.25), Vec2::new(0.75, 0.25), Vec2::new(0.25, 0.75), Vec2::new(0.75, 0.75)] {
            let frame = Frame::facing((rect.lo + rect.size() * part).extend(0.0), Vec3::Y);
            let hung = Faces::ALL.without(Faces::TOP);
            cylinder(self.out, metal, frame, 0.07, (CEILING - 0.04, CEILING), hung);
            cylinder(self.out, light, frame, 0.05, (CEILING - 0.05, CEILING - 0.04), hung);
        }
    }

    /// Pictures where walls are free at eye level.
    fn pictures(&mut self) {
        for wall in Wall::of(self.room.rect()) {
            for _ in 0..2 {
                let (width, height) = (self.random.range(0.45, 1.0), self.random.range(0.4, 0.65));
                let at = self.random.range(0.15, (wall.length - width - 0.15).max(0.2));
                let near = wall.origin + wall.right * at;
                let far = wall.origin + wall.right * (at + width) + wall.inward * 0.2;
                let (a, b) = (near.truncate(), far.truncate());
                let plan = Rect::new(a.min(b), a.max(b));
                let touches = |other: &Rect| other.overlaps(&plan.grown(0.06));
                let opening = self.layout.openings.iter().any(|o| o.touches(self.index) && touches(&o.plan.grown(0.1)));
                if at + width > wall.length || opening || self.views.iter().chain(&self.tall).any(touches) {
                    continue;
                }
                self.tall.push(plan);
                self.picture(Frame::facing(wall.origin + wall.right * (at + width), wall.inward), width, height);
            }
        }
    }

    fn picture(&mut self, frame: Frame, width: f32, height: f32) {
        let (z, rim) = (1.62 - 0.5 * height, 0.025);
        let wood = self.look(self.palette.wood, class::PICTURE);
        let (a, b) = (muted(self.random), Vec3::splat(0.62));
        let gloss = self.random.range(0.08, 0.5);
        let art = Paint::new(Pattern::Picture, a, b, gloss, self.random.seed());
        let art = self.look(art, class::PICTURE);
        let flat = Faces::ALL.without(Faces::BACK);
        self.block(wood, frame, [0.0, 0.0, z], [width, 0.02, z + height], flat);
        self.block(art, frame, [rim, 0.02, z + rim], [width - rim, 0.028, z + height - rim], flat);
    }
}

/// A muted random colour.
fn muted(random: &mut Random) -> Vec3 {
    super::paint::hue(random.unit()).lerp(Vec3::ONE, 0.2) * random.range(0.25, 0.5)
}

/// The plan rectangle of `width` × `depth` from a frame's origin.
fn footprint(frame: Frame, width: f32, depth: f32) -> Rect {
    let a = frame.origin.truncate();
    let b = frame.point(Vec3::new(width, depth, 0.0)).truncate();
    Rect::new(a.min(b), a.max(b))
}
