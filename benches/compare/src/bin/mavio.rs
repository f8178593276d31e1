//! Measures the crate mavio without `alloc`.

use mavio::dialects::common::Common;
use mavio::error::{IoError, IoErrorKind};
use mavio::io::{Read, Receiver};
use mavio::protocol::{Endpoint, Frame, MavLinkId, Message, V2, Versionless};
use mavstack_compare::{Peer, SOURCE, Source, run};

struct Mavio;

struct Reader<'a>(Source<'a>);

impl Read<IoError> for Reader<'_> {
    #[inline]
    fn read_exact(&mut self, out: &mut [u8]) -> Result<(), IoError> {
        if self.0.take_exact(out) { Ok(()) } else { Err(IoErrorKind::UnexpectedEof.into()) }
    }
}

#[inline(always)]
fn receive(stream: &[u8], piece: usize, mut each: impl FnMut(&Frame<Versionless>)) {
    let mut receiver: Receiver<IoError, _, Versionless> = Receiver::versionless(Reader(Source::new(stream, piece)));
    while let Ok(frame) = receiver.recv() {
        each(&frame);
    }
}

/// Returns the message inside the enum, as the encoder needs it.
#[inline(always)]
fn inner(message: &Common) -> &dyn Message {
    match message {
        Common::Heartbeat(message) => message,
        Common::SysStatus(message) => message,
        Common::GpsRawInt(message) => message,
        Common::RawImu(message) => message,
        Common::Attitude(message) => message,
        Common::GlobalPositionInt(message) => message,
        Common::RcChannels(message) => message,
        Common::VfrHud(message) => message,
        Common::CommandLong(message) => message,
        Common::CommandAck(message) => message,
        Common::ParamValue(message) => message,
        Common::MissionItemInt(message) => message,
        Common::MissionRequestInt(message) => message,
        Common::Statustext(message) => message,
        _ => unreachable!("not in the stream"),
    }
}

impl Peer for Mavio {
    type Messages = Vec<Common>;

    fn frames(stream: &[u8], piece: usize) -> usize {
        let mut frames = 0;
        receive(stream, piece, |frame| {
            if frame.validate_checksum::<Common>().is_ok() {
                std::hint::black_box(frame);
                frames += 1;
            }
        });
        frames
    }

    fn decode(stream: &[u8]) -> usize {
        let mut frames = 0;
        receive(stream, usize::MAX, |frame| {
            if let Ok(message) = frame.decode::<Common>() {
                std::hint::black_box(&message);
                frames += 1;
            }
        });
        frames
    }

    fn messages(stream: &[u8]) -> Vec<Common> {
        let mut messages = Vec::new();
        receive(stream, usize::MAX, |frame| messages.push(frame.decode().expect("a message")));
        messages
    }

    fn encode(messages: &Vec<Common>, mut each: impl FnMut(&[u8])) {
        let endpoint = Endpoint::v2(MavLinkId::new(SOURCE.0, SOURCE.1));
        let mut out = [0; 280];
        for message in messages {
            let frame: Frame<V2> = endpoint.next_frame(inner(message)).expect("a frame");
            let len = frame.serialize(&mut out).expect("every frame fits");
            each(&out[..len]);
        }
    }

    fn recover(stream: &[u8], mut each: impl FnMut(&[u8])) {
        let mut out = [0; 280];
        receive(stream, 64, |frame| {
            if frame.validate_checksum::<Common>().is_ok() {
                let len = frame.serialize(&mut out).expect("every frame fits");
                each(&out[..len]);
            }
        });
    }
}

fn main() {
    run::<Mavio>();
}
