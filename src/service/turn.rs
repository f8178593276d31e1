//! The order in which the services send on a link.
//!
//! [`turns!`] is the only list of that order. Sending, `next_deadline`, the table in `docs/architecture.md` and the
//! test of D-4 derive from it. HEARTBEAT is first, so that nothing delays it (H-15), and high-latency links have no
//! turn for it (H-7, L-3). The list of parameters has two turns, so that streams that fill a link leave it its share
//! (P-11), and so has the bulk data of files, logs and log streaming, which high-latency links do not carry (F-8, F-11,
//! LOG-8, LOG-14).

use crate::link::{Pace, Traffic};
use crate::types::LinkClass;

/// Passes the ordered list of turns to a macro. Each turn has its service, its pace, the class of link that has it, the
/// messages that it sends, and a description of when it sends.
macro_rules! turns {
    ($callback:ident) => {
        $callback! {
            Heartbeat heartbeat Stalled Normal "HEARTBEAT" "at once";
            ExtraHeartbeat heartbeat Room Normal "HEARTBEAT after a change of the state, or on request" "with room";
            ComponentHeartbeat components AtOnce Normal "HEARTBEAT of the firmware's other components" "at once, after the autopilot's";
            CommandAck command AtOnce Every "COMMAND_ACK" "at once";
            CommandProgress command Room Normal "COMMAND_ACK with the progress of a running command" "with room";
            MissionAck mission AtOnce Normal "MISSION_ACK" "at once";
            SigningText signing AtOnce Normal "STATUSTEXT that answers SETUP_SIGNING" "at once";
            Time time Room Normal "PING, TIMESYNC" "with room";
            HighLatency high_latency Stalled HighLatency "HIGH_LATENCY2" "at once";
            UrgentText statustext Room Normal "STATUSTEXT or EVENT of severity CRITICAL or higher" "with room";
            MissionTransfer mission Room Normal "MISSION_REQUEST_INT or MISSION_REQUEST, MISSION_COUNT, MISSION_ITEM_INT or MISSION_ITEM" "with room";
            ParamAnswer param Room Normal "PARAM_ERROR, PARAM_VALUE" "with room";
            Text statustext Room Normal "STATUSTEXT" "with room";
            Identity identity Room Normal "AUTOPILOT_VERSION, PROTOCOL_VERSION" "with room";
            Request stream Room Normal "MESSAGE_INTERVAL, the vehicle's messages on request" "with room";
            Camera camera Room Normal "CAMERA_INFORMATION, CAMERA_SETTINGS, STORAGE_INFORMATION, VIDEO_STREAM_INFORMATION, VIDEO_STREAM_STATUS, CAMERA_IMAGE_CAPTURED, CAMERA_CAPTURE_STATUS" "with room";
            Client client Room Normal "COMMAND_LONG, COMMAND_INT, COMMAND_CANCEL, PARAM_REQUEST_READ, PARAM_EXT_REQUEST_READ" "with room";
            OperatorControl operator_control Room Normal "COMMAND_LONG that tells the owner of a request, CONTROL_STATUS" "with room";
            Gimbal gimbal_manager Room Normal "GIMBAL_MANAGER_INFORMATION; GIMBAL_MANAGER_STATUS after a change; GIMBAL_DEVICE_SET_ATTITUDE, AUTOPILOT_STATE_FOR_GIMBAL_DEVICE, COMMAND_LONG to a gimbal device" "with room";
            GimbalDevice gimbal_device Room Normal "GIMBAL_DEVICE_INFORMATION" "with room";
            Answer own Room Normal "answers of services of other crates" "with room";
            CurrentMode mode Room Normal "CURRENT_MODE, AVAILABLE_MODES_MONITOR" "with room";
            MissionProgress mission Room Normal "MISSION_ITEM_REACHED, MISSION_CURRENT" "with room";
            ModeList mode Room Normal "AVAILABLE_MODES" "with room";
            FileAnswer files Room Normal "FILE_TRANSFER_PROTOCOL without data" "with room";
            Event events Room Normal "EVENT, CURRENT_EVENT_SEQUENCE, RESPONSE_EVENT_ERROR" "with room, at half of its rate";
            Message messages Room Normal "the vehicle's own messages" "with room, at half of its rate";
            ExtParam ext_parameters Room Normal "PARAM_EXT_ACK, PARAM_EXT_VALUE" "with room; values at 40 % of its rate";
            LateParamList param Room Normal "the list of all parameters" "with room, if its next value has waited for 20 ms";
            LateBulk bulk Room Normal "FILE_TRANSFER_PROTOCOL with data; LOG_ENTRY, LOG_DATA; LOGGING_DATA_ACKED, LOGGING_DATA" "with room, if they are 20 ms behind their 30 % of its rate";
            ForwardedFirst forwarding Idle Normal "a forwarded frame" "idle, if streams have had more of it";
            GimbalStatus gimbal_manager Idle Normal "GIMBAL_MANAGER_STATUS" "idle";
            GimbalAttitude gimbal_device Idle Normal "GIMBAL_DEVICE_ATTITUDE_STATUS" "idle";
            Stream stream Idle Normal "streams" "idle";
            Report own Idle Normal "periodic messages of services of other crates" "idle";
            Forwarded forwarding Idle Every "forwarded frames" "idle";
            ParamList param Room Normal "the list of all parameters" "with room, at 40 % of its rate";
            Bulk bulk Idle Normal "FILE_TRANSFER_PROTOCOL with data; LOG_ENTRY, LOG_DATA; LOGGING_DATA_ACKED, LOGGING_DATA" "idle";
        }
    };
}
pub(crate) use turns;

macro_rules! define {
    ($($turn:ident $service:ident $pace:ident $class:ident $messages:literal $when:literal;)*) => {
        /// A place in the sending order of a link (D-4). When a link can take a frame, the first turn with something to
        /// send sends one. [`Answer`](Self::Answer) and [`Report`](Self::Report) are for services of other crates. Bulk
        /// data has two turns, `LateBulk` and `Bulk`: a service has both or neither, and `pending` and `send` are the
        /// same in both.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Turn { $(
            #[doc = concat!($messages, ": ", $when)]
            $turn,
        )* }

        impl Turn {
            /// Returns a set of turns, a bit each.
            pub(crate) const fn bits(turns: &[Self]) -> u64 {
                let (mut bits, mut rest) = (0, turns);
                while let [turn, others @ ..] = rest {
                    bits |= turn.bit();
                    rest = others;
                }
                let both = Self::LateBulk.bit() | Self::Bulk.bit();
                assert!(bits & both == 0 || bits & both == both, "bulk data has two turns: `LateBulk` and `Bulk`");
                bits
            }

            /// Returns the turn's bit in a set of turns. Each poll asks for hundreds, in `const` blocks: as calls they took half of its time in
            /// builds without link-time optimisation.
            #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called")]
            pub(crate) const fn bit(self) -> u64 {
                1_u64.wrapping_shl(self as u32)
            }

            /// Returns how busy the link may be.
            pub(crate) const fn pace(self) -> Pace {
                match self { $(Self::$turn => Pace::$pace,)* }
            }

            /// Returns the turns that a link of this class has when it is so busy, a bit each.
            pub(crate) const fn allowed(class: LinkClass, pace: Pace) -> u64 {
                let mut bits = 0;
                $(if Self::$turn.is_on(class) && Self::$turn.pace().is_at_most(pace) {
                    bits |= const { Self::$turn.bit() };
                })*
                bits
            }

            /// The turns of streams and forwarded frames, a bit each.
            pub(crate) const STREAMS: u64 = {
                let mut bits = 0;
                $(if Self::$turn.is_stream() {
                    bits |= Self::$turn.bit();
                })*
                bits
            };

            /// Returns a set of turns, without those that are not [shared](Self::SHARED), in 32 bits.
            #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; the shared turns fit")]
            pub(crate) const fn shared(turns: u64) -> u32 {
                (turns & Self::SHARED).wrapping_shr(Self::SHARED.trailing_zeros()) as u32
            }

            /// The reverse of [`shared`](Self::shared).
            #[allow(clippy::as_conversions, reason = "const fn: `From` cannot be called; u32 to u64")]
            pub(crate) const fn of_shared(turns: u32) -> u64 {
                (turns as u64).wrapping_shl(Self::SHARED.trailing_zeros())
            }

            /// Whether it sends streams or forwarded frames, which have at least half of a busy link together.
            pub(crate) const fn is_stream(self) -> bool {
                self.traffic().is_stream()
            }

            /// Returns the kind of its traffic, as the link's rate is shared.
            pub(crate) const fn traffic(self) -> Traffic {
                match self {
                    Self::Stream | Self::Report | Self::GimbalStatus | Self::GimbalAttitude => Traffic::Stream,
                    Self::ForwardedFirst => Traffic::ForwardedFirst,
                    Self::Forwarded => Traffic::Forwarded,
                    Self::MissionTransfer => Traffic::Plan,
                    Self::LateParamList | Self::ParamList | Self::LateBulk | Self::Bulk => Traffic::Transfer,
                    _ => Traffic::Answer,
                }
            }

            /// Whether it sends signs of life: they stop with the flight loop, and in a fault (H-5).
            pub(crate) const fn is_sign_of_life(self) -> bool {
                matches!(self, Self::Heartbeat | Self::ExtraHeartbeat | Self::ComponentHeartbeat | Self::HighLatency)
            }

            /// Whether a link of this class has this turn.
            pub(crate) const fn is_on(self, class: LinkClass) -> bool {
                let on = match self { $(Self::$turn => On::$class,)* };
                match on {
                    On::Normal => !class.is_high_latency(),
                    On::HighLatency => class.is_high_latency(),
                    On::Every => true,
                }
            }
        }

        /// The order as a table of text: turn, service, messages, when. `docs/architecture.md` shows it.
        #[cfg(test)]
        pub(crate) const TABLE: &[(Turn, &str, &str, &str)] =
            &[$((Turn::$turn, stringify!($service), $messages, $when)),*];
    };
}

/// The classes of links that have a turn.
enum On {
    Normal,
    HighLatency,
    Every,
}

turns!(define);

impl Turn {
    /// The turns in which a service sends on all links what a request on one of them has changed.
    pub(crate) const BY_SERVICES: u64 = Self::bits(&[
        Self::ParamAnswer,
        Self::Camera,
        Self::OperatorControl,
        Self::Gimbal,
        Self::Answer,
        Self::CurrentMode,
        Self::MissionProgress,
        Self::ExtParam,
    ]);

    /// The turns with what hooks have requested.
    pub(crate) const BY_HOOKS: u64 = Self::bits(&[Self::Request, Self::Client, Self::Message]);

    /// The turns in which a link may send because of a request on another one. Then they share a tenth of a busy link.
    pub(crate) const SHARED: u64 = Self::BY_SERVICES | Self::BY_HOOKS | Self::Text.bit() | Self::Event.bit();
}

const _: () = assert!(
    Turn::of_shared(Turn::shared(Turn::SHARED)) == Turn::SHARED,
    "the shared turns are close together, so that 32 bits hold them"
);

#[cfg(test)]
mod tests {
    use std::format;
    use std::string::String;

    use super::*;

    /// The guide shows the order as it is.
    #[test]
    fn the_page_shows_the_turns() {
        let links = |turn: Turn| match [LinkClass::Normal, LinkClass::HighLatency].map(|class| turn.is_on(class)) {
            [true, true] => "all",
            [true, false] => "normal",
            _ => "high-latency",
        };
        let mut table = String::from("| | turn | service | messages | links | when |\n|---|---|---|---|---|---|\n");
        for (number, (turn, service, messages, when)) in (1..).zip(TABLE) {
            table += &format!("| {number} | `{turn:?}` | `{service}` | {messages} | {} | {when} |\n", links(*turn));
        }
        let page = include_str!("../../docs/architecture.md");
        let (_, behind) = page.split_once("<!-- turns -->\n").expect("the page has a place for the table");
        let (shown, _) = behind.split_once("<!-- end of turns -->").expect("the place has an end");
        assert!(
            shown.trim() == table.trim(),
            "docs/architecture.md shows another order than `turns!`: put these rows between its markers\n\n{table}"
        );
    }
}
