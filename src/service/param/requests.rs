//! Handlers of the received requests, and the reasons for refusals (P-10 to P-15, P-19 to P-21, P-30 to P-32).

use core::borrow::Borrow;

use super::hash::Hash;
use super::replies::{List, Refusal};
use super::table::{Rows, Table};
use super::{Handled, Options, ParamEncoding, ParamHash, ParamInfo, Received, TEXT_PAUSE, value};
use crate::dialect::{MavParamError, MavParamType, MavSeverity, ParamRequestList, ParamRequestRead, ParamSet};
use crate::message::{Message, Text};
use crate::time::Instant;
use crate::types::{LinkId, LinkMask, ONE_FRAME, Peer, StatusTexts};

impl<R: Rows> Table<'_, R> {
    /// Handles a request. Returns `Err` with an index if it is a PARAM_SET of a parameter that exists: the caller makes the
    /// resulting value pending on all normal links, whatever it is (P-14). With the index comes a value if it is a different, valid
    /// one: before that, the caller asks the vehicle, sets it, and calls [`on_decided`](Self::on_decided).
    pub(super) fn on_request(
        &mut self,
        now: Instant,
        texts: &mut StatusTexts,
        options: Options,
        list: &mut List,
        received: &Received<'_>,
    ) -> Result<Handled, (u16, Option<u32>)> {
        match received.frame.id() {
            // It has nothing to list (P-18).
            ParamRequestList::ID if self.count() == 0 => Ok(Handled::Yes),
            ParamRequestList::ID => {
                let is_first = list.begin(now);
                // A client that restarts the list did not use the hash (P-10).
                if is_first && options.hash == ParamHash::InList {
                    self.queue_hash(received.from.link);
                }
                Ok(Handled::Yes)
            }
            ParamRequestRead::ID => Ok(self.on_read(now, texts, options, received)),
            _ => self.on_set(now, texts, options, list, received),
        }
    }

    /// Handles PARAM_REQUEST_READ (P-13).
    fn on_read(&mut self, now: Instant, texts: &mut StatusTexts, options: Options, received: &Received<'_>) -> Handled {
        let (read, from) = (ParamRequestRead::decode(received.frame.payload()), received.from);
        let name = wire_name(&read.param_id);
        let found = match u16::try_from(read.param_index) {
            Ok(index) => self.get(index).map(|_| index),
            Err(_) if options.is_hash(&name) => {
                self.queue_hash(received.from.link);
                return Handled::Yes;
            }
            Err(_) => self.find(&name),
        };
        let Some(index) = found else {
            let index = read.param_index.max(-1);
            let why = (Asked::Read(index), MavParamError::DOES_NOT_EXIST);
            return self.refuse(now, texts, options, from, why, &name);
        };
        self.mark_pending(index, LinkMask::of(from.link));
        Handled::Yes
    }

    /// Handles PARAM_SET up to the vehicle's decision (P-14).
    fn on_set(
        &mut self,
        now: Instant,
        texts: &mut StatusTexts,
        options: Options,
        list: &mut List,
        received: &Received<'_>,
    ) -> Result<Handled, (u16, Option<u32>)> {
        let (set, from) = (ParamSet::decode(received.frame.payload()), received.from);
        if set.target_system == 0 {
            // It would set the parameter on every vehicle in range.
            return Ok(Handled::OutOfPlace);
        }
        let name = wire_name(&set.param_id);
        if options.is_hash(&name) {
            // A client that has all values needs no list. No answer: QGroundControl would take it for a new hash, and set it
            // again.
            list.end();
            self.state.hash_pending = self.state.hash_pending.without(LinkMask::of(from.link));
            return Ok(Handled::Yes);
        }
        if self.state.refusals.is_full(from.link) {
            return Ok(Handled::NoRoom);
        }
        let Some((index, (info, old))) = self.find(&name).and_then(|index| Some((index, self.get(index)?))) else {
            let why = (Asked::Set, MavParamError::DOES_NOT_EXIST);
            return Ok(self.refuse(now, texts, options, from, why, &name));
        };
        match check(info.borrow(), options.encoding, &set) {
            Ok(bits) => Err((index, Some(bits).filter(|bits| *bits != old))),
            Err(why) => {
                self.refuse(now, texts, options, from, why, &name);
                Err((index, None))
            }
        }
    }

    /// Answers a PARAM_SET that was carried out or refused: queues the refusal, for which there is a free slot (P-14).
    pub(super) fn on_decided(
        &mut self,
        now: Instant,
        texts: &mut StatusTexts,
        options: Options,
        from: Peer,
        index: u16,
        verdict: Result<(), MavParamError>,
    ) {
        match verdict {
            Ok(()) => event!("parameter {=u16} set by {}", index, from),
            Err(error) => {
                let Some((info, _)) = self.get(index) else { return };
                let info: &ParamInfo = info.borrow();
                self.refuse(now, texts, options, from, (Asked::Set, error), info.wire_name());
            }
        }
    }

    /// Marks the hash as pending on a client's link, and computes it again: a client must not get a hash from before, when a link
    /// that takes nothing still waits for it. A computation that a link waits for goes on.
    fn queue_hash(&mut self, link: LinkId) {
        if self.state.hash_pending.is_empty() || self.state.hash.is_ready(&self.rows) {
            self.state.hash = Hash::new();
        }
        self.state.hash_pending = self.state.hash_pending.with(LinkMask::of(link));
    }

    /// Queues a PARAM_ERROR. Clients that do not know it get a text too: after a PARAM_SET, and where PARAM_ERROR is not
    /// available, as in MAVLink 1 (P-31, P-32).
    fn refuse(
        &mut self,
        now: Instant,
        texts: &mut StatusTexts,
        options: Options,
        from: Peer,
        (asked, error): (Asked, MavParamError),
        name: &[u8; 16],
    ) -> Handled {
        let index = if let Asked::Read(index) = asked { index } else { -1 };
        let has_error = options.has_errors;
        if has_error && !self.state.refusals.push(Refusal { to: from, error, index, name: *name }) {
            return Handled::NoRoom;
        }
        if let Some(refused) = self.state.refused.count(now) {
            event!("parameter of {} refused: {=u8}; {=u32} refused so far", from, error.0, refused);
        }
        let has_text = !has_error || !matches!(asked, Asked::Read(_));
        if cfg!(feature = "plan-texts") && has_text && now >= self.state.texts_from {
            self.state.texts_from = now + TEXT_PAUSE;
            let text = if asked == Asked::SetUnclear { ": firmware should declare it i32" } else { reason(error) };
            warn(now, texts, from.link, text, name);
        }
        Handled::Yes
    }
}

/// What was asked for, and refused.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// A value, by this index; -1 by name.
    Read(i16),
    /// A change.
    Set,
    /// A change of a parameter with 8 or 16 bits to something that is not an integer (P-19).
    SetUnclear,
}

/// Returns the value that a PARAM_SET requests, or the reason to refuse it.
fn check(info: &ParamInfo, encoding: ParamEncoding, set: &ParamSet) -> Result<u32, (Asked, MavParamError)> {
    let refused = |error| Err((Asked::Set, error));
    let (sent, ours) = (set.param_type, info.param_type());
    if !value::is_supported(sent) {
        return refused(MavParamError::TYPE_UNSUPPORTED);
    }
    // With casts, a client need not know the type. Neither does MAVProxy after `param ftp`, and sends REAL32 (P-19).
    let is_cast = encoding == ParamEncoding::CCast || sent == MavParamType::REAL32;
    let (encoding, named) = if is_cast { (ParamEncoding::CCast, ours) } else { (encoding, sent) };
    if ours == MavParamType::REAL32 && named != ours {
        return refused(MavParamError::TYPE_MISMATCH);
    } else if info.is_read_only() {
        return refused(MavParamError::READ_ONLY);
    }
    let mut asked = Asked::Set;
    let bits = if ours == MavParamType::REAL32 {
        Some(set.param_value.to_bits())
    } else {
        let integer = value::from_wire(encoding, named, set.param_value);
        if integer.is_none() && !is_cast && value::size(ours) < 4 {
            asked = Asked::SetUnclear;
        }
        // A client may know the parameter from another autopilot, as an integer of another size.
        integer.and_then(|(from, bits)| value::converted(from, ours, bits))
    };
    // Not clamped: a client that reads back a different value sets it again, and fails (P-14).
    bits.filter(|bits| info.has_room(*bits)).ok_or((asked, MavParamError::VALUE_OUT_OF_RANGE))
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
