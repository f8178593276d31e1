//! Loads a plan from a text file.

use std::path::Path;

use mavstack::dialect::{MavCmd, MavMissionResult};
use mavstack::wpl::{HomeRow, Reader};
use mavstack::{Instant, Item, PlanType};

use crate::vehicle::SitlApp;

/// Reads all items of a file.
pub fn read(path: &Path, home_row: HomeRow) -> Result<Vec<Item>, String> {
    let text = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let failed = |error| format!("{}: {error}", path.display());
    let (mut reader, mut rest, mut items) = (Reader::new(home_row), &text[..], Vec::new());
    while let Some(item) = reader.next(&mut rest).map_err(failed)? {
        items.push(item);
    }
    items.extend(reader.finish().map_err(failed)?);
    Ok(items)
}

/// Loads the items as the vehicle's mission, geofence or rally points. The type follows from the first item's command, because
/// the file does not contain it.
pub fn load(app: &mut SitlApp, items: Vec<Item>) -> Result<(), String> {
    let plan = match items.first().map(|item| item.command) {
        Some(MavCmd(5000..=5004)) => PlanType::Fence,
        Some(MavCmd::NAV_RALLY_POINT) => PlanType::Rally,
        _ => PlanType::Mission,
    };
    let commands: Vec<u16> = items.iter().map(|item| item.command.0).collect();
    let (stack, vehicle) = app.parts();
    stack.load_plan(Instant::ZERO, plan, items, vehicle).map_err(|fault| {
        let (reason, result) = (reason(fault.result), fault.result.0);
        let Some(seq) = fault.seq else {
            return format!("plan refused: {reason} (MAV_MISSION_RESULT {result})");
        };
        let command = commands.get(usize::from(seq)).copied().unwrap_or_default();
        format!(
            "item {seq} (command {command}) refused: {reason} (MAV_MISSION_RESULT {result}); items count from 0, \
             without the home row"
        )
    })
}

/// Returns the reason of a refusal.
const fn reason(result: MavMissionResult) -> &'static str {
    match result {
        MavMissionResult::NO_SPACE => "too many items",
        MavMissionResult::UNSUPPORTED => "the vehicle does not support this command in a plan",
        MavMissionResult::UNSUPPORTED_FRAME => "the vehicle does not support this frame for the command",
        MavMissionResult::INVALID_PARAM1 => "parameter 1 is out of range",
        MavMissionResult::INVALID_PARAM2 => "parameter 2 is out of range",
        MavMissionResult::INVALID_PARAM3 => "parameter 3 is out of range",
        MavMissionResult::INVALID_PARAM4 => "parameter 4 is out of range",
        MavMissionResult::INVALID_PARAM5_X => "parameter 5 (latitude) is out of range",
        MavMissionResult::INVALID_PARAM6_Y => "parameter 6 (longitude) is out of range",
        MavMissionResult::INVALID_PARAM7 => "parameter 7 (altitude) is out of range",
        MavMissionResult::INVALID_SEQUENCE => "the items are not numbered in order",
        _ => "the items are inconsistent",
    }
}
