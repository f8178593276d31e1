//! The stack's questions about each frame.

use super::setup::{SetupText, SigningLink};
use super::timestamp::RunningTime;
use super::{Signing, SigningStream, Verdict};
use crate::dialect::SetupSigning;
use crate::frame::{Decoder, Frame, Version, signature_cost};
use crate::link::Port;
use crate::message::Message;
use crate::service::{SigningGate, increment};
use crate::time::{Duration, Instant};
use crate::types::{Accept, LinkClass, SignedAt, Trust};

impl<const STREAMS: usize> SigningGate<SigningLink> for Signing<[SigningStream; STREAMS]> {
    fn admits(&mut self, now: Instant, port: &mut Port, link: &mut SigningLink, frame: &Frame<'_>) -> bool {
        let config = &port.config.signing;
        match self.judge(now, frame) {
            Verdict::Verified(timestamp) => {
                // A frame from a satellite may contain a time from minutes ago.
                if port.config.class != LinkClass::HighLatency {
                    self.peers_time = self.peers_time.max(Some(RunningTime::new(now, timestamp)));
                }
                true
            }
            Verdict::Stale => false,
            Verdict::Forged => {
                link.hint(now, config, SetupText::WrongKey);
                false
            }
            Verdict::Unsigned => {
                let is_first_key = config.provisioning && !self.is_active() && frame.id() == SetupSigning::ID;
                let is_accepted = is_first_key || self.accepts_unsigned(port, frame.id());
                if !is_accepted {
                    increment(&mut self.counters.unsigned);
                    if self.saving.is_key_lost() && !self.is_active() {
                        link.hint(now, config, SetupText::LostKey);
                    }
                }
                is_accepted
            }
        }
    }

    fn trust(&self, port: &Port, frame: &Frame<'_>) -> Trust {
        // An accepted frame with a signature was verified if there is a key.
        let is_verified = self.is_active() && frame.header().is_signed();
        match self.policy(&port.config.signing) {
            _ if is_verified => Trust::Signed,
            Accept::Open => Trust::Open,
            Accept::SignedExcept(_) if !self.is_active() => Trust::Open,
            Accept::SignedExcept(_) | Accept::Required => Trust::None,
        }
    }

    fn accepts_unsigned(&self, port: &Port, id: u32) -> bool {
        self.policy(&port.config.signing).accepts_unsigned(id, self.is_active())
    }

    fn age(&self, now: Instant, frame: &Frame<'_>) -> Option<Duration> {
        self.age_at(now, frame)
    }

    fn signed_at(&self, frame: &Frame<'_>) -> SignedAt {
        Signing::signed_at(self, frame)
    }

    fn cost(&self, frame: &Frame<'_>) -> u32 {
        if frame.header().is_signed() && self.is_active() { signature_cost(frame.raw().len()) } else { 0 }
    }

    fn has_key(&self) -> bool {
        self.is_active()
    }

    fn vouches_for(&self, raw: &[u8], work: &mut u32) -> bool {
        self.key.as_ref().is_some_and(|key| {
            *work = work.saturating_sub(signature_cost(raw.len()));
            key.has_signed(raw)
        })
    }

    fn prepare(&mut self, now: Instant, port: &mut Port) {
        let signs = self.is_active() && port.config.signing.signs() && self.next_timestamp(now).is_some();
        port.outbox.set_signs(signs);
        // MAVLink 1 has no signatures (V-3).
        if signs {
            port.outbox.set_version(Version::V2);
        }
    }

    fn sign(&mut self, now: Instant, port: &mut Port) {
        if port.outbox.needs_signature() {
            let timestamp = self.take_timestamp(now);
            port.outbox.sign(self.key.as_ref().zip(timestamp));
        }
    }

    fn wipe(&self, id: u32, decoder: &mut Decoder) {
        if id == SetupSigning::ID {
            decoder.wipe();
        }
    }
}
