//! Faults of plans, and the texts that report them to the operators (feature `plan-texts`).

use crate::dialect::{MavMissionResult, MavSeverity};
use crate::message::Text;
use crate::service::Cx;
use crate::time::Instant;
use crate::types::{Context, Firmware, LinkMask, ONE_FRAME, PlanType, StatusTexts};

/// A fault of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PlanFault {
    /// The item at fault, if there is one. MISSION_ACK has no field for it; the text names it (M-38).
    pub seq: Option<u16>,
    /// The result for the MISSION_ACK.
    pub result: MavMissionResult,
}

impl core::fmt::Display for PlanFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let result = self.result.0;
        match self.seq {
            Some(seq) => write!(f, "item {seq} refused: MAV_MISSION_RESULT {result}"),
            None => write!(f, "plan refused: MAV_MISSION_RESULT {result}"),
        }
    }
}

impl core::error::Error for PlanFault {}

impl From<MavMissionResult> for PlanFault {
    fn from(result: MavMissionResult) -> Self {
        Self { seq: None, result }
    }
}

/// A problem with a plan that a text reports to the operators.
#[derive(Clone, Copy)]
pub(super) enum Problem {
    /// "Mission item 12: parameter 3 out of range", because MISSION_ACK has no field for the item (M-38). "Mission
    /// refused: not consistent" if no item is at fault.
    Refused(PlanType, PlanFault),
    /// "Mission item 2: no position (0, 0)" (M-48).
    NoPosition(PlanType, u16),
    /// "Mission item 0: more than 10000 m away" (M-48).
    TooFar { seq: u16, limit: u32 },
    /// "Mission refused: no position yet", because the distance of its first waypoint is not checked (M-48).
    NotChecked,
    /// "Mission refused: stored too often, try later" (C-15).
    RateLimited(PlanType),
    /// "Mission upload timed out at item 12".
    TimedOut(PlanType, u16),
    /// "Mission item 12 cannot be made current" (M-93).
    NotCurrent(u16),
    /// An item with `current` 2 or 3 (M-34).
    Guided,
    /// "Mission not stored: the old one stays", for a durable upload.
    NotStored(PlanType),
    /// "Mission not cleared: storage failed", for a durable clear of one plan, or of all.
    NotCleared(Option<PlanType>),
    /// "Plan storage failed": the live plans could not be stored.
    StorageFailed,
}

impl Problem {
    /// Sends a text to the operators.
    pub(super) fn report<F: Firmware>(self, cx: &mut Cx<'_, F>) {
        self.push(cx.now, cx.shared.normal, cx.texts);
    }

    /// The same, from a hook.
    pub(super) fn report_from_hook(self, cx: &mut Context<'_>) {
        self.push(cx.now, cx.normal, cx.texts);
    }

    /// Without the feature `plan-texts` this compiles to nothing.
    #[inline(always)]
    fn push(self, now: Instant, links: LinkMask, texts: &mut StatusTexts) {
        if cfg!(feature = "plan-texts") {
            let mut text = Text::<ONE_FRAME>::EMPTY;
            self.write(&mut text);
            texts.push(now, links, MavSeverity::WARNING, text.as_bytes());
        }
    }

    /// Returns the fault in the plan; ERROR if the problem is not a fault of the plan.
    pub(super) fn fault(self) -> PlanFault {
        match self {
            Self::Refused(_, fault) => fault,
            Self::NoPosition(_, seq) | Self::TooFar { seq, .. } => {
                PlanFault { seq: Some(seq), result: MavMissionResult::INVALID_PARAM5_X }
            }
            _ => MavMissionResult::ERROR.into(),
        }
    }

    /// Writes the text into `text`, which is empty, so that only one text is on the stack.
    fn write(self, text: &mut Text<ONE_FRAME>) {
        let (plan, seq) = match self {
            Self::Refused(plan, PlanFault { seq, .. }) => (Some(plan), seq),
            Self::NoPosition(plan, seq) => (Some(plan), Some(seq)),
            Self::TooFar { seq, .. } | Self::NotCurrent(seq) => (Some(PlanType::Mission), Some(seq)),
            Self::NotChecked => (Some(PlanType::Mission), None),
            Self::RateLimited(plan) | Self::TimedOut(plan, _) | Self::NotStored(plan) => (Some(plan), None),
            Self::NotCleared(plan) => (plan, None),
            Self::StorageFailed => return text.push_str("Plan storage failed"),
            Self::Guided => return text.push_str("Guided items not supported: send DO_REPOSITION"),
        };
        text.push_str(match plan {
            Some(PlanType::Mission) => "Mission",
            Some(PlanType::Fence) => "Fence",
            Some(PlanType::Rally) => "Rally",
            None => "Plans",
        });
        if let Some(seq) = seq {
            text.push_str(" item ");
            text.push_number(seq.into());
        }
        let (front, number, rest) = match self {
            Self::Refused(_, PlanFault { seq, result }) => {
                if seq.is_none() {
                    text.push_str(" refused");
                }
                reason(result)
            }
            Self::NoPosition(..) => (": no position (0, 0)", None, ""),
            Self::TooFar { limit, .. } => (": more than ", Some(limit), " m away"),
            Self::NotCurrent(_) => (" cannot be made current", None, ""),
            Self::NotChecked => (" refused: no position yet", None, ""),
            Self::RateLimited(_) => (" refused: stored too often, try later", None, ""),
            Self::TimedOut(_, seq) => (" upload timed out at item ", Some(seq.into()), ""),
            Self::NotStored(_) => (" not stored: the old one stays", None, ""),
            Self::NotCleared(_) => (" not cleared: storage failed", None, ""),
            Self::StorageFailed | Self::Guided => return,
        };
        text.push_str(front);
        if let Some(number) = number {
            text.push_number(number);
            text.push_str(rest);
        }
    }
}

/// Returns the text for a result: what is before a number, the number, and what is after it.
fn reason(result: MavMissionResult) -> (&'static str, Option<u32>, &'static str) {
    let reason = match result {
        MavMissionResult::UNSUPPORTED_FRAME => ": frame not supported",
        MavMissionResult::UNSUPPORTED => ": command not supported",
        MavMissionResult::NO_SPACE => ": too many items",
        MavMissionResult::INVALID => ": not consistent",
        MavMissionResult::DENIED => ": not allowed now",
        // INVALID_PARAM1 to INVALID_PARAM7.
        MavMissionResult(code @ 6..=12) => {
            return (": parameter ", Some(code.saturating_sub(5).into()), " out of range");
        }
        _ => ": refused by the vehicle",
    };
    (reason, None, "")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// M-38
    #[test]
    fn texts_name_the_item_and_the_reason() {
        let refused = |plan, seq, result| {
            let mut text = Text::EMPTY;
            Problem::Refused(plan, PlanFault { seq, result }).write(&mut text);
            std::string::String::from(text.as_str().unwrap())
        };
        let item = |result| refused(PlanType::Mission, Some(65_534), result);
        assert_eq!(item(MavMissionResult::UNSUPPORTED), "Mission item 65534: command not supported");
        assert_eq!(item(MavMissionResult::INVALID_PARAM1), "Mission item 65534: parameter 1 out of range");
        assert_eq!(item(MavMissionResult::INVALID_PARAM7), "Mission item 65534: parameter 7 out of range");
        assert_eq!(item(MavMissionResult(200)), "Mission item 65534: refused by the vehicle");
        let whole = |seq| refused(PlanType::Fence, seq, MavMissionResult::INVALID);
        assert_eq!(whole(None), "Fence refused: not consistent");
        assert_eq!(whole(Some(12)), "Fence item 12: not consistent");
        // No text is truncated.
        assert!((0..=u8::MAX).all(|code| item(MavMissionResult(code)).len() < ONE_FRAME));
    }

    /// M-38, T-5: each text fits into one STATUSTEXT, and none is cut off.
    #[test]
    fn each_text_fits_into_one_frame() {
        let mission = PlanType::Mission;
        let mut problems: Vec<_> = (0..=16)
            .flat_map(|result| [None, Some(u16::MAX)].map(|seq| PlanFault { seq, result: MavMissionResult(result) }))
            .map(|fault| Problem::Refused(mission, fault))
            .collect();
        problems.extend([
            Problem::NoPosition(mission, u16::MAX),
            Problem::TooFar { seq: u16::MAX, limit: u32::MAX },
            Problem::NotChecked,
            Problem::RateLimited(mission),
            Problem::TimedOut(mission, u16::MAX),
            Problem::NotCurrent(u16::MAX),
            Problem::Guided,
            Problem::StorageFailed,
            Problem::NotStored(mission),
            Problem::NotCleared(None),
            Problem::NotCleared(Some(mission)),
        ]);
        for problem in problems {
            let mut text = Text::EMPTY;
            problem.write(&mut text);
            assert!(!text.as_bytes().is_empty() && text.as_bytes().len() < ONE_FRAME, "{:?}", text.as_str());
        }
    }
}
