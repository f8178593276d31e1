//! The memory that all services share: `#[stack]` declares its sizes.

use crate::network::{PeerInfo, Peers};
use crate::service::Absent;
use crate::types::{EventEntry, EventLog, RequestQueue, Requests, StatusTexts, TextEntry};

/// Memory of a declared size. The logic works on its view, which has no size in its type.
#[doc(hidden)]
pub trait Memory: core::fmt::Debug {
    type View: ?Sized;
    /// Empty: all zero bits.
    const NEW: Self;
    fn view(&self) -> &Self::View;
    fn view_mut(&mut self) -> &mut Self::View;
}

/// Implements [`Memory`] for a type that coerces to its view.
macro_rules! memory {
    ($([$($n:ident)?] $type:ty => $view:ty: $new:expr;)*) => {$(
        impl$(<const $n: usize>)? Memory for $type {
            type View = $view;
            const NEW: Self = $new;

            fn view(&self) -> &Self::View {
                self
            }

            fn view_mut(&mut self) -> &mut Self::View {
                self
            }
        }
    )*};
}

memory! {
    [N] heapless::Vec<PeerInfo, N> => Peers: {
        assert!(N > 0, "a stack needs room for a peer: `peers: 8` will do for most");
        Self::new()
    };
    [N] StatusTexts<[TextEntry; N]> => StatusTexts: Self::new();
    [N] Requests<[RequestQueue; N]> => Requests: Self::NONE;
    [N] EventLog<[EventEntry; N]> => EventLog: Self::EMPTY;
    [] Absent => Absent: Self;
}

#[cfg(feature = "storage")]
memory! {
    [] crate::storage::Storage => crate::storage::Storage: Self::NEW;
}
