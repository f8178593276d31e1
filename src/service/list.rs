//! Lists of services, and visitors for the services of a list.

use super::{About, Service};
use crate::types::Firmware;

/// A visitor that acts on each service, and its state on a link, until one ends it.
pub trait Visit<F: Firmware> {
    /// Visits a service with its state on a link. Returns true to visit no more.
    fn visit<S: Service<F>>(&mut self, service: &mut S, link: &mut S::Link) -> bool;
}

/// A visitor that reads each service and its state on a link.
pub trait Look<F: Firmware> {
    /// Looks at a service and its state on a link.
    fn look<S: Service<F>>(&mut self, service: &S, link: &S::Link);
}

/// A visitor that acts on each service, with its states on all links.
pub trait VisitAll<F: Firmware> {
    /// Visits a service with its states on all links, in order.
    fn visit<'l, S: Service<F>>(&mut self, service: &mut S, links: impl Iterator<Item = &'l mut S::Link>)
    where
        S::Link: 'l;
}

/// A visitor that reads each service.
pub trait LookAll<F: Firmware> {
    /// Looks at a service.
    fn look<S: Service<F>>(&mut self, service: &S);
}

/// The services of the struct that declares a stack. `#[derive(Stack)]` implements it; each method goes through the fields.
pub trait ServiceList<F: Firmware>: Sized {
    /// The states of the services on a link.
    type Links: core::fmt::Debug;

    /// The initial services.
    const NEW: Self;

    /// The initial states on a link.
    const VACANT: Self::Links;

    /// The compile-time facts about each.
    const ABOUT: &'static [About];

    /// Visits the services until one ends it. Returns whether one did.
    fn visit(&mut self, links: &mut Self::Links, visit: &mut impl Visit<F>) -> bool;

    /// Looks at the services and their states on a link.
    fn look(&self, links: &Self::Links, look: &mut impl Look<F>);

    /// Visits all services. `of`: the states of the services in those of all services on a link.
    fn visit_all<T>(
        &mut self,
        states: &mut [T],
        of: impl Fn(&mut T) -> &mut Self::Links + Copy,
        visit: &mut impl VisitAll<F>,
    );

    /// Looks at the services.
    fn look_all(&self, look: &mut impl LookAll<F>);
}

/// No services.
impl<F: Firmware> ServiceList<F> for () {
    type Links = ();
    const NEW: Self = ();
    const VACANT: () = ();
    const ABOUT: &'static [About] = &[];

    fn visit(&mut self, (): &mut (), _: &mut impl Visit<F>) -> bool {
        false
    }

    fn look(&self, (): &(), _: &mut impl Look<F>) {}

    fn visit_all<T>(&mut self, _: &mut [T], _: impl Fn(&mut T) -> &mut () + Copy, _: &mut impl VisitAll<F>) {}

    fn look_all(&self, _: &mut impl LookAll<F>) {}
}
