//! What a path has behind it, beyond its weight, in columns: one for each thing that some effect needs to know.
//!
//! A scene without bodies has no column of bodies, one without filtered textures none of widths. Columns hold a packet's
//! sixteen lanes side by side.

use glam::DVec3;

use super::memory::Memory;
use crate::numeric::{LANES, Lanes};
use crate::optics::{Body, InteriorStack};
use crate::scene::{Effect, EffectSet};
use crate::shading::ray_cone::Cone;

/// What one path has behind it.
#[derive(Clone, Copy)]
pub(super) struct Travel {
    /// Reflections and refractions.
    pub(super) depth: u32,
    /// The wavelength that it follows, nanometres; 0 for all.
    pub(super) wavelength: f32,
    /// Unit direction, before it was rounded to the ray's.
    pub(super) direction: DVec3,
    /// The bodies around it.
    pub(super) media: InteriorStack,
    /// How wide it is.
    pub(super) cone: Cone,
    /// Which of its pixel's samples it is a part of. Rays into one lobe count as so many samples.
    pub(super) sample: u32,
    /// Of how many rays into the lobe of the surface that the eye sees it is one; 1 if that sent no others.
    pub(super) split: u32,
    /// When its rays are sent, as in [`crate::numeric::Ray::time`].
    pub(super) time: f32,
}

impl Travel {
    /// Of a path that has not begun.
    pub(super) const NONE: Travel = Travel {
        depth: 0,
        wavelength: 0.0,
        direction: DVec3::ZERO,
        media: InteriorStack::EMPTY,
        cone: Cone {
            width: 0.0,
            spread: 0.0,
        },
        sample: 0,
        split: 1,
        time: 0.0,
    };
}

/// What the paths of some packets have behind them, as far as the effects need it.
pub(super) struct Travels {
    depth: Column<u32>,
    wavelength: Column<f32>,
    direction: Column<DVec3>,
    media: MediaColumn,
    cone: Column<Cone>,
    sample: Column<u32>,
    split: Column<u32>,
    time: Column<f32>,
}

impl Travels {
    /// Columns for these effects, and for widths if paths follow them.
    pub(super) fn new(effects: EffectSet, follows_widths: bool) -> Travels {
        Travels {
            depth: Column::new(effects.has_sheets()),
            wavelength: Column::new(effects.has(Effect::Dispersion)),
            direction: Column::new(effects.has(Effect::Refraction)),
            media: MediaColumn::new(effects),
            cone: Column::new(follows_widths),
            sample: Column::new(effects.samples_light()),
            split: Column::new(effects.has_lobes()),
            time: Column::new(effects.has(Effect::MotionBlur)),
        }
    }

    /// Whether there is nothing to know.
    pub(super) fn is_void(&self) -> bool {
        // Every other column is only there with the first of these.
        !(self.depth.is_kept || self.cone.is_kept || self.sample.is_kept || self.time.is_kept)
    }

    /// Forgets all packets.
    pub(super) fn clear(&mut self) {
        self.resize(0);
    }

    /// Makes room for `packets` packets; new ones have not begun.
    pub(super) fn resize(&mut self, packets: usize) {
        self.depth.resize(packets, 0);
        self.wavelength.resize(packets, 0.0);
        self.direction.resize(packets, DVec3::ZERO);
        self.media.resize(packets);
        self.cone.resize(packets, Travel::NONE.cone);
        self.sample.resize(packets, 0);
        self.split.resize(packets, Travel::NONE.split);
        self.time.resize(packets, 0.0);
    }

    /// Writes lane `l` of packet `packet`.
    pub(super) fn set(&mut self, packet: usize, l: usize, travel: &Travel) {
        self.depth.set(packet, l, travel.depth);
        self.wavelength.set(packet, l, travel.wavelength);
        self.direction.set(packet, l, travel.direction);
        self.media.set(packet, l, &travel.media);
        self.cone.set(packet, l, travel.cone);
        self.sample.set(packet, l, travel.sample);
        self.split.set(packet, l, travel.split);
        self.time.set(packet, l, travel.time);
    }

    /// Adds what the columns hold, each to the effect that needs it.
    pub(super) fn add_to(&self, memory: &mut Memory, effects: EffectSet) {
        let through = effects.lets_through().name();
        memory.add(through, "steps of paths", self.depth.byte_count());
        let wavelengths = self.wavelength.byte_count();
        memory.add(Effect::Dispersion.name(), "wavelengths of paths", wavelengths);
        let directions = self.direction.byte_count();
        memory.add(Effect::Refraction.name(), "directions of paths", directions);
        self.media.add_to(memory);
        memory.add(
            Effect::TextureFilter.name(),
            "widths of paths",
            self.cone.byte_count(),
        );
        memory.add("sampling", "samples of paths", self.sample.byte_count());
        let lobes = match effects.has(Effect::RoughReflection) {
            true => Effect::RoughReflection,
            false => Effect::RoughRefraction,
        };
        memory.add(lobes.name(), "rays of lobes", self.split.byte_count());
        memory.add(
            Effect::MotionBlur.name(),
            "times of paths",
            self.time.byte_count(),
        );
    }

    /// Those of one packet.
    pub(super) fn at(&self, packet: usize) -> TravelPacket<'_> {
        TravelPacket {
            travels: self,
            packet,
        }
    }
}

/// What the paths of one packet have behind them.
#[derive(Clone, Copy)]
pub(super) struct TravelPacket<'a> {
    travels: &'a Travels,
    packet: usize,
}

impl TravelPacket<'_> {
    /// That of lane `l`; what no effect needs is as if the path had not begun.
    pub(super) fn lane(&self, l: usize) -> Travel {
        let (travels, packet) = (self.travels, self.packet);
        Travel {
            depth: travels.depth.get(packet, l, 0),
            wavelength: travels.wavelength.get(packet, l, 0.0),
            direction: travels.direction.get(packet, l, DVec3::ZERO),
            media: travels.media.get(packet, l),
            cone: self.cone(l),
            sample: self.sample(l),
            split: travels.split.get(packet, l, Travel::NONE.split),
            time: travels.time.get(packet, l, 0.0),
        }
    }

    /// How wide lane `l` is.
    pub(super) fn cone(&self, l: usize) -> Cone {
        self.travels.cone.get(self.packet, l, Travel::NONE.cone)
    }

    /// Which of its pixel's samples lane `l` is a part of.
    pub(super) fn sample(&self, l: usize) -> u32 {
        self.travels.sample.get(self.packet, l, 0)
    }

    /// The bodies around lane `l`.
    pub(super) fn media(&self, l: usize) -> InteriorStack {
        self.travels.media.get(self.packet, l)
    }
}

/// One thing about every lane, or nothing.
struct Column<T> {
    is_kept: bool,
    packets: Vec<Lanes<T>>,
}

impl<T: Copy> Column<T> {
    fn new(is_kept: bool) -> Column<T> {
        Column {
            is_kept,
            packets: Vec::new(),
        }
    }

    fn resize(&mut self, packets: usize, value: T) {
        if self.is_kept {
            self.packets.resize(packets, [value; LANES]);
        }
    }

    fn byte_count(&self) -> usize {
        self.packets.capacity() * size_of::<Lanes<T>>()
    }

    fn set(&mut self, packet: usize, l: usize, value: T) {
        if self.is_kept {
            self.packets[packet][l] = value;
        }
    }

    fn get(&self, packet: usize, l: usize, otherwise: T) -> T {
        if self.is_kept {
            self.packets[packet][l]
        } else {
            otherwise
        }
    }
}

/// The bodies around every lane: none where light goes through none, one where no two can overlap.
pub(super) struct MediaColumn {
    single: Column<Option<Body>>,
    nested: Column<InteriorStack>,
}

impl MediaColumn {
    /// For these effects.
    pub(super) fn new(effects: EffectSet) -> MediaColumn {
        let nests = effects.has(Effect::NestedMedia);
        MediaColumn {
            single: Column::new(effects.has(Effect::Refraction) && !nests),
            nested: Column::new(effects.has(Effect::Refraction) && nests),
        }
    }

    /// Makes room for `packets` packets, new ones outside of all bodies.
    pub(super) fn resize(&mut self, packets: usize) {
        self.single.resize(packets, None);
        self.nested.resize(packets, InteriorStack::EMPTY);
    }

    /// Adds what the columns hold.
    pub(super) fn add_to(&self, memory: &mut Memory) {
        let single = self.single.byte_count();
        memory.add(Effect::Refraction.name(), "the body around each path", single);
        let nested = self.nested.byte_count();
        memory.add(Effect::NestedMedia.name(), "the bodies around each path", nested);
    }

    /// Writes lane `l` of packet `packet`.
    pub(super) fn set(&mut self, packet: usize, l: usize, media: &InteriorStack) {
        self.single.set(packet, l, media.current());
        self.nested.set(packet, l, *media);
    }

    /// The bodies around lane `l` of packet `packet`.
    pub(super) fn get(&self, packet: usize, l: usize) -> InteriorStack {
        match self.single.get(packet, l, None) {
            Some(body) => InteriorStack::of(body),
            None => self.nested.get(packet, l, InteriorStack::EMPTY),
        }
    }
}
