//! What a client sends by itself to a vehicle that it knows, besides heartbeats.

use crate::station::Sender;
use crate::{Client, Seen};
use mavstack::dialect::{CommandLong, HomePosition, MavAutopilot, MavCmd, MavDataStream, Ping, RequestDataStream};
use mavstack::{Address, Duration, Instant};

/// When MAVSDK pings: at once, and then with this interval.
const PING: Duration = Duration::from_secs(5);
/// When MAVProxy requests the streams.
const STREAMS: Duration = Duration::from_secs(15);
/// When MAVProxy asks for the home position that it does not know.
const HOME: Duration = Duration::from_secs(2);

/// The timers of habits.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Habits {
    ping_due: Instant,
    /// `None` until the vehicle was heard.
    streams_due: Option<Instant>,
    home_due: Option<Instant>,
    leaves_streams_alone: bool,
}

impl Habits {
    /// Never requests the streams.
    pub(crate) fn leave_streams_alone(&mut self) {
        self.leaves_streams_alone = true;
    }

    /// Sends what is due, as [`Station::poll`](crate::Station::poll) says.
    pub(crate) fn poll(&mut self, now: Instant, target: Address, seen: &Seen, sender: &mut Sender) {
        match sender.client {
            Client::Mavsdk => self.ping(now, target, seen, sender),
            Client::MavProxy => {
                if !self.leaves_streams_alone && is_due(&mut self.streams_due, now, STREAMS) {
                    request_streams(now, seen, sender);
                }
                if is_due(&mut self.home_due, now, HOME) && seen.last_from::<HomePosition>(target).is_none() {
                    request_home(now, target, sender);
                }
            }
            Client::QGroundControl | Client::Pymavlink => {}
        }
    }

    /// MAVSDK sends PING to all components, unless the vehicle is ArduPilot. Its sequence number stays 0.
    fn ping(&mut self, now: Instant, target: Address, seen: &Seen, sender: &mut Sender) {
        let heartbeat = seen.component(target).and_then(|component| component.heartbeat);
        let is_ardupilot = heartbeat.is_some_and(|heartbeat| heartbeat.autopilot == MavAutopilot::ARDUPILOTMEGA);
        if now >= self.ping_due && !is_ardupilot {
            self.ping_due = now + PING;
            sender.send(now, &Ping { time_usec: now.as_micros(), ..Ping::default() });
        }
    }
}

/// Whether a timer is due, which it is for the first time after an interval.
fn is_due(due: &mut Option<Instant>, now: Instant, interval: Duration) -> bool {
    let is_due = now >= *due.get_or_insert(now + interval);
    if is_due {
        *due = Some(now + interval);
    }
    is_due
}

/// MAVProxy requests the streams of all components.
fn request_streams(now: Instant, seen: &Seen, sender: &mut Sender) {
    for component in seen.components().filter(|component| component.heartbeat.is_some()) {
        sender.send(
            now,
            &RequestDataStream {
                req_message_rate: 4,
                target_system: component.address.system.wire(),
                target_component: component.address.component.wire(),
                req_stream_id: MavDataStream::ALL,
                start_stop: 1,
            },
        );
    }
}

/// MAVProxy asks all components for the home position.
fn request_home(now: Instant, target: Address, sender: &mut Sender) {
    sender.send(
        now,
        &CommandLong {
            command: MavCmd::GET_HOME_POSITION,
            target_system: target.system.wire(),
            target_component: 0,
            confirmation: 0,
            param1: 0.0,
            param2: 0.0,
            param3: 0.0,
            param4: 0.0,
            param5: 0.0,
            param6: 0.0,
            param7: 0.0,
        },
    );
}
