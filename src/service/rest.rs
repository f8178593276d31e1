//! The rest of a stack, for the unit tests of a single service.

use heapless::Vec;

use super::{Cx, Shared};
use crate::network::PeerInfo;
use crate::time::Instant;
use crate::types::{Firmware, LinkId, LinkMask, NoPlans, StatusTexts, TextEntry};

/// What a service works with beside its own state, the vehicle and the parameters: two normal links, no plans.
#[derive(Debug)]
pub(crate) struct Rest {
    pub(crate) shared: Shared,
    pub(crate) peers: Vec<PeerInfo, 4>,
    pub(crate) texts: StatusTexts<[TextEntry; 8]>,
}

impl Rest {
    pub(crate) fn new() -> Self {
        let normal = LinkMask::of(LinkId(0)).with(LinkMask::of(LinkId(1)));
        Self { shared: Shared { normal, ..Shared::VACANT }, peers: Vec::new(), texts: StatusTexts::new() }
    }

    pub(crate) fn cx<'a, F: Firmware<Plans = NoPlans>>(
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
            plans: None,
            parameters,
            vehicle,
        }
    }
}
