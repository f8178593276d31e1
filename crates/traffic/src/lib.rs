//! The aircraft around a vehicle: a service for [`mavstack`], and an example of one that a crate of its own provides.
//!
//! Implements <https://mavlink.io/en/messages/common.html#ADSB_VEHICLE>. An ADS-B receiver on any link reports aircraft. The vehicle
//! keeps the nearest ones and forgets those that were not heard for a minute. A peer that requests ADSB_VEHICLE gets them all.
//!
//! ```text
//!   ADSB_VEHICLE ─▶ known? ── yes ─▶ updated
//!                     └ no ─▶ room? ── yes ─▶ found
//!                               └ no ─▶ nearer than the farthest? ── yes ─▶ that is lost, this is found
//!                                                                    └ no ─▶ counted
//! ```
//!
//! Left out: it does not decide how to avoid an aircraft, and sends no COLLISION. An aircraft without a position counts as the
//! farthest.
//!
//! ```
//! use mavstack::dialect::{MavResult, MavSeverity};
//! use mavstack::prelude::*;
//! use mavstack_traffic::{Aircraft, Position, Traffic, TrafficHooks};
//!
//! struct Rover;
//! # impl Vehicle for Rover { fn state(&self) -> Option<VehicleState> { None } }
//! # impl Commands for Rover {
//! #     fn command(&mut self, _: &mut Context<'_>, _: &Command) -> Outcome { MavResult::UNSUPPORTED.into() }
//! # }
//!
//! impl TrafficHooks for Rover {
//!     fn position(&self) -> Option<Position> {
//!         Some(Position { lat: 473_977_420, lon: 85_455_940, altitude: 488_000 })
//!     }
//!
//!     fn aircraft_found(&mut self, cx: &mut Context<'_>, _: &Aircraft) {
//!         cx.text(MavSeverity::NOTICE, "Aircraft near");
//!     }
//! }
//!
//! #[derive(Stack)]
//! #[stack(vehicle: Rover, links: 2)]
//! struct Mavlink {
//!     /// Up to 16 aircraft, 72 bytes each.
//!     traffic: Traffic<16>,
//! }
//!
//! fn nearest(stack: &StackOf<Mavlink>) -> Option<u32> {
//!     stack.traffic.nearest().map(|aircraft| aircraft.distance)
//! }
//! ```
#![no_std]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects,
        clippy::as_conversions
    )
)]

mod distance;

use mavstack::dialect::{AdsbFlags, AdsbVehicle, MavResult};
use mavstack::service::{
    About, Counters, Cx, Firmware, Handled, Port, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict,
    View,
};
use mavstack::{Context, Duration, Instant, Message};

pub use distance::Position;

/// An aircraft that was not heard for this long is lost.
pub const FORGOTTEN_AFTER: Duration = Duration::from_secs(60);

/// The hooks of a vehicle that declares [`Traffic`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `TrafficHooks`",
    note = "a field of type `Traffic` needs `impl TrafficHooks for {Self}`: write it, or remove the field"
)]
pub trait TrafficHooks {
    /// Returns where the vehicle is; `None` if that is not known. Then the oldest aircraft are kept.
    fn position(&self) -> Option<Position>;

    /// An aircraft is among the nearest for the first time.
    fn aircraft_found(&mut self, cx: &mut Context<'_>, aircraft: &Aircraft) {
        let _ = (cx, aircraft);
    }

    /// An aircraft was not heard for a minute, or nearer ones have taken its place.
    fn aircraft_lost(&mut self, cx: &mut Context<'_>, aircraft: &Aircraft) {
        let _ = (cx, aircraft);
    }
}

/// An aircraft.
#[derive(Clone, Debug)]
pub struct Aircraft {
    /// What was last reported of it. `tslc` is the time since then when it was received (s).
    pub report: AdsbVehicle,
    /// When it was last reported. [`Instant::ZERO`]: the place in the table is free.
    heard: Instant,
    /// The distance from the vehicle when it was last reported (m); [`u32::MAX`] if one of the two positions is not known.
    pub distance: u32,
}

impl Aircraft {
    const NONE: Self = Self { report: NO_REPORT, heard: Instant::ZERO, distance: 0 };

    const fn is_free(&self) -> bool {
        self.heard.as_micros() == 0
    }
}

/// All zero bits, so that a stack with free places takes no flash.
const NO_REPORT: AdsbVehicle = AdsbVehicle::ZERO;

/// Counters of the service. They wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrafficCounters {
    /// Reports of an aircraft without an address.
    pub without_address: u32,
    /// Reports of aircraft that were farther away than all others, while the table was full.
    pub too_far: u32,
    /// Aircraft that were replaced by nearer ones.
    pub evicted: u32,
}

impl Counters for TrafficCounters {
    const NAME: &'static str = "TrafficCounters";

    fn each(&self, mut counter: impl FnMut(&'static str, u32)) {
        counter("without_address", self.without_address);
        counter("too_far", self.too_far);
        counter("evicted", self.evicted);
    }

    fn drops(&self) -> u32 {
        self.without_address.wrapping_add(self.too_far)
    }
}

/// The nearest aircraft, at most `N`: a field of the struct that declares the stack.
#[derive(Debug)]
pub struct Traffic<const N: usize> {
    table: [Aircraft; N],
    counters: TrafficCounters,
}

impl<const N: usize> Traffic<N> {
    /// Returns the aircraft, in no order.
    pub fn aircraft(&self) -> impl Iterator<Item = &Aircraft> {
        self.table.iter().filter(|aircraft| !aircraft.is_free())
    }

    /// Returns the nearest aircraft; `None` if there is none.
    pub fn nearest(&self) -> Option<&Aircraft> {
        self.aircraft().min_by_key(|aircraft| aircraft.distance)
    }

    /// Returns the counters.
    pub const fn counters(&self) -> TrafficCounters {
        self.counters
    }

    /// Returns the place of a reported aircraft: its own, a free one, or that of the farthest if it is nearer.
    fn place_of(&mut self, reported: &Aircraft) -> Option<&mut Aircraft> {
        let address = reported.report.ICAO_address;
        let own = self.table.iter().position(|known| !known.is_free() && known.report.ICAO_address == address);
        let place = own.or_else(|| self.table.iter().position(Aircraft::is_free)).or_else(|| {
            let (place, farthest) = self.table.iter().enumerate().max_by_key(|(_, known)| known.distance)?;
            (farthest.distance > reported.distance).then_some(place)
        });
        place.and_then(|place| self.table.get_mut(place))
    }

    /// Returns the first aircraft from `place` on, and its place.
    fn next_from(&self, place: u8) -> Option<(u8, &Aircraft)> {
        (0..=u8::MAX).zip(&self.table).skip(place.into()).find(|(_, aircraft)| !aircraft.is_free())
    }
}

/// The state of the service on a link: the place of the next aircraft that a peer has asked for.
#[derive(Debug)]
pub struct TrafficLink {
    is_asked: bool,
    next: u8,
}

impl<F: Firmware<Vehicle: TrafficHooks>, const N: usize> Service<F> for Traffic<N> {
    type Link = TrafficLink;
    /// The place of the aircraft that is sent.
    type Reply = u8;

    const NEW: Self = Self {
        table: [const { Aircraft::NONE }; N],
        counters: TrafficCounters { without_address: 0, too_far: 0, evicted: 0 },
    };
    const VACANT: TrafficLink = TrafficLink { is_asked: false, next: 0 };
    const CHECK: () = assert!(N > 0 && N <= 255, "`Traffic<N>` has room for 1 to 255 aircraft: `Traffic<16>`");
    const ABOUT: About = About::AUTOPILOT.in_turns(&[Turn::Answer]);

    /// Forgets aircraft that are no longer heard.
    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, links: impl Iterator<Item = &'l mut TrafficLink>) {
        let now = cx.now();
        for aircraft in &mut self.table {
            if !aircraft.is_free() && now >= aircraft.heard + FORGOTTEN_AFTER {
                let lost = core::mem::replace(aircraft, Aircraft::NONE);
                let (vehicle, mut context) = cx.hook();
                vehicle.aircraft_lost(&mut context, &lost);
            }
        }
        // What a peer has asked for may be gone.
        for link in links {
            link.is_asked &= self.next_from(link.next).is_some();
        }
    }

    fn deadline(&self) -> Instant {
        let oldest = self.aircraft().map(|aircraft| aircraft.heard).min();
        oldest.map_or(Instant::NEVER, |heard| heard + FORGOTTEN_AFTER)
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, _: &mut TrafficLink, received: &Received<'_>) -> Handled {
        let Some(report) = received.frame().decode::<AdsbVehicle>() else { return Handled::No };
        if report.ICAO_address == 0 {
            self.counters.without_address = self.counters.without_address.wrapping_add(1);
            return Handled::Yes;
        }
        let now = cx.now();
        let (vehicle, mut context) = cx.hook();
        let is_placed = report.flags.contains(AdsbFlags::VALID_COORDS);
        let aircraft_at = is_placed.then_some(Position { lat: report.lat, lon: report.lon, altitude: report.altitude });
        let distance = vehicle.position().zip(aircraft_at).map_or(u32::MAX, |(own, other)| own.distance_to(&other));
        let aircraft = Aircraft { report, heard: now.max(Instant::from_micros(1)), distance };
        let Some(place) = self.place_of(&aircraft) else {
            self.counters.too_far = self.counters.too_far.wrapping_add(1);
            return Handled::Yes;
        };
        let before = core::mem::replace(place, aircraft.clone());
        if !before.is_free() && before.report.ICAO_address == aircraft.report.ICAO_address {
            return Handled::Yes;
        }
        if !before.is_free() {
            self.counters.evicted = self.counters.evicted.wrapping_add(1);
            vehicle.aircraft_lost(&mut context, &before);
        }
        vehicle.aircraft_found(&mut context, &aircraft);
        Handled::Yes
    }

    /// MAV_CMD_REQUEST_MESSAGE for ADSB_VEHICLE: each aircraft in a message. DENIED if there is none.
    fn on_command(
        &mut self,
        _: &mut Cx<'_, F>,
        port: &mut Port,
        link: &mut TrafficLink,
        request: &Request,
    ) -> Option<Verdict> {
        if !request.asks_for::<AdsbVehicle>() {
            return None;
        }
        let may_send = request.has_response_target() && !port.class().is_high_latency() && port.takes(AdsbVehicle::ID);
        if !may_send || self.next_from(0).is_none() {
            return Some(MavResult::DENIED.into());
        }
        *link = TrafficLink { is_asked: true, next: 0 };
        Some(MavResult::ACCEPTED.into())
    }

    fn pending(&self, view: &View<'_>, _: &Port, link: &TrafficLink, _: Turn) -> Option<(Instant, u8)> {
        if !link.is_asked {
            return None;
        }
        self.next_from(link.next).map(|(place, _)| (view.now(), place))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, link: &mut TrafficLink, place: u8) -> bool {
        let next = place.saturating_add(1);
        *link = TrafficLink { is_asked: self.next_from(next).is_some(), next };
        let Some(aircraft) = self.table.get(usize::from(place)) else { return false };
        let silent = u8::try_from((cx.now() - aircraft.heard).as_millis() / 1_000).unwrap_or(u8::MAX);
        port.send(&AdsbVehicle { tslc: aircraft.report.tslc.saturating_add(silent), ..aircraft.report })
    }

    /// Peers of a link that is opened again have asked for nothing yet.
    fn on_event(&mut self, event: StackEvent<'_, TrafficLink>) {
        if let StackEvent::Opened(_, link) = event {
            *link = TrafficLink { is_asked: false, next: 0 };
        }
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }
}
