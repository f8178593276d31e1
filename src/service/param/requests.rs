//! Requests as they come in: what each asks of the table, and why not.

use super::replies::Refusal;
use super::{Caller, Context, ParamEncoding, ParamHash, ParamInfo, TEXT_PAUSE, TableMut, Taken, Ways, value};
use crate::dialect::{MavParamError, MavParamType, MavSeverity, ParamRequestList, ParamRequestRead, ParamSet};
use crate::frame::{Frame, Version};
use crate::link::LinkMask;
use crate::message::{Message, Text};
use crate::service::statustext::MAX_TEXT_LEN;

impl TableMut<'_> {
    /// Takes a request, but for setting a parameter to another value that it can have, which is left: its index and the
    /// value.
    pub(super) fn on_request(
        &mut self,
        cx: &mut Context<'_>,
        ways: Ways,
        caller: &mut Caller<'_>,
        frame: &Frame<'_>,
    ) -> Result<Taken, (u16, u32)> {
        match frame.id() {
            ParamRequestList::ID => {
                let is_first = caller.list.begin(cx.now);
                // Who begins again did not want the hash (P-10).
                if is_first && ways.hash == ParamHash::InList {
                    self.owe_hash(caller);
                }
                Ok(Taken::Yes)
            }
            ParamRequestRead::ID => Ok(self.on_read(cx, ways, caller, &ParamRequestRead::decode(frame.payload()))),
            _ => self.on_set(cx, ways, caller, &ParamSet::decode(frame.payload())),
        }
    }

    /// P-13.
    fn on_read(&mut self, cx: &mut Context<'_>, ways: Ways, caller: &mut Caller<'_>, read: &ParamRequestRead) -> Taken {
        let name = wire_name(&read.param_id);
        let found = match u16::try_from(read.param_index) {
            Ok(index) => self.get(index).map(|_| index),
            Err(_) if ways.is_hash(&name) => {
                self.owe_hash(caller);
                return Taken::Yes;
            }
            Err(_) => self.find(&name),
        };
        let Some(index) = found else {
            let index = read.param_index.max(-1);
            return self.refuse(cx, ways, caller, false, (MavParamError::DOES_NOT_EXIST, index), &name);
        };
        self.tell(index, LinkMask::of(caller.from.link));
        Taken::Yes
    }

    /// P-14, up to the vehicle's own word.
    fn on_set(
        &mut self,
        cx: &mut Context<'_>,
        ways: Ways,
        caller: &mut Caller<'_>,
        set: &ParamSet,
    ) -> Result<Taken, (u16, u32)> {
        if set.target_system == 0 {
            // Every vehicle in reach would be set to the same.
            return Ok(Taken::OutOfPlace);
        }
        let name = wire_name(&set.param_id);
        if ways.is_hash(&name) {
            // Who has all values needs no list. No answer: QGroundControl would take it for a new hash, and set it again.
            caller.list.end();
            self.state.hash_owed = self.state.hash_owed.without(LinkMask::of(caller.from.link));
            return Ok(Taken::Yes);
        }
        if self.state.refusals.is_full(caller.from.link) {
            return Ok(Taken::NoRoom);
        }
        let Some((index, (info, old))) = self.find(&name).and_then(|index| Some((index, self.get(index)?))) else {
            return Ok(self.refuse(cx, ways, caller, true, (MavParamError::DOES_NOT_EXIST, -1), &name));
        };
        match check(info, ways.encoding, set) {
            Ok(bits) if bits != old => return Err((index, bits)),
            Ok(_) => self.tell(index, cx.normal),
            Err(error) => self.set_for(cx, ways, caller, (index, old), Err(error)),
        }
        Ok(Taken::Yes)
    }

    /// Sets a parameter, or refuses to, for which there is room. Everybody is told of the value that it has now (P-14).
    pub(super) fn set_for(
        &mut self,
        cx: &mut Context<'_>,
        ways: Ways,
        caller: &Caller<'_>,
        (index, bits): (u16, u32),
        verdict: Result<(), MavParamError>,
    ) {
        let Some((info, _)) = self.get(index) else { return };
        match verdict {
            Ok(()) => {
                event!("parameter {=u16} set by {}", index, caller.from);
                self.put(index, bits);
                self.notice(cx.now);
            }
            Err(error) => {
                self.refuse(cx, ways, caller, true, (error, -1), info.wire_name());
            }
        }
        self.tell(index, cx.normal);
    }

    fn owe_hash(&mut self, caller: &Caller<'_>) {
        self.state.hash_owed = self.state.hash_owed.with(LinkMask::of(caller.from.link));
    }

    /// Owes a PARAM_ERROR. For clients that do not know it there is a text too: when something was to be set, and where there
    /// is nothing else, as in MAVLink 1 (P-31, P-32). Not inlined: a second copy would cost 300 bytes.
    #[inline(never)]
    fn refuse(
        &mut self,
        cx: &mut Context<'_>,
        ways: Ways,
        caller: &Caller<'_>,
        is_set: bool,
        (error, index): (MavParamError, i16),
        name: &[u8; 16],
    ) -> Taken {
        let has_error = ways.has_errors && caller.version != Version::V1;
        if has_error && !self.state.refusals.push(Refusal { to: caller.from, error, index, name: *name }) {
            return Taken::NoRoom;
        }
        event!("parameter of {} refused: {=u8}", caller.from, error.0);
        if cfg!(feature = "plan-texts") && (is_set || !has_error) && cx.now >= self.state.texts_from {
            self.state.texts_from = cx.now.after(TEXT_PAUSE);
            let mut text = [0; MAX_TEXT_LEN];
            crate::message::zero_extend(name, &mut text);
            let mut text = Text::from_wire(text);
            text.push_str(reason(error));
            cx.texts.push(cx.now, LinkMask::of(caller.from.link), MavSeverity::WARNING, &text);
        }
        Taken::Yes
    }
}

/// The value that a PARAM_SET asks for, or why not.
fn check(info: &ParamInfo, encoding: ParamEncoding, set: &ParamSet) -> Result<u32, MavParamError> {
    let (sent, ours) = (set.param_type, info.param_type());
    if !value::is_supported(sent) {
        return Err(MavParamError::TYPE_UNSUPPORTED);
    }
    // A client that casts need not know the type, and pymavlink names REAL32 for every parameter.
    let named = if encoding == ParamEncoding::CCast { ours } else { sent };
    if (named == MavParamType::REAL32) != (ours == MavParamType::REAL32) {
        return Err(MavParamError::TYPE_MISMATCH);
    } else if info.is_read_only() {
        return Err(MavParamError::READ_ONLY);
    }
    // A client may know the parameter from another autopilot, as an integer of another size.
    let bits = value::from_wire(encoding, named, set.param_value);
    let bits = bits.and_then(|bits| value::converted(named, ours, bits));
    // Not clamped: a client that reads something else back sets it again, and fails (P-14).
    bits.filter(|bits| info.has_room(*bits)).ok_or(MavParamError::VALUE_OUT_OF_RANGE)
}

/// A name with zeros behind it, whatever stood there.
fn wire_name(text: &Text<16>) -> [u8; 16] {
    let mut name = [0; 16];
    crate::message::zero_extend(text.as_bytes(), &mut name);
    name
}

/// Why a parameter is refused.
fn reason(error: MavParamError) -> &'static str {
    match error {
        MavParamError::DOES_NOT_EXIST => ": no such parameter",
        MavParamError::VALUE_OUT_OF_RANGE => ": out of range",
        MavParamError::READ_ONLY => ": read-only",
        MavParamError::TYPE_UNSUPPORTED | MavParamError::TYPE_MISMATCH => ": wrong type",
        _ => ": not now",
    }
}
