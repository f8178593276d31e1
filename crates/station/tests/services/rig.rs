//! The boat in a rig.

use mavstack::manual_control::ControlSource;
use mavstack::message::SystemId;
use mavstack::prelude::*;
use mavstack::signing::LinkSigning;
use mavstack_station::kit::{self, Board, Firmware, LineConfig, Port, Rig};
use mavstack_station::{Client, Station};

use crate::vehicle::{Boat, Mavlink, Passed};

/// All stations of the tests. pymavlink sends no heartbeats, so it is no ground station for the vehicle.
const ANYONE: ControlSource = ControlSource::Systems { first: SystemId::new(200), last: SystemId::new(255) };

/// The boat as the rig runs it.
pub struct Tested {
    pub stack: Box<StackOf<Mavlink>>,
    pub boat: Boat,
    pulse: &'static Pulse,
}

impl Tested {
    fn boot(_: &Board) -> Self {
        let pulse = kit::pulse();
        let link = LinkConfig::uart(115_200).with_signing(LinkSigning::OPEN.with_provisioning());
        let mut stack = Box::new(StackOf::<Mavlink>::new(Config::new(Address::new(1, 1), pulse), [link; 2]));
        stack.manual_input_mut().set_source(ANYONE);
        stack.setpoints.set_source(ANYONE);
        Self { stack, boat: Boat { iso: 100, ..Boat::default() }, pulse }
    }
}

impl Firmware for Tested {
    fn fly(&mut self, now: Instant) {
        for buoy in self.boat.passed.drain(..) {
            self.stack.with_context(now, |cx| cx.event(&Passed { buoy }));
        }
        self.pulse.tick();
    }

    fn poll(&mut self, now: Instant, ports: &mut [Port]) {
        self.stack.poll(now, &mut self.boat);
        for (link, port) in (0..).map(LinkId).zip(ports) {
            let _ = self.stack.poll_link(now, link, port, &mut self.boat);
        }
    }
}

/// A pass takes so long.
pub const PASS: Duration = Duration::from_millis(10);

/// Returns the boat with a station on a line that loses frames in both directions.
pub fn rig(station: impl Into<Station>, loss: f64, seed: u64) -> Rig<Tested> {
    Rig::new(Tested::boot).with_line(LineConfig::uart(115_200).with_loss(loss), station).with_seed(seed).with_pass(PASS)
}

/// Returns the boat with two stations of different systems.
pub fn two_stations(client: Client, loss: f64, seed: u64) -> Rig<Tested> {
    let other = Station::new(client).with_address(Address::new(200, client.address().component.wire().max(1)));
    rig(client, loss, seed).with_line(LineConfig::uart(115_200).with_loss(loss), other).with_seed(seed)
}
