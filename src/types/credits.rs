//! Credits: what peers may spend on the high-latency links (L-17).

use crate::time::{Duration, Instant};

/// What peers may spend on all high-latency links together (L-17): on messages that START forces, and on commands and
/// answers that are forwarded there. Scheduled messages are outside, and so are the vehicle's answers to commands that were
/// received on a high-latency link. [`Stack::set_credits`](crate::Stack::set_credits) changes it.
///
/// Half of the hourly credits and half of the burst are reserved for the system in control and for signed frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CreditConfig {
    /// Credits an hour: 60 by default. 0 is no limit.
    pub per_hour: u16,
    /// The credits that are there at the start, and that are saved up at most: 20 by default. A frame that costs more than
    /// its half of them is paid for when that half is full.
    pub burst: u8,
    /// The bytes of one message that a credit pays for: 50 by default, as Iridium's short burst data. 0 counts as 1.
    pub bytes: u16,
}

impl CreditConfig {
    /// The default: 60 credits of 50 bytes an hour, and a burst of 20.
    pub const DEFAULT: Self = Self { per_hour: 60, burst: 20, bytes: 50 };

    /// All zero bits.
    pub(crate) const VACANT: Self = Self { per_hour: 0, burst: 0, bytes: 0 };

    /// Returns the credits that a message of `len` bytes costs.
    pub(crate) fn cost(&self, len: usize) -> u32 {
        let len = u32::try_from(len).unwrap_or(u32::MAX);
        len.div_ceil(u32::from(self.bytes).max(1))
    }
}

impl Default for CreditConfig {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Whose credits pay for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payer {
    /// Any sender: it has the half for everyone.
    Anyone,
    /// The system in control, or the sender of a signed frame: it has the reserved half too.
    Privileged,
}

/// The credits that are left. Each half is a leaky bucket, stored as the time at which it will be full.
#[derive(Clone, Debug)]
pub struct Credits {
    pub(crate) config: CreditConfig,
    /// When the reserved half will be full, and when the one for everyone will.
    full_at: [Instant; 2],
    /// When the next text may say that they are used up.
    tell_at: Instant,
}

impl Credits {
    /// How often a text says that the credits are used up.
    const TELL_EVERY: Duration = Duration::from_secs(60);

    /// Full, and without a limit. All zero bits.
    pub(crate) const FULL: Self =
        Self { config: CreditConfig::VACANT, full_at: [Instant::ZERO; 2], tell_at: Instant::ZERO };

    /// Takes credits. Takes none and returns false if there are not enough. The reserved half is spent first.
    pub(crate) fn take(&mut self, now: Instant, payer: Payer, credits: u32) -> bool {
        /// In units of 1,024 µs: a half earns half of the hourly credits. A division of 64 bits takes 900 bytes of flash.
        const TWO_HOURS: u32 = 7_031_250;
        let Some(credit) = TWO_HOURS.checked_div(self.config.per_hour.into()) else { return true };
        let time = |credits: u32, of: u32| Duration::from_micros(u64::from(credits.saturating_mul(of)) << 10);
        let (cost, half) = (time(credits, credit), time(self.config.burst.into(), credit / 2));
        let skipped = if payer == Payer::Privileged { 0 } else { 1 };
        for full_at in self.full_at.iter_mut().skip(skipped) {
            let after = (*full_at).max(now) + cost;
            if after - now <= half.max(cost) {
                *full_at = after;
                return true;
            }
        }
        false
    }

    /// Whether a text may say now that the credits are used up. If so, the next one may a minute later.
    pub(crate) fn may_tell(&mut self, now: Instant) -> bool {
        let may_tell = now >= self.tell_at;
        if may_tell {
            self.tell_at = now + Self::TELL_EVERY;
        }
        may_tell
    }
}

/// The memory of a firmware's [`Credits`]: none if peers cannot cause anything on a high-latency link.
#[doc(hidden)]
pub trait CreditMemory: core::fmt::Debug {
    /// All zero bits.
    const FULL: Self;

    /// Whether there are credits.
    const IS_SOME: bool;

    /// What a call of a service uses. Without credits it has no size.
    type View<'a>: CreditView
    where
        Self: 'a;

    fn view(&mut self) -> Self::View<'_>;
}

/// A view of [`Credits`], or of none.
#[doc(hidden)]
pub trait CreditView {
    fn credits(&mut self) -> Option<&mut Credits>;
}

impl CreditMemory for [Credits; 0] {
    const FULL: Self = [];
    const IS_SOME: bool = false;
    type View<'a> = ();

    fn view(&mut self) -> Self::View<'_> {}
}

impl CreditView for () {
    fn credits(&mut self) -> Option<&mut Credits> {
        None
    }
}

impl CreditMemory for [Credits; 1] {
    const FULL: Self = [Credits::FULL];
    const IS_SOME: bool = true;
    type View<'a> = &'a mut Credits;

    fn view(&mut self) -> &mut Credits {
        let [credits] = self;
        credits
    }
}

impl CreditView for &mut Credits {
    fn credits(&mut self) -> Option<&mut Credits> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: CreditConfig = CreditConfig::DEFAULT;

    fn full(config: CreditConfig) -> Credits {
        Credits { config, ..Credits::FULL }
    }

    /// Returns the credits that are taken one by one within `hours`, with a try every ten seconds.
    fn taken(credits: &mut Credits, payer: Payer, hours: u64) -> usize {
        let tries = (0..hours * 360).map(|second| Instant::from_millis(second * 10_000 + 1));
        tries.filter(|now| credits.take(*now, payer, 1)).count()
    }

    /// L-17: half of the burst and of the hourly credits are for everyone, all of them for the one in control.
    #[test]
    fn half_of_all_credits_is_reserved() {
        assert_eq!(taken(&mut full(CONFIG), Payer::Anyone, 10), 10 + 299);
        assert_eq!(taken(&mut full(CONFIG), Payer::Privileged, 10), 20 + 598);
        let mut credits = full(CONFIG);
        assert_eq!(taken(&mut credits, Payer::Anyone, 1), 10 + 29);
        let mut now = Instant::from_millis(3_600_000);
        assert!(!credits.take(now, Payer::Anyone, 2));
        assert!(credits.take(now, Payer::Privileged, 10), "the reserved half is full");
        assert!(!credits.take(now, Payer::Privileged, 2));
        // However long the pause, no more than the burst is saved up.
        now += Duration::from_secs(1_000_000);
        assert!(credits.take(now, Payer::Anyone, 10) && !credits.take(now, Payer::Anyone, 1));
    }

    /// L-17: a frame that costs more than a half waits until that is full, and the average holds all the same.
    #[test]
    fn expensive_frames_keep_the_average() {
        let mut credits = full(CreditConfig { burst: 2, ..CONFIG });
        let tries = (0..36_000).map(|second| Instant::from_millis(second * 1_000));
        let paid = tries.filter(|now| credits.take(*now, Payer::Anyone, 6)).count();
        assert_eq!(paid, 50, "300 credits in ten hours");
    }

    /// Extreme configurations neither panic nor divide by zero.
    #[test]
    fn extreme_configurations_work() {
        let unlimited = CreditConfig { per_hour: 0, burst: 0, bytes: 0 };
        assert_eq!(unlimited.cost(280), 280);
        assert_eq!(taken(&mut full(unlimited), Payer::Anyone, 1), 360);
        let scarce = CreditConfig { per_hour: 1, burst: 0, bytes: u16::MAX };
        assert_eq!(scarce.cost(0xFFFF), 1);
        assert_eq!(taken(&mut full(scarce), Payer::Anyone, 10), 5);
        assert!(full(scarce).take(Instant::NEVER, Payer::Privileged, u32::MAX));
    }

    /// L-17: one text a minute.
    #[test]
    fn a_text_tells_once_a_minute() {
        let mut credits = full(CONFIG);
        let told = (0..600).filter(|second| credits.may_tell(Instant::from_millis(second * 1_000))).count();
        assert_eq!(told, 10);
    }
}
