//! Aircraft that an ADS-B receiver reports.

use mavstack::Context;
use mavstack::dialect::MavSeverity;
use mavstack::message::Text;
use mavstack_traffic::{Aircraft, Position, TrafficHooks};

use super::Quadrotor;

/// Nearer aircraft are reported to the pilot (m).
const NEAR: u32 = 1_000;

impl TrafficHooks for Quadrotor {
    fn position(&self) -> Option<Position> {
        let position = self.global_position()?;
        Some(Position {
            lat: position.latitude,
            lon: position.longitude,
            altitude: (position.altitude * 1_000.0) as i32,
        })
    }

    fn aircraft_found(&mut self, cx: &mut Context<'_>, aircraft: &Aircraft) {
        if aircraft.distance < NEAR {
            let mut text = Text::<50>::EMPTY;
            text.push_str("Aircraft at ");
            text.push_number(aircraft.distance);
            text.push_str(" m");
            cx.text(MavSeverity::WARNING, &text);
        }
    }
}
