//! Handlers of the received requests, and the reasons for refusals (P-10 to P-15, P-19 to P-21, P-30 to P-32).

use core::borrow::Borrow;

use super::hash::Hash;
use super::info::{ParamInfo, Rows};
use super::list::ParamList;
use super::refusals::ParamRefusal;
use super::table::Table;
use super::value::{self, IntegerBits, ParamEncoding};
use super::vehicle::{ParamHash, ParamOptions};
use crate::dialect::{MavParamError, MavParamType, MavSeverity, ParamRequestList, ParamRequestRead, ParamSet};
use crate::message::{Message, Text};
use crate::service::{Handled, Received};
use crate::time::{Duration, Instant};
use crate::types::{LinkId, LinkMask, ONE_FRAME, Peer, StatusTexts};

/// Minimum time between texts about refusals (P-32).
const TEXT_PAUSE: Duration = Duration::from_secs(1);

/// Whether the service handles the message with this id.
pub(super) const fn handles(id: u32) -> bool {
    matches!(id, ParamRequestRead::ID | ParamRequestList::ID | ParamSet::ID)
}

/// The sender of a request, and how it is answered.
#[derive(Clone, Copy)]
pub(super) struct ParamClient {
    pub(super) now: Instant,
    pub(super) from: Peer,
    /// The options on its link.
    pub(super) options: ParamOptions,
    /// All normal links: a value that changes is sent on each of them.
    pub(super) normal_links: LinkMask,
}

/// The result of a checked request.
pub(super) enum ParamRequest {
    /// Nothing more is to do.
    Handled(Handled),
    /// Requests a different, valid value; there is a slot for a refusal. The owner of the values decides, and
    /// calls [`Table::on_decision`].
    Set { index: u16, bits: u32 },
}

impl<R: Rows> Table<'_, R> {
    /// Handles a request, up to the decision about a PARAM_SET.
    pub(super) fn on_request(
        &mut self,
        texts: &mut StatusTexts,
        client: ParamClient,
        list: &mut ParamList,
        received: &Received<'_>,
    ) -> ParamRequest {
        let handled = match received.frame.id() {
            ParamSet::ID => return self.on_set(texts, client, list, received),
            ParamRequestRead::ID => self.on_read(texts, client, received),
            // PARAM_REQUEST_LIST: without parameters there is nothing to list (P-18).
            _ if self.count() == 0 => Handled::Yes,
            _ => {
                // A client that restarts a list has ignored the hash, so it gets none (P-10).
                let is_restart = list.is_active();
                list.begin(client.now, Some(received.sender()));
                if !is_restart && client.options.hash == ParamHash::InList {
                    self.queue_hash(client.from.link);
                }
                Handled::Yes
            }
        };
        ParamRequest::Handled(handled)
    }

    /// Handles PARAM_REQUEST_READ: queues the value, the hash, or a refusal if there is no such parameter (P-13).
    fn on_read(&mut self, texts: &mut StatusTexts, client: ParamClient, received: &Received<'_>) -> Handled {
        let read = ParamRequestRead::decode(received.frame.payload());
        let name = wire_name(&read.param_id);
        let found = match u16::try_from(read.param_index) {
            Ok(index) => Some(index).filter(|index| *index < self.count()),
            // A negative index: the parameter is requested by name.
            Err(_) if client.options.is_name_of_hash(&name) => {
                self.queue_hash(client.from.link);
                return Handled::Yes;
            }
            Err(_) => self.rows.find(&name),
        };
        let Some(index) = found else {
            let request = RefusedRequest::Read { index: read.param_index.max(-1) };
            return self.refuse(texts, client, Refused { request, error: MavParamError::DOES_NOT_EXIST }, &name);
        };
        self.queue_value(index, LinkMask::of(client.from.link));
        Handled::Yes
    }

    /// Handles PARAM_SET (P-14). Returns [`ParamRequest::Set`] for a valid value that differs from the present one: the
    /// caller decides whether it is set. A refusal, or a value that is set already, is answered here.
    fn on_set(
        &mut self,
        texts: &mut StatusTexts,
        client: ParamClient,
        list: &mut ParamList,
        received: &Received<'_>,
    ) -> ParamRequest {
        let set = ParamSet::decode(received.frame.payload());
        if set.target_system == 0 {
            // A broadcast would set the parameter on every vehicle in range.
            return ParamRequest::Handled(Handled::OutOfPlace);
        }
        let name = wire_name(&set.param_id);
        if client.options.is_name_of_hash(&name) {
            // The client sets the hash to say that it has all values, so it needs no list. It gets no answer: QGroundControl
            // would take the answer for a new hash, and set the hash again. A wrong hash, or one from another client, must
            // not end the list.
            if self.has_hash(set.param_value.to_bits()) && list.is_only_for(received.sender()) {
                list.end();
            }
            return ParamRequest::Handled(Handled::Yes);
        }
        if !self.state.refusals.has_room(client.from.link) {
            // Nothing is set if a refusal, also one by the caller, could not be answered. The client repeats the
            // request.
            return ParamRequest::Handled(Handled::NoRoom);
        }
        let found = self.rows.find(&name).and_then(|index| Some((index, self.get(index)?)));
        let Some((index, (info, present_bits))) = found else {
            let refused = Refused::set(MavParamError::DOES_NOT_EXIST);
            return ParamRequest::Handled(self.refuse(texts, client, refused, &name));
        };
        match requested_bits(info.borrow(), client.options.encoding, &set) {
            Ok(bits) if bits != present_bits => return ParamRequest::Set { index, bits },
            Ok(_) => {}
            Err(refused) => {
                self.refuse(texts, client, refused, &name);
            }
        }
        // The unchanged value is the answer. After a refusal, it follows the PARAM_ERROR.
        self.queue_value(index, client.normal_links);
        ParamRequest::Handled(Handled::Yes)
    }

    /// Handles the caller's decision about a PARAM_SET: queues the value on all normal links, whether or not it has
    /// changed, and a refusal.
    pub(super) fn on_decision(
        &mut self,
        texts: &mut StatusTexts,
        client: ParamClient,
        index: u16,
        decision: Result<(), MavParamError>,
    ) {
        match (decision, self.get(index)) {
            (Err(error), Some((info, _))) => {
                let info: &ParamInfo = info.borrow();
                self.refuse(texts, client, Refused::set(error), info.wire_name());
            }
            _ => event!("parameter {=u16} set by {}", index, client.from),
        }
        self.queue_value(index, client.normal_links);
    }

    /// Returns whether this is the hash, as it was last computed.
    fn has_hash(&self, hash: u32) -> bool {
        let state = &*self.state;
        state.hash.is_ready(&self.rows) && state.hash.sum(&self.rows) == hash
    }

    /// Queues the hash on a client's link. Computes the hash again, unless its computation is in progress for a link. A
    /// hash that was computed earlier may be outdated, and may still be pending on a stalled link.
    fn queue_hash(&mut self, link: LinkId) {
        let state = &mut *self.state;
        let is_in_progress = !state.hash_pending.is_empty() && !state.hash.is_ready(&self.rows);
        if !is_in_progress {
            state.hash = Hash::NEW;
        }
        state.hash_pending = state.hash_pending.with(LinkMask::of(link));
    }

    /// Queues a PARAM_ERROR. Returns [`Handled::NoRoom`] if there is no slot for it: then the request has no effect.
    ///
    /// Clients that do not know PARAM_ERROR get a text too: after a PARAM_SET, and where PARAM_ERROR is not available,
    /// as in MAVLink 1 (P-32).
    fn refuse(&mut self, texts: &mut StatusTexts, client: ParamClient, refused: Refused, name: &[u8; 16]) -> Handled {
        let ParamClient { now, from, options, .. } = client;
        let Refused { request, error } = refused;
        let (index, is_read) = match request {
            RefusedRequest::Read { index } => (index, true),
            RefusedRequest::Set | RefusedRequest::SetUnclear => (-1, false),
        };
        let state = &mut *self.state;
        if options.has_errors && !state.refusals.push(ParamRefusal { to: from, error, index, name: *name }) {
            return Handled::NoRoom;
        }
        if let Some(refused) = state.refusal_log.count(now) {
            event!("parameter of {} refused: {=u8}; {=u32} refused so far", from, error.0, refused);
        }
        // PARAM_ERROR is enough for a read: it sets nothing, so the operator need not know.
        let needs_text = !options.has_errors || !is_read;
        if cfg!(feature = "plan-texts") && needs_text && now >= state.texts_from {
            state.texts_from = now + TEXT_PAUSE;
            let text = match request {
                RefusedRequest::SetUnclear => ": firmware should declare it i32",
                RefusedRequest::Read { .. } | RefusedRequest::Set => reason(error),
            };
            warn(now, texts, from.link, text, name);
        }
        Handled::Yes
    }
}

/// A request that is refused.
#[derive(Clone, Copy)]
enum RefusedRequest {
    /// A read, by this index; -1 by name.
    Read { index: i16 },
    /// A PARAM_SET.
    Set,
    /// A PARAM_SET of an integer of 8 or 16 bits whose value is no integer (P-19).
    SetUnclear,
}

/// A refused request, and the error.
struct Refused {
    request: RefusedRequest,
    error: MavParamError,
}

impl Refused {
    const fn set(error: MavParamError) -> Self {
        Self { request: RefusedRequest::Set, error }
    }
}

/// Returns the value that a PARAM_SET requests.
///
/// # Errors
///
/// The first reason to refuse it: the type of the value, a read-only parameter, or a value that is no number of the
/// parameter's type and range.
fn requested_bits(info: &ParamInfo, encoding: ParamEncoding, set: &ParamSet) -> Result<u32, Refused> {
    let refused = |error| Err(Refused::set(error));
    let (sent, ours) = (set.param_type, info.param_type());
    if !value::is_supported(sent) {
        return refused(MavParamError::TYPE_UNSUPPORTED);
    }
    // With casts, a client need not know the type. MAVProxy does not know it after `param ftp`, and sends REAL32
    // (P-19).
    let is_cast = encoding == ParamEncoding::CCast || sent == MavParamType::REAL32;
    let (encoding, named) = if is_cast { (ParamEncoding::CCast, ours) } else { (encoding, sent) };
    if ours == MavParamType::REAL32 && named != ours {
        return refused(MavParamError::TYPE_MISMATCH);
    }
    if info.is_read_only() {
        return refused(MavParamError::READ_ONLY);
    }
    let mut request = RefusedRequest::Set;
    let bits = if ours == MavParamType::REAL32 {
        Some(set.param_value.to_bits())
    } else {
        let integer = value::from_wire(encoding, named, set.param_value);
        let is_small_type = value::size(ours) < 4;
        if integer.is_none() && !is_cast && is_small_type {
            request = RefusedRequest::SetUnclear;
        }
        // A client may know the parameter from another autopilot, as an integer of another size.
        integer.and_then(|integer| IntegerBits::of(ours).of_integer(integer))
    };
    // The value is not clamped: a client that reads back another value sets its own again, and fails.
    let error = MavParamError::VALUE_OUT_OF_RANGE;
    bits.filter(|bits| info.is_valid(*bits)).ok_or(Refused { request, error })
}

/// Queues a text about a refusal.
pub(super) fn warn(now: Instant, texts: &mut StatusTexts, link: LinkId, why: &str, name: &[u8; 16]) {
    // A name of 16 bytes leaves 34 for the reason.
    let mut text = Text::<ONE_FRAME>::EMPTY;
    text.set(name);
    text.push_str(why);
    texts.push(now, LinkMask::of(link), MavSeverity::WARNING, text.as_bytes());
}

/// Returns a name padded with zeros; bytes after the terminator are dropped.
fn wire_name(text: &Text<16>) -> [u8; 16] {
    let mut name = [0; 16];
    crate::message::zero_extend(text.as_bytes(), &mut name);
    name
}

/// Returns the text for the reason of a refusal.
pub(super) fn reason(error: MavParamError) -> &'static str {
    match error {
        MavParamError::DOES_NOT_EXIST => ": no such parameter",
        MavParamError::VALUE_OUT_OF_RANGE => ": out of range",
        MavParamError::READ_ONLY => ": read-only",
        MavParamError::TYPE_UNSUPPORTED | MavParamError::TYPE_MISMATCH => ": wrong type",
        _ => ": not now",
    }
}
