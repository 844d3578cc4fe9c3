//! Rays that wait to be traced, with what they carry home: generations of mirror rays, and shadow rays.
//!
//! Memory is kept from tile to tile; packets are filled again rather than made anew.

use super::RenderSettings;
use super::ledger::Account;
use super::light_layers::{Source, with_step};
use super::memory::Memory;
use super::meter::Accounts;
use super::travel::{MediaColumn, Travel, TravelPacket, Travels};
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3, Ray};
use crate::optics::InteriorStack;
use crate::scene::EffectSet;

/// Packets that are traced and shaded together: 24 KB of rays, half of a first-level cache.
pub(super) const BATCH: usize = 16;

/// Whose light a lane's ray carries.
#[derive(Clone)]
pub(super) struct PathPacket {
    /// Pixel within the tile's film.
    pub(super) pixel: Lanes<u32>,
    /// What its radiance is multiplied by, linear RGB.
    pub(super) weight: Lanes3<f32>,
}

impl PathPacket {
    const EMPTY: PathPacket = PathPacket {
        pixel: [0; LANES],
        weight: [[0.0; LANES]; 3],
    };
}

/// A ray to trace and what it is for.
pub(super) struct Sent {
    pub(super) ray: Ray,
    pub(super) pixel: u32,
    pub(super) weight: [f32; 3],
    /// What sent it, and so what it is booked under if it is of all wavelengths.
    pub(super) sender: Account,
    /// In scenes whose paths keep one.
    pub(super) travel: Option<Travel>,
}

/// How many rays of a generation are of which sort; the others are mirrored by smooth surfaces and of all wavelengths.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sorts {
    /// Gone through a surface, of all wavelengths.
    pub(super) refracted: u64,
    /// Gone through a surface, of one wavelength.
    pub(super) refracted_colors: u64,
    /// Mirrored, of one wavelength.
    pub(super) mirrored_colors: u64,
    /// Of the lobes of opaque surfaces, of all wavelengths.
    pub(super) rough_reflected: u64,
    /// Of the lobes of surfaces that light goes through, of all wavelengths.
    pub(super) rough_refracted: u64,
    /// Of lobes, of one wavelength.
    pub(super) rough_colors: u64,
}

impl Sorts {
    #[inline(always)]
    fn count(&mut self, sent: &Sent) {
        let is_color = sent.account() == Account::Dispersion;
        match (sent.sender, is_color) {
            (Account::RoughReflection | Account::RoughRefraction, true) => self.rough_colors += 1,
            (Account::RoughReflection, false) => self.rough_reflected += 1,
            (Account::RoughRefraction, false) => self.rough_refracted += 1,
            (Account::Refraction, true) => self.refracted_colors += 1,
            (Account::Refraction, false) => self.refracted += 1,
            (_, true) => self.mirrored_colors += 1,
            (_, false) => {}
        }
    }
}

impl Sorts {
    /// How many of all `rays` of the generation each account sent.
    pub(super) fn accounts(&self, rays: u64) -> [(Account, u64); 5] {
        let colors = self.mirrored_colors + self.refracted_colors + self.rough_colors;
        let rough = self.rough_reflected + self.rough_refracted;
        [
            (
                Account::Reflection,
                rays.saturating_sub(self.refracted + rough + colors),
            ),
            (Account::Refraction, self.refracted),
            (Account::RoughReflection, self.rough_reflected),
            (Account::RoughRefraction, self.rough_refracted),
            (Account::Dispersion, colors),
        ]
    }
}

impl Sent {
    fn account(&self) -> Account {
        match self.travel {
            Some(travel) if travel.wavelength != 0.0 => Account::Dispersion,
            _ => self.sender,
        }
    }
}

/// Rays of one step of the tree. Packets are kept to be filled again.
pub(super) struct Generation {
    packets: Vec<RayPacket>,
    paths: Vec<PathPacket>,
    travels: Travels,
    /// Packets in use.
    count: usize,
    /// Lanes in use of the last of them.
    filled: usize,
    sorts: Sorts,
    /// What each ray is booked under, where pixels' costs are counted or effects told apart.
    accounts: Option<Vec<Lanes<Account>>>,
}

impl Generation {
    /// For rays of these effects, whose paths may know how wide they are.
    pub(super) fn new(effects: EffectSet, follows_widths: bool) -> Generation {
        Generation {
            packets: Vec::new(),
            paths: Vec::new(),
            travels: Travels::new(effects, follows_widths),
            count: 0,
            filled: LANES,
            sorts: Sorts::default(),
            accounts: None,
        }
    }

    /// The same, with the account of each ray if `settings` ask for pixels' costs or for what
    /// each effect gives.
    pub(super) fn with_accounts(self, settings: &RenderSettings) -> Generation {
        Generation {
            accounts: (settings.cost_aovs || settings.light_layers.effects).then(Vec::new),
            ..self
        }
    }

    /// Forgets all rays.
    pub(super) fn clear(&mut self) {
        self.count = 0;
        self.filled = LANES;
        self.sorts = Sorts::default();
        self.travels.clear();
    }

    /// Writes into the labels of rays that are the first steps of their paths which steps those are.
    ///
    /// Where rays go on through what is not there, a path may have taken none yet.
    pub(super) fn label_steps(&mut self, effects: EffectSet) {
        let Some(accounts) = &self.accounts else { return };
        for (packet, accounts) in accounts.iter().enumerate().take(self.count) {
            let lanes = if packet + 1 == self.count {
                self.filled
            } else {
                LANES
            };
            for l in 0..lanes {
                if effects.has_sheets() && self.travels.at(packet).lane(l).depth == 0 {
                    continue;
                }
                let label = &mut self.paths[packet].pixel[l];
                *label = with_step(*label, accounts[l]);
            }
        }
    }

    /// What sorts of rays have been pushed one by one.
    pub(super) fn sorts(&self) -> Sorts {
        self.sorts
    }

    /// Packets in use.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Bytes of a packet and of what it carries.
    pub(super) const PACKET_BYTES: usize = size_of::<RayPacket>() + size_of::<PathPacket>();

    /// Bytes of the packets, in use or not, and of what they carry.
    pub(super) fn byte_count(&self) -> usize {
        self.packets.capacity() * size_of::<RayPacket>() + self.paths.capacity() * size_of::<PathPacket>()
    }

    /// Adds what is kept beside the packets.
    pub(super) fn add_columns_to(&self, memory: &mut Memory, effects: EffectSet) {
        self.travels.add_to(memory, effects);
        let accounts = self.accounts.as_ref().map_or(0, Vec::capacity);
        memory.add(
            "other",
            "accounts of rays",
            accounts * size_of::<Lanes<Account>>(),
        );
    }

    /// The packets in use and their paths.
    pub(super) fn parts(&mut self) -> (&mut [RayPacket], Paths<'_>) {
        let paths = Paths {
            paths: &self.paths[..self.count],
            travels: &self.travels,
            accounts: self.accounts.as_deref(),
            first: 0,
        };
        (&mut self.packets[..self.count], paths)
    }

    /// Writes what lane `l` of the packet pushed last has behind it.
    pub(super) fn set_travel(&mut self, l: usize, travel: &Travel) {
        self.travels.resize(self.count);
        self.travels.set(self.count - 1, l, travel);
    }

    /// The packet pushed last.
    pub(super) fn last_packet(&mut self) -> &mut RayPacket {
        &mut self.packets[self.count - 1]
    }

    /// A fresh packet with its paths.
    #[inline(always)]
    pub(super) fn push_packet(&mut self) -> (&mut RayPacket, &mut PathPacket) {
        if self.count == self.packets.len() {
            self.packets.push(RayPacket::EMPTY);
            self.paths.push(PathPacket::EMPTY);
        }
        let last = self.count;
        self.count += 1;
        self.packets[last].recycle();
        (&mut self.packets[last], &mut self.paths[last])
    }

    /// One more ray, behind the last.
    #[inline(always)]
    pub(super) fn push(&mut self, sent: &Sent) {
        if self.filled == LANES {
            self.push_packet();
            self.filled = 0;
        }
        let (last, lane) = (self.count - 1, self.filled);
        self.packets[last].set(lane, &sent.ray);
        self.paths[last].pixel[lane] = sent.pixel;
        for channel in 0..3 {
            self.paths[last].weight[channel][lane] = sent.weight[channel];
        }
        self.sorts.count(sent);
        if let Some(accounts) = &mut self.accounts {
            accounts.resize(self.count.max(accounts.len()), [Account::Reflection; LANES]);
            accounts[last][lane] = sent.account();
        }
        if let Some(travel) = sent.travel {
            self.packets[last].time[lane] = travel.time;
            self.set_travel(lane, &travel);
        }
        self.filled += 1;
    }
}

/// The paths of some packets.
#[derive(Clone, Copy)]
pub(super) struct Paths<'a> {
    paths: &'a [PathPacket],
    travels: &'a Travels,
    accounts: Option<&'a [Lanes<Account>]>,
    /// The packet of the generation that comes first.
    first: usize,
}

impl<'a> Paths<'a> {
    /// Those of packet `index`; what they have behind them, where some effect needs to know.
    #[inline(always)]
    pub(super) fn at(&self, index: usize) -> (&'a PathPacket, Option<TravelPacket<'a>>) {
        let packet = self.first + index;
        let travels = (!self.travels.is_void()).then(|| self.travels.at(packet));
        (&self.paths[packet], travels)
    }

    /// The labels of packet `index`, and what its rays are booked under: `otherwise` where that is not kept for each.
    pub(super) fn whose(&self, index: usize, otherwise: Account) -> (&'a Lanes<u32>, Accounts<'a>) {
        let packet = self.first + index;
        let accounts = match self.accounts.and_then(|accounts| accounts.get(packet)) {
            Some(accounts) => Accounts::Each(accounts),
            None => Accounts::All(otherwise),
        };
        (&self.paths[packet].pixel, accounts)
    }

    /// Those from packet `first` on.
    pub(super) fn from(&self, first: usize) -> Paths<'a> {
        Paths {
            first: self.first + first,
            ..*self
        }
    }
}

/// Shadow rays that wait to be traced, with the radiance that each contributes if nothing occludes it.
pub(super) struct ShadowQueue {
    packets: [RayPacket; BATCH],
    payloads: [ShadowPayload; BATCH],
    /// The bodies around the shaded points.
    media: MediaColumn,
    /// Packets in use.
    count: usize,
    /// The light that each packet is sent to; not written in scenes with plain effects only.
    sources: [Source; BATCH],
}

/// The pixels that a packet of shadow rays contributes to, and the unoccluded radiance.
#[derive(Clone)]
pub(super) struct ShadowPayload {
    pub(super) pixel: Lanes<u32>,
    pub(super) radiance: Lanes3<f32>,
}

impl ShadowQueue {
    /// Returns an empty queue for shadow rays of these effects.
    pub(super) fn new(effects: EffectSet) -> Box<ShadowQueue> {
        let mut media = MediaColumn::new(effects);
        media.resize(BATCH);
        Box::new(ShadowQueue {
            packets: std::array::from_fn(|_| RayPacket::EMPTY),
            payloads: std::array::from_fn(|_| ShadowPayload {
                pixel: [0; LANES],
                radiance: [[0.0; LANES]; 3],
            }),
            media,
            count: 0,
            sources: [Source::Emission; BATCH],
        })
    }

    /// Bytes of the packets and payloads.
    pub(super) const BYTES: usize = size_of::<ShadowQueue>();

    /// Adds the bytes of the optional columns.
    pub(super) fn add_columns_to(&self, memory: &mut Memory) {
        self.media.add_to(memory);
    }

    /// Returns whether there is no room for another packet.
    pub(super) fn is_full(&self) -> bool {
        self.count == BATCH
    }

    /// Returns memory for one more packet, which counts once [`ShadowQueue::commit`] is called.
    pub(super) fn next(&mut self) -> (&mut RayPacket, &mut ShadowPayload) {
        (&mut self.packets[self.count], &mut self.payloads[self.count])
    }

    /// Sets the light that the packet committed next is sent to.
    pub(super) fn set_source(&mut self, source: Source) {
        self.sources[self.count] = source;
    }

    /// Returns the light that each packet was sent to.
    pub(super) fn sources(&self) -> [Source; BATCH] {
        self.sources
    }

    /// Adds the packet last written to the queue.
    pub(super) fn commit(&mut self) {
        self.count += 1;
    }

    /// Sets the bodies around the points of the packet last committed.
    pub(super) fn set_media(&mut self, travels: TravelPacket) {
        for l in 0..LANES {
            self.media.set(self.count - 1, l, &travels.media(l));
        }
    }

    /// Sets the bodies around all points of the packet that is committed next.
    pub(super) fn set_medium(&mut self, media: &InteriorStack) {
        for l in 0..LANES {
            self.media.set(self.count, l, media);
        }
    }

    /// Empties the queue as [`ShadowQueue::drain`] does, and returns the bodies around the points too.
    pub(super) fn drain_with_media(&mut self) -> (&mut [RayPacket], &mut [ShadowPayload], &mut MediaColumn) {
        let count = std::mem::take(&mut self.count);
        (
            &mut self.packets[..count],
            &mut self.payloads[..count],
            &mut self.media,
        )
    }

    /// Empties the queue and returns its packets and their payloads.
    pub(super) fn drain(&mut self) -> (&mut [RayPacket], &mut [ShadowPayload]) {
        let count = std::mem::take(&mut self.count);
        (&mut self.packets[..count], &mut self.payloads[..count])
    }
}
