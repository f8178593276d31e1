//! A plan from a text file.

use std::path::Path;

use mavstack::dialect::MavCmd;
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
    let (stack, vehicle) = app.parts();
    stack.load_plan(Instant::ZERO, plan, items, vehicle).map_err(|fault| match fault.seq {
        Some(seq) => format!("item {seq} is refused: MAV_MISSION_RESULT {}", fault.result.0),
        None => format!("the plan is refused: MAV_MISSION_RESULT {}", fault.result.0),
    })
}
