//! The running log, streamed to a ground station in flight.
//!
//! Implements MAV_CMD_LOGGING_START and MAV_CMD_LOGGING_STOP, LOGGING_DATA, LOGGING_DATA_ACKED and LOGGING_ACK, rules
//! LOG-10 to LOG-14, for logs in the ULog format. The developer guide has no page for them, so they follow PX4
//! (`mavlink_ulog.cpp`) and serve MAVSDK (`log_streaming_impl.cpp`) and PX4's script `mavlink_ulog_streaming.py`.
//!
//! Left out: more than one client at a time, and other formats, which MAVLink does not define.

use super::{About, Cx, Handled, Received, Request, Service, ShowCounters, StackEvent, Turn, Verdict, View, increment};
use crate::dialect::{LoggingAck, LoggingData, LoggingDataAcked, MavCmd, MavResult};
use crate::link::Port;
use crate::message::{Address, Message};
use crate::num;
use crate::time::{Duration, Instant};
use crate::types::{Context, Firmware, LinkId, Peer, Refusal, RefusalReason, Sender, Trust};
use core::num::{Saturating, Wrapping};

/// A stream ends when its client was silent for this time.
const SILENCE: Duration = Duration::from_secs(10);
/// A repeated command to start within this time is a retransmission.
const RETRANSMITTED: Duration = Duration::from_secs(3);
/// The time until an unacknowledged packet is sent again, and how often a packet is sent.
const RESEND: Duration = Duration::from_millis(500);
const TRIES: u8 = 20;
/// How long data waits for more data to fill the packet.
const FILL: Duration = Duration::from_millis(200);

/// The number of bytes of a log in a packet.
const BLOCK: usize = 249;
/// The size of a packet: sequence, target, length and the first message come before the bytes.
const PACKET: usize = 6 + BLOCK;
/// No message begins in a packet.
const NO_MESSAGE: u8 = u8::MAX;
/// The length of the header of a ULog file.
const HEADER: u32 = 16;

/// The hooks of a vehicle that streams its log, for a vehicle that has [`LogStreamer`] in the struct of its
/// [stack](macro@crate::Stack).
///
/// The log is in the [ULog](https://docs.px4.io/main/en/dev_log/ulog_file_format.html) format: a header and
/// definitions, which are the same for the whole log, then data, which is streamed as it is recorded. The stack finds
/// the message boundaries.
#[diagnostic::on_unimplemented(
    message = "`{Self}` does not implement `LogStreaming`",
    note = "`LogStreamer` in the struct of a stack needs `impl LogStreaming for {Self}`: write it, or leave the field out"
)]
pub trait LogStreaming {
    /// Starts a stream of the data that is recorded from now on. Returns ACCEPTED or a refusal. A previous stream has
    /// been stopped before this call.
    fn start_log_stream(&mut self, cx: &mut Context<'_>, from: Peer) -> MavResult;

    /// Ends the stream: the client has stopped it, or is gone.
    fn stop_log_stream(&mut self, cx: &mut Context<'_>);

    /// Reads the log's header and definitions: fills `out`, or its front if they end first, and returns the number of
    /// bytes, at most 249. Returns 0 at their end. After a lost packet, the same part is read again.
    fn read_log_definitions(&mut self, offset: u32, out: &mut [u8]) -> usize;

    /// Returns the number of bytes that are recorded but not streamed yet, as far as known.
    fn log_data_len(&self) -> usize;

    /// Takes the next bytes of data: fills `out`, or its front if there are fewer, and returns the number of bytes, at
    /// most 249. If the link is too slow and the vehicle's buffer overflows, drop whole messages; ULog's message `O`
    /// reports them.
    fn take_log_data(&mut self, out: &mut [u8]) -> usize;
}

counters! {
    /// Counters of log streaming. They wrap.
    StreamingCounters {
        /// Streams that were started.
        count started,
        /// Packets with definitions that were sent again.
        count resent,
        /// Streams that ended because the client was silent, or did not acknowledge the definitions.
        drop timed_out,
        /// Commands to start a stream that were refused because another client had one.
        drop busy,
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StreamPhase {
    Off,
    /// The definitions, one packet at a time. Each is sent until it is acknowledged.
    Definitions,
    Data,
}

/// A message of log streaming.
#[derive(Clone, Copy, Debug)]
pub enum StreamingReply {
    /// LOGGING_DATA_ACKED, until it is acknowledged.
    Definitions,
    /// LOGGING_DATA.
    Data,
}

/// The state of log streaming: `log_streaming: LogStreamer` in the struct of a [stack](macro@crate::Stack). The
/// vehicle's part is [`LogStreaming`].
///
/// ```text
///        LOGGING_START            all definitions are acknowledged
///   off ───────────────▶ definitions ───────────────────────────▶ data
///    ▲                        │                                     │
///    └────────────────────────┴─────────────────────────────────────┘
///      LOGGING_STOP, the client is silent for 10 s, or a packet is not acknowledged for 10 s
/// ```
#[derive(Debug)]
pub struct LogStreamer {
    phase: StreamPhase,
    /// The link of the client was opened again: the next poll ends the stream.
    is_gone: bool,
    /// The client of the last stream. A frame with less proof is another client's (X-1).
    client: Sender,
    started: Instant,
    /// When the client was last heard.
    heard: Instant,
    /// When the next packet is due.
    due: Instant,
    sequence: Wrapping<u16>,
    /// The unacknowledged packet with definitions: its offset, its length, its first message, and how often it was
    /// sent.
    offset: Saturating<u32>,
    len: u8,
    first: u8,
    tries: Saturating<u8>,
    messages: MessageScanner,
    counters: StreamingCounters,
}

/// Finds the beginnings of a log's messages in its bytes.
#[derive(Clone, Copy, Debug)]
struct MessageScanner {
    /// The number of bytes before the next message.
    skip: Saturating<u32>,
    /// The first byte of its size, if that was the last byte.
    size_low: Option<u8>,
}

impl MessageScanner {
    const NEW: Self = Self { skip: Saturating(0), size_low: None };

    /// Processes the next bytes. Returns the offset at which the first message begins; [`NO_MESSAGE`] if none does.
    fn scan(&mut self, bytes: &[u8]) -> u8 {
        let mut first = NO_MESSAGE;
        for (at, byte) in (0..NO_MESSAGE).zip(bytes) {
            if self.skip.0 > 0 {
                self.skip -= 1;
            } else if let Some(low) = self.size_low.take() {
                // The size does not count the byte after it, the type.
                self.skip = Saturating(1) + Saturating(u32::from(u16::from_le_bytes([low, *byte])));
            } else {
                self.size_low = Some(*byte);
                first = first.min(at);
            }
        }
        first
    }
}

impl LogStreamer {
    /// Returns the counters.
    pub const fn counters(&self) -> StreamingCounters {
        self.counters
    }

    /// Returns whether a log is being streamed.
    pub fn is_streaming(&self) -> bool {
        self.phase != StreamPhase::Off
    }

    /// Whether a stream goes to this link.
    fn is_on(&self, port: &Port) -> bool {
        self.is_streaming() && !self.is_gone && self.client.peer.link == port.id
    }
}

impl<F: Firmware<Vehicle: LogStreaming>> Service<F> for LogStreamer {
    type Link = ();
    const VACANT: () = ();
    const ABOUT: About = About { turns: &[Turn::LateBulk, Turn::Bulk], holds: true, ..About::AUTOPILOT };
    type Reply = StreamingReply;
    const NEW: Self = Self {
        phase: StreamPhase::Off,
        is_gone: false,
        client: Sender { peer: Peer { address: Address::new(0, 0), link: LinkId(0) }, trust: Trust::None },
        started: Instant::ZERO,
        heard: Instant::ZERO,
        due: Instant::ZERO,
        sequence: Wrapping(0),
        offset: Saturating(0),
        len: 0,
        first: 0,
        tries: Saturating(0),
        messages: MessageScanner::NEW,
        counters: StreamingCounters::ZERO,
    };

    fn poll<'l>(&mut self, cx: &mut Cx<'_, F>, _: impl Iterator<Item = &'l mut ()>) {
        if self.phase != StreamPhase::Off {
            watch(self, cx);
        }
    }

    fn deadline(&self) -> Instant {
        match self.phase {
            StreamPhase::Off => Instant::NEVER,
            _ if self.is_gone => Instant::ZERO,
            StreamPhase::Definitions if self.tries.0 >= TRIES => self.due.min(self.heard + SILENCE),
            _ => self.heard + SILENCE,
        }
    }

    fn on_frame(&mut self, cx: &mut Cx<'_, F>, _: &mut Port, (): &mut (), received: &Received<'_>) -> Handled {
        if received.frame.id() != LoggingAck::ID {
            return Handled::No;
        }
        let sequence = u16::from_le_bytes([received.frame.byte(0), received.frame.byte(1)]);
        let is_pending = self.phase == StreamPhase::Definitions && self.tries.0 > 0;
        if is_pending && sequence == self.sequence.0 && self.client.is_repeated_by(received.sender()) {
            self.sequence += 1;
            self.offset += u32::from(self.len);
            next_definitions(self, cx);
        }
        Handled::Yes
    }

    fn on_command(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), request: &Request) -> Option<Verdict> {
        let command = &request.command;
        let refuse = |result, reason| Some(Verdict::Refused(Refusal { result, reason }));
        // The system in control takes and ends the stream of any other (X-5).
        let is_owner = F::HAS_CONTROL && cx.shared.controllers.is_owner(command.from.address.system, command.trust);
        let sender = Sender { peer: command.from, trust: command.trust };
        let is_taken = self.phase != StreamPhase::Off && !self.client.is_repeated_by(sender) && !is_owner;
        let result = match command.id {
            MavCmd::LOGGING_START => {
                let [format, ..] = command.params;
                if !format.is_nan() && num::integer(format) != Some(0) {
                    return refuse(MavResult::DENIED, RefusalReason::Param(1));
                }
                if !port.outbox.takes(LoggingData::ID) {
                    MavResult::DENIED
                } else if port.is_stalled() {
                    MavResult::TEMPORARILY_REJECTED
                } else if is_taken && !self.is_gone {
                    increment(&mut self.counters.busy);
                    return refuse(MavResult::TEMPORARILY_REJECTED, RefusalReason::Taken);
                } else {
                    start(self, cx, sender)
                }
            }
            MavCmd::LOGGING_STOP if is_taken => return refuse(MavResult::DENIED, RefusalReason::Taken),
            MavCmd::LOGGING_STOP => {
                stop(self, cx);
                MavResult::ACCEPTED
            }
            _ => return None,
        };
        Some(Verdict::done(result))
    }

    #[inline(always)]
    fn pending(&self, _: &View<'_>, port: &Port, (): &(), _: Turn) -> Option<(Instant, StreamingReply)> {
        let reply = match self.phase {
            StreamPhase::Definitions if self.tries.0 < TRIES => StreamingReply::Definitions,
            StreamPhase::Data => StreamingReply::Data,
            // The next poll ends a stream whose definitions were not acknowledged.
            StreamPhase::Off | StreamPhase::Definitions => return None,
        };
        self.is_on(port).then_some((self.due, reply))
    }

    fn send(&mut self, cx: &mut Cx<'_, F>, port: &mut Port, (): &mut (), reply: StreamingReply) -> bool {
        send(self, cx, port, reply)
    }

    fn counters(&self, show: &mut impl ShowCounters) {
        show.counters(&self.counters);
    }

    fn on_event(&mut self, event: StackEvent<'_, Self::Link>) {
        match event {
            StackEvent::Opened(port, ()) | StackEvent::Stalled(port, ()) => self.is_gone |= self.is_on(port),
            StackEvent::Heard { now, from } if from == self.client.peer => self.heard = now,
            _ => {}
        }
    }
}

/// Ends the stream of a client that is gone (LOG-13), and checks whether there is data.
fn watch<F: Firmware<Vehicle: LogStreaming>>(streamer: &mut LogStreamer, cx: &mut Cx<'_, F>) {
    let gives_up = streamer.phase == StreamPhase::Definitions && streamer.tries.0 >= TRIES && cx.now >= streamer.due;
    if streamer.is_gone {
        stop(streamer, cx);
    } else if gives_up || cx.now >= streamer.heard + SILENCE {
        increment(&mut streamer.counters.timed_out);
        stop(streamer, cx);
    } else if streamer.phase == StreamPhase::Data {
        streamer.due = streamer.due.min(data_due(cx));
    }
}

/// Returns when recorded data is due: a full packet now, less than that after a while.
fn data_due<F: Firmware<Vehicle: LogStreaming>>(cx: &Cx<'_, F>) -> Instant {
    match cx.vehicle.log_data_len() {
        0 => Instant::NEVER,
        len if len >= BLOCK => cx.now,
        _ => cx.now + FILL,
    }
}

/// Starts a stream (LOG-10).
fn start<F: Firmware<Vehicle: LogStreaming>>(
    streamer: &mut LogStreamer,
    cx: &mut Cx<'_, F>,
    from: Sender,
) -> MavResult {
    let is_running = streamer.phase != StreamPhase::Off && !streamer.is_gone;
    if is_running && streamer.client.is_repeated_by(from) && cx.now - streamer.started < RETRANSMITTED {
        return MavResult::ACCEPTED;
    }
    // A client that was restarted needs the definitions again.
    stop(streamer, cx);
    let (vehicle, mut context) = cx.hook();
    let result = vehicle.start_log_stream(&mut context, from.peer);
    if result != MavResult::ACCEPTED {
        return result;
    }
    increment(&mut streamer.counters.started);
    streamer.client = from;
    streamer.started = cx.now;
    streamer.heard = cx.now;
    streamer.sequence.0 = 0;
    streamer.offset.0 = 0;
    streamer.messages = MessageScanner::NEW;
    next_definitions(streamer, cx);
    MavResult::ACCEPTED
}

/// Ends a stream.
fn stop<F: Firmware<Vehicle: LogStreaming>>(streamer: &mut LogStreamer, cx: &mut Cx<'_, F>) {
    if streamer.phase != StreamPhase::Off {
        streamer.phase = StreamPhase::Off;
        streamer.is_gone = false;
        let (vehicle, mut context) = cx.hook();
        vehicle.stop_log_stream(&mut context);
    }
}

/// Schedules the next packet with definitions, or the data if there are no more definitions.
fn next_definitions<F: Firmware<Vehicle: LogStreaming>>(streamer: &mut LogStreamer, cx: &mut Cx<'_, F>) {
    streamer.tries.0 = 0;
    if cx.vehicle.read_log_definitions(streamer.offset.0, &mut [0]) > 0 {
        streamer.phase = StreamPhase::Definitions;
        streamer.due = cx.now;
    } else {
        streamer.phase = StreamPhase::Data;
        streamer.due = data_due(cx);
    }
}

/// Sends a packet (LOG-11, LOG-12).
fn send<F: Firmware<Vehicle: LogStreaming>>(
    streamer: &mut LogStreamer,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    reply: StreamingReply,
) -> bool {
    let is_acked = matches!(reply, StreamingReply::Definitions);
    let info = if is_acked { const { &LoggingDataAcked::INFO } } else { const { &LoggingData::INFO } };
    let is_new = !is_acked || streamer.tries.0 == 0;
    let is_sent = port.outbox.compose(info, |payload: &mut [u8; PACKET]| {
        let Some(data) = payload.last_chunk_mut::<BLOCK>() else { return false };
        data.fill(0);
        let len = match is_acked {
            true => cx.vehicle.read_log_definitions(streamer.offset.0, data),
            false => cx.vehicle.take_log_data(data),
        };
        let bytes = data.get(..len).unwrap_or_default();
        if is_new {
            let is_begin = is_acked && streamer.offset.0 == 0;
            if is_begin {
                streamer.messages.skip.0 = HEADER;
            }
            let first = streamer.messages.scan(bytes);
            streamer.first = if is_begin { 0 } else { first };
            streamer.len = u8::try_from(bytes.len()).unwrap_or(0);
        }
        let [low, high] = streamer.sequence.0.to_le_bytes();
        let Address { system, component } = streamer.client.peer.address;
        if let Some(front) = payload.first_chunk_mut() {
            *front = [low, high, system.wire(), component.wire(), streamer.len, streamer.first];
        }
        len > 0
    });
    if is_acked {
        if streamer.tries.0 > 0 {
            increment(&mut streamer.counters.resent);
        }
        streamer.tries += 1;
        streamer.due = cx.now + RESEND;
    } else {
        streamer.due = data_due(cx);
        if is_sent {
            streamer.sequence += 1;
        }
    }
    is_sent
}
