//! Links by satellite: when they send, what they may send, and what they delay.

#[path = "../support/mod.rs"]
mod support;

mod allowed_messages;
mod auto;
mod budget;
mod delayed;
#[cfg(feature = "signing")]
mod delayed_signed;
mod link;

use mavstack::Duration;
use mavstack::high_latency::HighLatency;

/// A world whose vehicle declares the high-latency service.
type World<const N: usize> = support::World<N, support::Tested<mavstack::__private::NoPlans, 8, support::Satellite>>;

fn satellite<const N: usize>(world: &mut World<N>) -> &mut HighLatency {
    &mut world.stack.high_latency
}

/// Runs for `duration`, and sleeps whenever the stack permits.
fn run<const N: usize>(world: &mut World<N>, duration: Duration) {
    world.sleep_for(duration);
}
