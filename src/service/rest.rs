//! The rest of a stack, for the unit tests of a single service.

use heapless::Vec;

use super::statustext::TextCursor;
use super::{Cx, Service, Shared, Turn};
use crate::dialect::{Common, Statustext};
use crate::frame::{Decoder, Frame};
use crate::link::{Outbox, Port};
use crate::message::Dialect;
use crate::network::PeerInfo;
use crate::time::Instant;
use crate::types::{
    Credits, EventEntry, EventLog, Firmware, LinkId, LinkMask, NoPlans, PlansMut, RequestQueue, Requests, StatusTexts,
    TextEntry, TextKind, TextNumber,
};

/// The data that a service uses besides its own state, the vehicle and the parameters: two normal links, no plans.
#[derive(Debug)]
pub(crate) struct Rest {
    pub(crate) shared: Shared,
    pub(crate) peers: Vec<PeerInfo, 4>,
    pub(crate) texts: StatusTexts<[TextEntry; 8]>,
    pub(crate) requests: Requests<[RequestQueue; 0]>,
    pub(crate) events: EventLog<[EventEntry; 0]>,
}

impl Rest {
    pub(crate) fn new() -> Self {
        let normal = LinkMask::of(LinkId(0)).with(LinkMask::of(LinkId(1)));
        let shared = Shared { normal, ..Shared::VACANT };
        Self { shared, peers: Vec::new(), texts: StatusTexts::new(), requests: Requests::NONE, events: EventLog::EMPTY }
    }

    pub(crate) fn cx<'a, F: Firmware<Plans = NoPlans, Credits = [Credits; 0]>>(
        &'a mut self,
        now: Instant,
        parameters: &'a mut F::Parameters,
        vehicle: &'a mut F::Vehicle,
    ) -> Cx<'a, F> {
        Cx {
            now,
            shared: &mut self.shared,
            peers: self.peers.as_mut_view(),
            texts: &mut self.texts,
            requests: &mut self.requests,
            events: &mut self.events,
            plans: PlansMut::none(),
            parameters,
            credits: (),
            vehicle,
        }
    }
}

/// Makes a service send the frame that is due in a turn, as the stack does. Returns false if none is.
pub(crate) fn offer<F: Firmware, S: Service<F>>(
    service: &mut S,
    cx: &mut Cx<'_, F>,
    port: &mut Port,
    link: &mut S::Link,
    turn: Turn,
) -> bool {
    match service.pending(&cx.view(), port, link, turn) {
        Some((at, reply)) if at <= cx.now => service.send(cx, port, link, reply),
        _ => false,
    }
}

/// Decodes a frame.
pub(crate) fn with_frame<R>(bytes: &[u8], handle: impl FnOnce(&Frame<'_>) -> R) -> R {
    let mut decoder = Decoder::default();
    let _ = decoder.push(bytes, Instant::ZERO);
    let frame = decoder.next(Instant::ZERO, Common::MESSAGES, &mut u32::MAX.clone(), |_| true);
    handle(&frame.expect("a whole frame"))
}

/// Takes the bytes that a link sends.
pub(crate) fn take(tx: &mut Outbox) -> std::vec::Vec<u8> {
    let bytes = tx.pending().to_vec();
    tx.advance(bytes.len());
    bytes
}

/// Returns the texts that a link sends.
pub(crate) fn sent_texts(texts: &mut StatusTexts, tx: &mut Outbox) -> std::vec::Vec<std::string::String> {
    let mut cursor = TextCursor::at(TextNumber::NONE);
    core::iter::from_fn(|| {
        let sent = texts.next(&mut cursor, tx, TextKind::Any);
        sent.then(|| with_frame(&take(tx), |frame| frame.decode::<Statustext>().expect("STATUSTEXT").text))
    })
    .map(|text| text.as_str().expect("UTF-8").into())
    .collect()
}
