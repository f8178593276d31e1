//! A telemetry stream: frames of fourteen common messages, 38 bytes on average.
//!
//! The benchmarks use it too.

use super::Rng;
use mavstack::dialect::*;
use mavstack::frame::{EncodeError, MAX_FRAME_LEN, Version, encode};
use mavstack::{Address, Frame, Message};

macro_rules! mixed {
    ($($message:ident),+ $(,)?) => {
        /// One of the messages of the stream.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[allow(clippy::large_enum_variant, reason = "a benchmark fills it")]
        pub enum Mixed { $($message($message)),+ }

        impl Mixed {
            /// The ids of the messages.
            pub const IDS: &[u32] = &[$($message::ID),+];

            /// Returns a message with random base fields and without extensions.
            pub fn random(rng: &mut Rng) -> Self {
                let mut payload = [0; 255];
                let kind = Self::IDS[rng.below(Self::IDS.len() as u64) as usize];
                $(if kind == $message::ID {
                    payload[..$message::BASE_LEN].fill_with(|| rng.byte());
                    return Self::$message($message::decode(&payload));
                })+
                unreachable!()
            }

            /// Encodes the message as a frame.
            #[inline]
            pub fn encode(&self, source: Address, seq: u8, out: &mut [u8]) -> Result<usize, EncodeError> {
                match self {
                    $(Self::$message(message) => encode(message, Version::V2, source, seq, out),)+
                }
            }

            /// Decodes a frame if it contains one of the messages.
            #[inline(always)]
            pub fn decode(frame: &Frame<'_>) -> Option<Self> {
                match frame.id() {
                    $($message::ID => frame.decode().map(Self::$message),)+
                    _ => None,
                }
            }

            /// Decodes a frame so that every field is used.
            #[inline(always)]
            pub fn read(frame: &Frame<'_>) {
                match frame.id() {
                    $($message::ID => { std::hint::black_box(frame.decode::<$message>()); })+
                    _ => {}
                }
            }
        }
    };
}

mixed! {
    Heartbeat, SysStatus, GpsRawInt, RawImu, Attitude, GlobalPositionInt, RcChannels, VfrHud, CommandLong, CommandAck,
    ParamValue, MissionItemInt, MissionRequestInt, Statustext,
}

/// Returns `count` random messages, the same for the same seed.
pub fn messages(seed: u64, count: usize) -> Vec<Mixed> {
    let mut rng = Rng::new(seed);
    (0..count).map(|_| Mixed::random(&mut rng)).collect()
}

/// Returns the same messages as MAVLink 2 frames from `source`, with consecutive sequence numbers.
pub fn frames(seed: u64, count: usize, source: Address) -> Vec<Vec<u8>> {
    let mut buffer = [0; MAX_FRAME_LEN];
    let frame = |(seq, message): (usize, Mixed)| {
        let len = message.encode(source, seq as u8, &mut buffer).expect("every message fits");
        buffer[..len].to_vec()
    };
    messages(seed, count).into_iter().enumerate().map(frame).collect()
}
