//! Bulk data: the files, logs and streamed logs of a link share 30 % of its rate, by turns, and what other traffic leaves (D-4,
//! LOG-8, LOG-14).
//!
//! With a share for each of them, all together would leave streams nothing beside the list of parameters, which has 40 %.

use super::Declares;
use super::services::{Services, States};
use crate::link::Port;
use crate::service::{COST_OF_BYTE, Cx, MAX_LATENESS, Service, Turn, View};
use crate::time::Instant;

/// The place of the last service in the match below.
const LAST: u8 = 2;

impl<D: Declares> Services<D> {
    /// As [`Service::next`], for all services with bulk data. Inlined: most of the time there is none.
    #[inline(always)]
    pub(crate) fn next_bulk(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>, turn: Turn) -> bool {
        let has_any = Service::<D>::has_bulk(&self.files)
            || Service::<D>::has_bulk(&self.logs)
            || Service::<D>::has_bulk(&self.log_streaming);
        if !has_any {
            port.facts.is_transferring = false;
        }
        has_any && self.send_bulk(cx, port, state, turn)
    }

    /// The service after the one that was last is asked first.
    #[inline(never)]
    fn send_bulk(&mut self, cx: &mut Cx<'_, D>, port: &mut Port, state: &mut States<D>, turn: Turn) -> bool {
        let States { bulk, bulk_turn: place, files, logs, log_streaming, .. } = state;
        if turn == Turn::LateBulk && cx.now < bulk.due().after(MAX_LATENESS) {
            return false;
        }
        // If no service of logs is declared, files have all turns.
        let last = const { if size_of::<D::Logs>() > 0 || size_of::<D::LogStreaming>() > 0 { LAST } else { 0 } };
        for _ in 0..=last {
            *place = if *place >= last { 0 } else { place.wrapping_add(1) };
            let is_sent = match *place {
                0 => self.files.next(cx, port, files, turn),
                1 => self.logs.next(cx, port, logs, turn),
                _ => self.log_streaming.next(cx, port, log_streaming, turn),
            };
            if is_sent {
                let len = u32::try_from(port.outbox.len()).unwrap_or(0);
                bulk.spend_all(cx.now, len.wrapping_mul(COST_OF_BYTE), port.config.bytes_per_second);
                return true;
            }
        }
        false
    }

    /// As [`Service::due`], for all services with bulk data.
    pub(crate) fn due_bulk(&self, view: &View<'_>, port: &Port, state: &States<D>, turn: Turn) -> Instant {
        let share = &state.bulk;
        let files = Service::<D>::due(&self.files, view, port, &state.files, turn);
        let logs = Service::<D>::due(&self.logs, view, port, &state.logs, turn);
        let streaming = Service::<D>::due(&self.log_streaming, view, port, &state.log_streaming, turn);
        let due = files.min(logs).min(streaming);
        if turn == Turn::LateBulk { due.max(share.due().after(MAX_LATENESS)) } else { due }
    }
}

/// Calls `next` of a turn's service.
macro_rules! next {
    (bulk, $declares:ty, $services:expr, $cx:expr, $port:expr, $state:expr, $turn:expr) => {
        $services.next_bulk($cx, $port, $state, $turn)
    };
    ($service:ident, $declares:ty, $services:expr, $cx:expr, $port:expr, $state:expr, $turn:expr) => {
        !$crate::stack::services::is_left_out::<$declares, _>(&$services.$service, $cx.shared)
            && $services.$service.next($cx, $port, &mut $state.$service, $turn)
    };
}
pub(super) use next;

/// Calls `due` of a turn's service.
macro_rules! due {
    (bulk, $declares:ty, $services:expr, $view:expr, $port:expr, $state:expr, $turn:expr) => {
        $services.due_bulk($view, $port, $state, $turn)
    };
    ($service:ident, $declares:ty, $services:expr, $view:expr, $port:expr, $state:expr, $turn:expr) => {
        match $crate::stack::services::is_left_out::<$declares, _>(&$services.$service, $view.shared) {
            true => Instant::NEVER,
            false => Service::<$declares>::due(&$services.$service, $view, $port, &$state.$service, $turn),
        }
    };
}
pub(super) use due;
