//! STUB, to be replaced by the plan engine.
#![allow(missing_docs, unused, dead_code, private_interfaces, clippy::all)]
use crate::{
    frame::*,
    link::*,
    service::statustext::StatusTexts,
    time::*,
    vehicle::{Plans, Progress},
};
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Item;
impl Item {
    pub fn command(&self) -> crate::dialect::MavCmd {
        crate::dialect::MavCmd(0)
    }
}
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PlanType {
    Mission,
    Fence,
    Rally,
}
#[derive(Debug)]
pub struct PlanMemory<const M: usize>;
pub type NoPlans = PlanMemory<0>;
pub struct PlansMut<'a>(&'a ());
pub struct PlanView<'a>(&'a ());
pub trait PlanStorage {
    const EMPTY: Self;
    const CAPACITIES: [u16; 3];
    fn view(&mut self) -> PlansMut<'_>;
    fn live(&self, p: PlanType) -> PlanView<'_>;
}
impl<const M: usize> PlanStorage for PlanMemory<M> {
    const EMPTY: Self = Self;
    const CAPACITIES: [u16; 3] = [1, 0, 0];
    fn view(&mut self) -> PlansMut<'_> {
        PlansMut(&())
    }
    fn live(&self, _: PlanType) -> PlanView<'_> {
        PlanView(&())
    }
}
#[derive(Debug)]
pub(crate) struct Missions;
impl Missions {
    pub const fn new() -> Self {
        Self
    }
    pub fn handles(_id: u32) -> bool {
        false
    }
    pub fn on_frame(
        &mut self,
        _now: Instant,
        _from: Peer,
        _f: &Frame<'_>,
        _p: &mut PlansMut<'_>,
        _v: &mut impl Plans,
        _t: &mut StatusTexts,
        _l: LinkMask,
    ) {
    }
    pub fn poll(
        &mut self,
        _now: Instant,
        _p: &mut PlansMut<'_>,
        _v: &mut impl Plans,
        _t: &mut StatusTexts,
        _l: LinkMask,
    ) {
    }
    pub fn next_ack(&mut self, _o: &mut Outbox) -> bool {
        false
    }
    pub fn next(&mut self, _n: Instant, _p: &mut PlansMut<'_>, _pr: &Progress, _o: &mut Outbox) -> bool {
        false
    }
    pub fn deadline(&self) -> Instant {
        Instant::NEVER
    }
    pub fn is_pending(&self, _l: LinkId) -> bool {
        false
    }
}

impl PlanType {
    pub const fn is_served(self, c: &[u16; 3]) -> bool {
        c[self as usize] > 0
    }
}
#[macro_export]
macro_rules! plan_memory {
    ($($t:tt)*) => {
        $crate::NoPlans
    };
}
