//! The memory of what all services share: `#[stack]` declares its sizes. The logic works on the unsized forms.

use crate::network::{PeerInfo, Peers};
use crate::service::Absent;
use crate::types::{EventEntry, EventLog, RequestQueue, Requests, StatusTexts, TextEntry};

/// The state of storage, or nothing.
#[doc(hidden)]
pub trait StorageMemory {
    const NEW: Self;
}

impl StorageMemory for Absent {
    const NEW: Self = Self;
}

#[cfg(feature = "storage")]
impl StorageMemory for crate::storage::Storage {
    const NEW: Self = Self::NEW;
}

/// The table of peers.
#[doc(hidden)]
pub trait PeerMemory: core::fmt::Debug {
    const NEW: Self;
    fn view(&self) -> &[PeerInfo];
    fn view_mut(&mut self) -> &mut Peers;
}

impl<const N: usize> PeerMemory for heapless::Vec<PeerInfo, N> {
    const NEW: Self = {
        assert!(N > 0, "a stack needs room for a peer: `peers: 8` will do for most");
        Self::new()
    };

    fn view(&self) -> &[PeerInfo] {
        self
    }

    fn view_mut(&mut self) -> &mut Peers {
        self.as_mut_view()
    }
}

/// The queue of texts.
#[doc(hidden)]
pub trait TextMemory: core::fmt::Debug {
    const NEW: Self;
    fn view(&self) -> &StatusTexts;
    fn view_mut(&mut self) -> &mut StatusTexts;
}

impl<const N: usize> TextMemory for StatusTexts<[TextEntry; N]> {
    const NEW: Self = Self::new();

    fn view(&self) -> &StatusTexts {
        self
    }

    fn view_mut(&mut self) -> &mut StatusTexts {
        self
    }
}

/// The requests of the hooks.
#[doc(hidden)]
pub trait RequestMemory: core::fmt::Debug {
    const NEW: Self;
    fn view(&self) -> &Requests;
    fn view_mut(&mut self) -> &mut Requests;
}

impl<const N: usize> RequestMemory for Requests<[RequestQueue; N]> {
    const NEW: Self = Self::NONE;

    fn view(&self) -> &Requests {
        self
    }

    fn view_mut(&mut self) -> &mut Requests {
        self
    }
}

/// The history of events.
#[doc(hidden)]
pub trait EventMemory: core::fmt::Debug {
    const NEW: Self;
    fn view(&self) -> &EventLog;
    fn view_mut(&mut self) -> &mut EventLog;
}

impl<const N: usize> EventMemory for EventLog<[EventEntry; N]> {
    const NEW: Self = Self::EMPTY;

    fn view(&self) -> &EventLog {
        self
    }

    fn view_mut(&mut self) -> &mut EventLog {
        self
    }
}
