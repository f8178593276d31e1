//! Loads a plan from a text file.

use std::fmt;
use std::path::Path;

use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult};
use mavstack::plan::PlanFault;
use mavstack::wpl::{HomeRow, Reader};
use mavstack::{Instant, Item, PlanType};

use crate::vehicle::SitlApp;

/// A plan from a file.
#[derive(Debug, PartialEq)]
pub struct Plan {
    /// The items, each with the number of its line.
    rows: Vec<(usize, Item)>,
    /// The line of row 0, if there is one.
    first: Option<usize>,
    /// Whether row 0 is the home position, and not an item.
    has_home: bool,
}

impl Plan {
    /// Reads a file. Row 0 is the home position if it looks like one (W-9), unless `no_home` says that it is an item.
    pub fn read(path: &Path, no_home: bool) -> Result<Self, String> {
        let text = std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))?;
        Self::parse(&text, no_home).map_err(|error| format!("{}: {error}", path.display()))
    }

    fn parse(text: &[u8], no_home: bool) -> Result<Self, mavstack::wpl::Error> {
        let first = first_row(text);
        let is_home = !no_home && first.is_some_and(|(_, row)| is_home(row));
        let mut reader = Reader::new(if is_home { HomeRow::First } else { HomeRow::None });
        let (mut rows, mut last) = (Vec::new(), 0);
        for (number, mut line) in (1..).zip(text.split_inclusive(|byte| *byte == b'\n')) {
            last = number;
            while let Some(item) = reader.next(&mut line)? {
                rows.push((number, item));
            }
        }
        rows.extend(reader.finish()?.map(|item| (last, item)));
        // A file of version 120 never has a home row.
        let has_home = reader.home().is_some();
        Ok(Self { rows, first: first.map(|(number, _)| number), has_home })
    }

    /// Loads the items as the vehicle's mission, geofence or rally points. The type follows from the first item's command, because
    /// the file does not contain it.
    pub fn load(&self, app: &mut SitlApp) -> Result<(), String> {
        let plan = match self.rows.first().map(|(_, item)| item.command) {
            Some(MavCmd(5000..=5004)) => PlanType::Fence,
            Some(MavCmd::NAV_RALLY_POINT) => PlanType::Rally,
            _ => PlanType::Mission,
        };
        let items = self.rows.iter().map(|(_, item)| *item);
        let (stack, vehicle) = app.parts();
        stack.load_plan(Instant::ZERO, plan, items, vehicle).map_err(|fault| self.explain(fault))
    }

    /// Says what is wrong with which line.
    fn explain(&self, PlanFault { seq, result }: PlanFault) -> String {
        let at = seq.and_then(|seq| Some((seq, self.rows.get(usize::from(seq))?)));
        let Some((seq, (line, item))) = at else {
            return format!("plan refused: {} (MAV_MISSION_RESULT {})", reason(result), result.0);
        };
        let has_no_position = result == MavMissionResult::INVALID_PARAM5_X && (item.x, item.y) == (0, 0);
        let reason = if has_no_position { "no position: latitude and longitude are 0" } else { reason(result) };
        let command = item.command.0;
        format!("line {line}: item {seq} (command {command}) refused: {reason} (MAV_MISSION_RESULT {})", result.0)
    }
}

/// What the file was taken for: the number of items, and what row 0 is.
impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.rows.len();
        write!(f, "{count} item{}", if count == 1 { "" } else { "s" })?;
        match self.first {
            None => Ok(()),
            Some(line) if self.has_home => write!(f, "; row 0 (line {line}) is the home position, not an item"),
            Some(line) => write!(f, "; row 0 (line {line}) is item 0, not the home position"),
        }
    }
}

/// Returns the first row behind the header, with the number of its line.
fn first_row(text: &[u8]) -> Option<(usize, &[u8])> {
    let lines = (1..).zip(text.split(|byte| *byte == b'\n')).map(|(number, line)| (number, line.trim_ascii()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with(b"#")).nth(1)
}

/// Whether row 0 is the home position: index 0, frame 0, and command 16, or 0 as old versions of Mission Planner write it. A row of
/// MAVProxy's first waypoint has another frame (W-9).
fn is_home(row: &[u8]) -> bool {
    let mut columns = row.split(u8::is_ascii_whitespace).filter(|column| !column.is_empty());
    let mut number = || str::from_utf8(columns.next()?).ok()?.parse::<u16>().ok();
    let (index, _current, frame, command) = (number(), number(), number(), number());
    (index, frame) == (Some(0), Some(MavFrame::GLOBAL.0.into())) && matches!(command, Some(0 | 16))
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
        MavMissionResult::INVALID_PARAM5_X => "parameter 5 (latitude) is out of range, or too far away",
        MavMissionResult::INVALID_PARAM6_Y => "parameter 6 (longitude) is out of range",
        MavMissionResult::INVALID_PARAM7 => "parameter 7 (altitude) is out of range",
        MavMissionResult::INVALID_SEQUENCE => "the items are not numbered in order",
        _ => "the items are inconsistent",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(rows: &str) -> String {
        format!("QGC WPL 110\n# a comment\n\n{rows}")
    }

    fn parse(text: &str, no_home: bool) -> (Vec<(usize, u16)>, bool) {
        let plan = Plan::parse(text.as_bytes(), no_home).unwrap();
        (plan.rows.iter().map(|(line, item)| (*line, item.command.0)).collect(), plan.has_home)
    }

    /// W-9: row 0 is home only with index 0, command 16 or 0 and frame 0, in every type of plan. Any other row is kept.
    #[test]
    fn row_0_is_home_only_if_it_looks_like_home() {
        let behind = "\n1 0 3 5100 0 0 0 0 47.5 8.5 40 1\n";
        for (row, is_home) in [
            ("0 1 0 16 0 0 0 0 47.4 8.5 488 1", true),
            ("0\t0\t0\t0\t0\t0\t0\t0\t0\t0\t0\t1", true),
            ("  0 1 0 16 0 0 0 0 47.4 8.5 488 1\r", true),
            ("0 0 3 16 0 0 0 0 47.4 8.5 20 1", false),
            ("1 1 0 16 0 0 0 0 47.4 8.5 488 1", false),
            ("0 0 3 0 0 0 0 0 47.4 8.5 20 1", false),
            ("0 0 3 5100 0 0 0 0 47.4 8.5 40 1", false),
            ("0 0 0 5003 50 0 0 0 47.4 8.5 0 1", false),
            ("0 0 0 5005 50 0 0 0 47.4 8.5 0 1", false),
            ("0 0 3 22 0 0 0 0 47.4 8.5 20 1", false),
            ("0 0 2 178 0 5 0 0 0 0 0 1", false),
        ] {
            let text = file(&format!("{row}{behind}"));
            let (rows, has_home) = parse(&text, false);
            assert_eq!((rows.len(), has_home), (if is_home { 1 } else { 2 }, is_home), "{row}");
            assert_eq!(*rows.last().unwrap(), (5, 5_100));
            // The explicit choice wins.
            assert_eq!((parse(&text, true).0.len(), parse(&text, true).1), (2, false), "{row}");
            // A file of version 120 has no home row.
            assert_eq!(parse(&text.replace("110", "120"), false).0.len(), 2, "{row}");
            let plan = Plan::parse(text.as_bytes(), false).unwrap();
            let expected = match is_home {
                true => "1 item; row 0 (line 4) is the home position, not an item",
                false => "2 items; row 0 (line 4) is item 0, not the home position",
            };
            assert_eq!(plan.to_string(), expected);
        }
        assert_eq!(Plan::parse(b"QGC WPL 110\n", false).unwrap().to_string(), "0 items");
    }

    /// W-9: a single row that is not home is not dropped. Its line is known, also without a line end.
    #[test]
    fn a_single_row_is_kept() {
        let text = file("0 0 0 5003 50 0 0 0 47.4 8.5 0 1");
        assert_eq!(parse(&text, false), (vec![(4, 5_003)], false));
    }

    /// W-9: a refusal after reading names the line.
    #[test]
    fn refusals_name_the_line() {
        let text = file("0 1 0 16 0 0 0 0 47.4 8.5 488 1\n1 0 3 16 0 0 0 0 0 0 20 1\n");
        let plan = Plan::parse(text.as_bytes(), false).unwrap();
        let explain = |seq, result| plan.explain(PlanFault { seq, result });
        assert_eq!(
            explain(Some(0), MavMissionResult::INVALID_PARAM5_X),
            "line 5: item 0 (command 16) refused: no position: latitude and longitude are 0 (MAV_MISSION_RESULT 10)"
        );
        assert_eq!(
            explain(Some(0), MavMissionResult::UNSUPPORTED),
            "line 5: item 0 (command 16) refused: the vehicle does not support this command in a plan (MAV_MISSION_RESULT 3)"
        );
        assert_eq!(
            explain(None, MavMissionResult::INVALID),
            "plan refused: the items are inconsistent (MAV_MISSION_RESULT 5)"
        );
    }
}
