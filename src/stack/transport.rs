//! The links and their transports: polling, restarts, failures.

use embedded_io::{Read, ReadReady, Write, WriteReady};

use super::{Declares, NOT_FILLED, Stack};
use crate::frame::cost_of_sending;
use crate::link::{Accepted, Link, LinkCounters, LinkError, Transport};
use crate::service::command::CommandService;
use crate::service::{SigningGate, increment};
use crate::time::Instant;
use crate::types::{Allowance, LinkId};

impl<D: Declares, const LINKS: usize> Stack<D, LINKS> {
    /// Moves bytes between a link and its transport: reads, handles the received frames, and writes.
    ///
    /// It never blocks: it reads and writes only when the transport is ready.
    /// [`Config::budget`](crate::Config::budget) bounds the work. Poll each link at least every 20 ms to use all of its
    /// rate: a transfer queues no more bytes than the link transmits in 20 ms, plus one frame. Otherwise a heartbeat
    /// would have to wait for more (D-4).
    ///
    /// It sends no HEARTBEAT unless the stack was [polled](Self::poll) within [`max_loop_gap`](crate::Config::max_loop_gap):
    /// otherwise a firmware that polls only its links would look healthy, while no peer times out (H-18).
    ///
    /// # Errors
    ///
    /// Returns the transport's error after everything else was done; see [`LinkError`]. The link stays usable.
    pub fn poll_link<U: Read + Write + ReadReady + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut D::Vehicle,
    ) -> Result<(), LinkError<U::Error>> {
        if !self.shared.is_begun() {
            return Err(LinkError::NotBegun);
        }
        let mut allowance = self.shared.config.budget.allowance();
        let read = self.poll_read(now, link, uart, vehicle, &mut allowance);
        let write = self.poll_write(now, link, uart, vehicle, &mut allowance);
        read.and(write)
    }

    fn poll_read<U: Read + ReadReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut D::Vehicle,
        allowance: &mut Allowance,
    ) -> Result<(), LinkError<U::Error>> {
        let mut left = length(self.shared.config.budget.rx_bytes);
        let result = loop {
            let decoder = &mut self.link_mut(link).ok_or(LinkError::NoSuchLink)?.decoder;
            allowance.spend_but_for_a_frame(decoder.spare_cost());
            let spare = decoder.spare();
            let room = spare.len().min(left);
            let Some(room) = spare.get_mut(..room).filter(|room| !room.is_empty()) else { break Ok(()) };
            let read = match uart.read_ready() {
                Ok(false) => break Ok(()),
                Ok(true) => uart.read(room),
                Err(error) => Err(error),
            };
            match read {
                Ok(0) => break Err(LinkError::Closed),
                Ok(len) => {
                    left = left.saturating_sub(len);
                    self.handle_received(now, link, len, vehicle, allowance);
                }
                // Reception continues (S-20).
                Err(error) => {
                    if let Some(link) = self.link_mut(link) {
                        increment(&mut link.port.counters.read_errors);
                    }
                    break Err(LinkError::Read(error));
                }
            }
        };
        // Bytes in the decoder from before: they wait for silence, or for more budget.
        self.handle_received(now, link, NOT_FILLED, vehicle, allowance);
        result
    }

    // Its locals stay off the call stack of receiving services.
    #[inline(never)]
    fn poll_write<U: Write + WriteReady>(
        &mut self,
        now: Instant,
        link: LinkId,
        uart: &mut U,
        vehicle: &mut D::Vehicle,
        allowance: &mut Allowance,
    ) -> Result<(), LinkError<U::Error>> {
        let mut left = length(self.shared.config.budget.tx_bytes);
        let result = loop {
            let begins = self.link_mut(link).is_none_or(|link| link.port.outbox.is_empty());
            if left == 0 || (begins && !allowance.may_send()) {
                return Ok(());
            }
            // The transport is asked first. A frame that cannot begin yet is not made yet, so after a stall it reports
            // the state at that moment. A heartbeat from before the flight loop stopped must not be sent after it
            // (H-5).
            let written = match uart.write_ready() {
                Ok(is_ready) => {
                    self.note_transport(link, is_ready);
                    if !is_ready {
                        return Ok(());
                    }
                    let pending = self.transmit(now, link, vehicle);
                    if begins {
                        allowance.send(cost_of_sending(pending));
                    }
                    let pending = pending.get(..left).unwrap_or(pending);
                    if pending.is_empty() {
                        return Ok(());
                    }
                    uart.write(pending)
                }
                Err(error) => Err(error),
            };
            match written {
                Ok(0) => break Err(LinkError::Closed),
                Ok(len) => {
                    left = left.saturating_sub(len);
                    self.transmitted(link, len);
                }
                Err(error) => break Err(LinkError::Write(error)),
            }
        };
        self.note_failure(link);
        result
    }

    /// Restarts a link whose transport was opened again. Discards the received part of an unfinished frame. The first frame
    /// that is sent is a HEARTBEAT, and everything else waits for it for at most
    /// [`max_loop_gap`](crate::Config::max_loop_gap) after the link was first asked for a frame (H-17), but not while the vehicle is in a
    /// fault. A frame that was cut off is sent from its start again, unless it
    /// is a heartbeat, which would be out of date, or a frame of bulk data with over 230 bytes.
    pub fn restart_link(&mut self, link: LinkId) {
        self.greet(link);
        self.reset_link(link);
    }

    /// As [`restart_link`](Self::restart_link), but frames wait for a HEARTBEAT only if they already do.
    pub(crate) fn reset_link(&mut self, link: LinkId) {
        let index = usize::from(link.0);
        let state = self.states.get_mut(index);
        if let Some((Link { decoder, port }, state)) = self.links.get_mut(index).zip(state) {
            decoder.clear();
            port.transport = Transport::Unknown;
            port.outbox.restart(port.is_held());
            // Which may ask whether a peer was heard before.
            self.services.restart(port, state);
            port.accepted = Accepted::Nothing;
            port.retry_at = Instant::ZERO;
            if D::SLOWS_STREAMS {
                port.facts.transferring_until = Instant::ZERO;
            }
        }
    }

    /// Whether every command that was received on `link` was answered, down to the last byte that the transport takes.
    /// Bytes behind the transport are not known to the stack: with an `io::LoopEnd`, also wait until its `has_to_send` is false;
    /// with DMA, until the transfer has ended; and then some milliseconds for the UART's own buffer.
    ///
    /// Before a reboot, also call `save_parameters`, and wait until `persist` returns false.
    ///
    /// Use it for commands after which the vehicle cannot answer, above all a reboot (C-30): store [`Command::from`],
    /// and reset when this returns true, or after a second if the link is stalled.
    ///
    /// [`Command::from`]: crate::Command::from
    pub fn has_answered(&self, link: LinkId) -> bool {
        let index = usize::from(link.0);
        let link = self.links.get(index).zip(self.states.get(index));
        link.is_none_or(|(link, state)| {
            CommandService::<D::Commands>::has_answered(&state.command) && !link.port.outbox.has_frame()
        })
    }
    /// Records whether the transport of a link accepts bytes.
    pub(crate) fn note_transport(&mut self, link: LinkId, is_ready: bool) {
        if let Some(link) = self.link_mut(link) {
            link.port.transport = if is_ready { Transport::Ready } else { Transport::Full };
        }
    }

    /// Records an error of a link's transport while writing.
    pub(crate) fn note_failure(&mut self, link: LinkId) {
        let now = self.shared.clock.now();
        if let Some(link) = self.link_mut(link) {
            link.port.failed(now);
        }
    }

    /// Has a HEARTBEAT sent first on a link, to a peer that is new there (H-17).
    pub(crate) fn greet(&mut self, link: LinkId) {
        if let Some(Link { port, .. }) = self.link_mut(link) {
            port.hold();
            port.facts.is_sign_of_life_due = port.is_held();
        }
    }

    /// Whether a link has accepted a frame since this was last asked, and since it was restarted: a checked one, signed if the
    /// link requires it, and not the heartbeat of another vehicle, which is a broadcast.
    pub(crate) fn has_accepted_again(&mut self, link: LinkId) -> bool {
        let Some(Link { port, .. }) = self.link_mut(link) else { return false };
        let has_accepted = port.accepted == Accepted::Again;
        if has_accepted {
            port.accepted = Accepted::Before;
        }
        has_accepted
    }

    /// Whether a link accepts an unsigned frame with this id: an address proves nothing there.
    pub(crate) fn accepts_unsigned(&self, link: LinkId, id: u32) -> bool {
        let port = self.links.get(usize::from(link.0)).map(|link| &link.port);
        port.is_some_and(|port| self.services.signing.accepts_unsigned(port, id))
    }

    /// Has the next frame of a link be a HEARTBEAT, or any. Returns false if it may send none: it waits for a HEARTBEAT, which
    /// is not sent in a fault.
    pub(crate) fn allow_only_heartbeat(&mut self, link: LinkId, is_only: bool) -> bool {
        let may_send = !is_only || self.shared.observed.has_state;
        if let Some(Link { port, .. }) = self.link_mut(link) {
            port.hold_without_bound(is_only);
            if !may_send {
                // It sends nothing until the firmware calls again.
                port.transport = Transport::Full;
            }
        }
        may_send
    }

    /// Returns the counters of a link; `None` if there is no such link.
    pub(crate) fn counters_mut(&mut self, link: LinkId) -> Option<&mut LinkCounters> {
        self.link_mut(link).map(|link| &mut link.port.counters)
    }

    /// Returns the error of a call for a link that the stack lacks.
    #[cfg(feature = "embedded-io-async")]
    pub(crate) const fn no_link<E>(&self) -> LinkError<E> {
        if self.shared.is_begun() { LinkError::NoSuchLink } else { LinkError::NotBegun }
    }

    /// Whether a link has sent nothing since it was opened, and when its transport may be asked again.
    #[cfg(feature = "embedded-io-async")]
    pub(crate) fn transmit_state<E>(&mut self, link: LinkId) -> Result<(bool, Instant), LinkError<E>> {
        let no_link = self.no_link();
        let link = self.link_mut(link).ok_or(no_link)?;
        Ok((link.port.is_held(), link.port.retry_at))
    }

    /// Whether received frames are pending that exceeded the budget of a call.
    #[cfg(feature = "embedded-io-async")]
    pub(crate) fn has_backlog(&self, link: LinkId) -> bool {
        self.links.get(usize::from(link.0)).is_some_and(|link| link.decoder.has_backlog())
    }
}

/// Converts a number of bytes.
fn length(bytes: u32) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}
