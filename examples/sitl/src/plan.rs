//! A plan from a text file.

use std::path::Path;

use mavstack::dialect::{MavCmd, MavMissionResult};
use mavstack::wpl::{HomeRow, Reader};
use mavstack::{Instant, Item, PlanStorage, PlanType};
use mavstack_demo::App;

/// Reads the whole file.
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

/// Makes it the vehicle's mission, geofence or rally points: the file does not say which, its commands do.
pub fn load<P: PlanStorage>(app: &mut App<P>, items: Vec<Item>) -> Result<(), String> {
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
            return format!("the plan is refused: {reason} (MAV_MISSION_RESULT {result})");
        };
        let command = commands.get(usize::from(seq)).copied().unwrap_or_default();
        format!("item {seq}, command {command}, is refused: {reason} (MAV_MISSION_RESULT {result}); home is no item")
    })
}

/// What is to be mended.
const fn reason(result: MavMissionResult) -> &'static str {
    match result {
        MavMissionResult::NO_SPACE => "more items than there is room for",
        MavMissionResult::UNSUPPORTED => "the vehicle does not have this command in its plans",
        MavMissionResult::UNSUPPORTED_FRAME => "the vehicle does not take this command in this frame",
        MavMissionResult::INVALID_PARAM1 => "parameter 1 is out of its range",
        MavMissionResult::INVALID_PARAM2 => "parameter 2 is out of its range",
        MavMissionResult::INVALID_PARAM3 => "parameter 3 is out of its range",
        MavMissionResult::INVALID_PARAM4 => "parameter 4 is out of its range",
        MavMissionResult::INVALID_PARAM5_X => "parameter 5, the latitude, is out of its range",
        MavMissionResult::INVALID_PARAM6_Y => "parameter 6, the longitude, is out of its range",
        MavMissionResult::INVALID_PARAM7 => "parameter 7, the altitude, is out of its range",
        MavMissionResult::INVALID_SEQUENCE => "the items are not numbered in order",
        _ => "the items do not fit together",
    }
}
