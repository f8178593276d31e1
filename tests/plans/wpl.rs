//! Plan files: what ground stations write, what is refused, and the round trip through text.

use mavstack::dialect::{MavCmd, MavFrame, MavMissionResult};
use mavstack::wpl::{Error, Fault, HomeRow, Reader, Writer};
use mavstack::{CommandRule, Item};
use proptest::prelude::*;

/// The items, and the home position.
type Plan = (Vec<Item>, Option<Item>);

fn read_in_pieces<'a>(mut reader: Reader, pieces: impl IntoIterator<Item = &'a [u8]>) -> Result<Plan, Error> {
    let mut items = Vec::new();
    for mut piece in pieces {
        while let Some(item) = reader.next(&mut piece)? {
            items.push(item);
        }
        assert!(piece.is_empty(), "everything was read");
    }
    items.extend(reader.finish()?);
    Ok((items, reader.home()))
}

fn read(file: impl AsRef<[u8]>, home_row: HomeRow) -> Result<Plan, Error> {
    read_in_pieces(Reader::new(home_row), [file.as_ref()])
}

fn write(items: &[Item], home: Option<&Item>) -> Result<Vec<u8>, Fault> {
    let mut writer = Writer::new(if home.is_some() { HomeRow::First } else { HomeRow::None });
    let mut file = Writer::HEADER.to_vec();
    for item in home.into_iter().chain(items) {
        file.extend(writer.row(item)?);
    }
    Ok(file)
}

fn item(frame: MavFrame, command: MavCmd, params: [f32; 4], (x, y, z): (i32, i32, f32)) -> Item {
    Item { frame, command, autocontinue: 1, params, x, y, z }
}

const GLOBAL: MavFrame = MavFrame::GLOBAL;
const RELATIVE: MavFrame = MavFrame::GLOBAL_RELATIVE_ALT;
const NOWHERE: (i32, i32, f32) = (0, 0, 0.0);
const NAN: f32 = f32::NAN;
const UNSET: i32 = i32::MAX;

fn waypoint(x: i32, y: i32, z: f32) -> Item {
    item(RELATIVE, MavCmd::NAV_WAYPOINT, [0.0; 4], (x, y, z))
}

fn jump(to: f32, repeat: f32) -> Item {
    item(MavFrame::MISSION, MavCmd::DO_JUMP, [to, repeat, 0.0, 0.0], NOWHERE)
}

#[test]
fn missions_of_qgroundcontrol() {
    // W-6: 18 digits; row 0 is home; jumps count rows.
    let items = [
        item(RELATIVE, MavCmd::NAV_TAKEOFF, [15.0, 0.0, 0.0, NAN], (473_977_420, 85_455_940, 30.0)),
        item(MavFrame::MISSION, MavCmd::DO_CHANGE_SPEED, [1.0, 7.5, -1.0, 0.0], NOWHERE),
        item(RELATIVE, MavCmd::NAV_WAYPOINT, [0.1, 0.0, 0.0, NAN], (473_981_234, 85_462_001, 30.25)),
        item(GLOBAL, MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, -90.0], (-473_983_000, -85_470_003, 518.4)),
        jump(2.0, 2.0),
        Item { autocontinue: 0, ..item(RELATIVE, MavCmd::NAV_LAND, [0.0, 0.0, 0.0, NAN], (UNSET, UNSET, 0.000_01)) },
    ];
    let home = item(GLOBAL, MavCmd::NAV_WAYPOINT, [0.0; 4], (473_977_419, 85_455_938, 488.1));
    let file = include_bytes!("../wpl/qgroundcontrol.waypoints");
    assert_eq!(read(file, HomeRow::First), Ok((items.to_vec(), Some(home))));

    // Version 120 has no row for home, whatever the caller expects of version 110.
    let file = include_bytes!("../wpl/qgroundcontrol_120.waypoints");
    for home_row in [HomeRow::First, HomeRow::None] {
        assert_eq!(read(file, home_row), Ok((items.to_vec(), None)));
    }
}

#[test]
fn missions_of_mission_planner() {
    // W-2: 8 decimals in new versions, 6 in old ones, where an unknown home has command 0.
    let items = [
        item(RELATIVE, MavCmd::NAV_TAKEOFF, [0.0; 4], (0, 0, 20.0)),
        item(RELATIVE, MavCmd::NAV_WAYPOINT, [2.5, 0.0, 0.0, 0.0], (-353_628_123, 1_491_651_234, 20.5)),
        item(MavFrame::GLOBAL_TERRAIN_ALT, MavCmd::NAV_WAYPOINT, [0.0; 4], (-353_613_001, 1_491_641_008, 35.0)),
        item(RELATIVE, MavCmd::DO_CHANGE_SPEED, [0.0, 5.0, 0.0, 0.0], NOWHERE),
        Item { frame: RELATIVE, ..jump(1.0, -1.0) },
        item(RELATIVE, MavCmd::NAV_RETURN_TO_LAUNCH, [0.0; 4], NOWHERE),
    ];
    let home = item(GLOBAL, MavCmd::NAV_WAYPOINT, [0.0; 4], (-353_632_622, 1_491_652_376, 584.09));
    let file = include_bytes!("../wpl/mission_planner.waypoints");
    assert_eq!(read(file, HomeRow::First), Ok((items.to_vec(), Some(home))));

    let six = |value: i32| (value + 5).div_euclid(10) * 10;
    let rounded = |item: &Item| Item { x: six(item.x), y: six(item.y), ..*item };
    let items: Vec<_> = items.iter().take(3).map(rounded).collect();
    let home = item(GLOBAL, MavCmd::NAV_WAYPOINT, [0.0; 4], NOWHERE);
    let file = include_bytes!("../wpl/mission_planner_no_home.txt");
    assert_eq!(read(file, HomeRow::First), Ok((items, Some(home))));
}

#[test]
fn plans_of_mavproxy() {
    // W-7: 6 decimals, comments, no row for home.
    let items = vec![
        item(RELATIVE, MavCmd::NAV_TAKEOFF, [0.0, 0.0, 0.0, NAN], (473_977_420, 85_455_940, 10.0)),
        item(RELATIVE, MavCmd::NAV_WAYPOINT, [1.5, 0.0, 0.0, NAN], (473_978_420, 85_455_940, 12.0)),
        jump(1.0, 3.0),
        item(RELATIVE, MavCmd::NAV_WAYPOINT, [0.0, 0.0, 0.0, 0.1], (473_978_430, -85_456_940, 12.25)),
    ];
    assert_eq!(read(include_bytes!("../wpl/mavproxy_mission.txt"), HomeRow::None), Ok((items, None)));

    let fence =
        |command, param1, x, y| Item { autocontinue: 0, ..item(GLOBAL, command, [param1, 0.0, 0.0, 0.0], (x, y, 0.0)) };
    let vertex = MavCmd::NAV_FENCE_POLYGON_VERTEX_INCLUSION;
    let items = vec![
        fence(MavCmd::NAV_FENCE_RETURN_POINT, 0.0, -353_630_000, 1_491_650_000),
        fence(vertex, 3.0, -353_600_000, 1_491_600_000),
        fence(vertex, 3.0, -353_600_000, 1_491_700_000),
        fence(vertex, 3.0, -353_700_000, 1_491_650_000),
        fence(MavCmd::NAV_FENCE_CIRCLE_EXCLUSION, 60.5, -353_642_000, 1_491_663_000),
    ];
    assert_eq!(read(include_bytes!("../wpl/mavproxy_fence.txt"), HomeRow::None), Ok((items, None)));

    let rally = |x, y, z| Item { command: MavCmd::NAV_RALLY_POINT, ..waypoint(x, y, z) };
    let items = vec![rally(-353_618_000, 1_491_649_000, 40.0), rally(-353_651_000, 1_491_632_000, 55.5)];
    assert_eq!(read(include_bytes!("../wpl/mavproxy_rally.txt"), HomeRow::None), Ok((items, None)));
}

/// M-75: x and y of a command without a position are plain numbers in every frame, as MAVProxy and Mission Planner write them.
#[test]
fn numbers_without_a_position_are_not_scaled() {
    let flags = |frame| item(frame, MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, [0.0; 4], (12, -70_000, 0.0));
    for frame in [0, 1, 2, 3, 5, 6, 10, 11].map(MavFrame) {
        let row = format!("QGC WPL 110\n0 0 {} 1000 0 0 0 0 12.000000 -70000 0 1\n", frame.0);
        assert_eq!(read(row, HomeRow::None), Ok((vec![flags(frame)], None)));
        let text = write(&[flags(frame)], None).unwrap();
        let expected = format!("QGC WPL 110\n0\t0\t{}\t1000\t0\t0\t0\t0\t12\t-70000\t0\t1\n", frame.0);
        assert_eq!(String::from_utf8(text).unwrap(), expected);
    }
    // Only MISSION is never scaled. A region of interest has a position.
    let row = "QGC WPL 110\n0 0 2 1000 0 0 0 0 120000000 nan 0 1\n1 0 3 201 3 0 0 0 47.5 8.5 10 1\n";
    let roi = item(RELATIVE, MavCmd::DO_SET_ROI, [3.0, 0.0, 0.0, 0.0], (475_000_000, 85_000_000, 10.0));
    let in_mission = Item { x: 120_000_000, y: UNSET, ..flags(MavFrame::MISSION) };
    assert_eq!(read(row, HomeRow::None), Ok((vec![in_mission, roi], None)));
    // The row of home is a position, whatever its command.
    let home = item(GLOBAL, MavCmd::DO_JUMP, [0.0; 4], (473_977_419, 85_455_938, 488.1));
    assert_eq!(read(write(&[], Some(&home)).unwrap(), HomeRow::First), Ok((Vec::new(), Some(home))));
}

#[test]
fn white_space_comments_and_line_ends_do_not_matter() {
    // W-5
    let plain = "QGC WPL 110\n0 0 3 16 0 0 0 0 47.5 8.5 10 1\n1 0 3 16 0 0 0 0 47.5 8.5 20 1\n";
    let expected = Ok((vec![waypoint(475_000_000, 85_000_000, 10.0), waypoint(475_000_000, 85_000_000, 20.0)], None));
    let spaces = format!("{}\t", " ".repeat(1_000));
    let comment = format!("10 1\n# {}\n1 0", "a long story, ".repeat(100));
    for file in [
        plain.to_owned(),
        plain.replace('\n', "\r\n"),
        plain.replace(' ', "\t"),
        plain.replace(' ', &spaces),
        plain.replace('\n', " \t \n \n\n"),
        plain.replace("10 1\n1 0", &comment),
        format!("\n# first\n\n{plain}"),
        format!("\u{FEFF}{plain}"),
        format!("\u{FEFF}# first\r\n{plain}"),
        plain.trim_end().to_owned(),
        format!("{}# last", plain.replace("10 1\n", "10 1\n   # it is a comment behind white space too\n")),
        plain.replace("8.5", "+8.5").replace("47.5", "4.75e+1").replace("16 0", "16 -0e9").replace("-0e9", "0"),
    ] {
        assert_eq!(read(&file, HomeRow::None), expected, "{file:?}");
        for size in [1, 2, 3, 7, 64, 512] {
            let pieces = file.as_bytes().chunks(size);
            assert_eq!(read_in_pieces(Reader::new(HomeRow::None), pieces), expected, "{size}: {file:?}");
        }
    }
}

#[test]
fn error_names_line_and_column() {
    // W-5: the third line of a file, and its error.
    for (row, column, fault) in [
        ("1 0 3 16 0 0 0 0 47.5 8.5 10", 0, Fault::Columns),
        ("1 0 3 16 0 0 0 0 47.5 8.5 10 1 1", 0, Fault::Columns),
        ("1", 0, Fault::Columns),
        ("47.5 8.5", 1, Fault::Number),
        ("RALLY -35.3618 149.1649 40 40 0 0", 1, Fault::Number),
        ("QGC WPL 110", 1, Fault::Number),
        ("1#0 0 3 16 0 0 0 0 47.5 8.5 10 1", 1, Fault::Number),
        (". 0 3 16 0 0 0 0 47.5 8.5 10 1", 1, Fault::Number),
        ("-1 0 3 16 0 0 0 0 47.5 8.5 10 1", 1, Fault::Number),
        ("65536 0 3 16 0 0 0 0 47.5 8.5 10 1", 1, Fault::Range),
        ("1 true 3 16 0 0 0 0 47.5 8.5 10 1", 2, Fault::Number),
        ("1 256 3 16 0 0 0 0 47.5 8.5 10 1", 2, Fault::Range),
        ("1 0 3.0 16 0 0 0 0 47.5 8.5 10 1", 3, Fault::Number),
        ("1 0 256 16 0 0 0 0 47.5 8.5 10 1", 3, Fault::Range),
        ("1 0 13 16 0 0 0 0 47.5 8.5 10 1", 3, Fault::Frame),
        ("1 0 22 16 0 0 0 0 47.5 8.5 10 1", 3, Fault::Frame),
        ("1 0 3 +16 0 0 0 0 47.5 8.5 10 1", 4, Fault::Number),
        ("1 0 3 65536 0 0 0 0 47.5 8.5 10 1", 4, Fault::Range),
        ("1 0 3 NAV_WAYPOINT 0 0 0 0 47.5 8.5 10 1", 4, Fault::Number),
        ("1 0 3 16 0,5 0 0 0 47.5 8.5 10 1", 5, Fault::Number),
        ("1 0 3 16 1e39 0 0 0 47.5 8.5 10 1", 5, Fault::Range),
        ("1 0 3 16 0 0x10 0 0 47.5 8.5 10 1", 6, Fault::Number),
        ("1 0 3 16 0 0 1e 0 47.5 8.5 10 1", 7, Fault::Number),
        ("1 0 3 16 0 0 -1e39 0 47.5 8.5 10 1", 7, Fault::Range),
        ("1 0 3 16 0 0 0 - 47.5 8.5 10 1", 8, Fault::Number),
        ("1 0 3 16 0 0 0 -1.#IND 47.5 8.5 10 1", 8, Fault::Number),
        ("1 0 3 16 0 0 0 0 475000000 8.5 10 1", 9, Fault::Range),
        ("1 0 3 16 0 0 0 0 214.7483647 8.5 10 1", 9, Fault::Range),
        ("1 0 3 16 0 0 0 0 47\u{B0}30' 8.5 10 1", 9, Fault::Number),
        ("1 0 3 16 0 0 0 0 inf 8.5 10 1", 9, Fault::Range),
        ("1 0 1 16 0 0 0 0 214748.3647 8.5 10 1", 9, Fault::Range),
        ("1 0 2 16 0 0 0 0 0 8.5 10 1", 10, Fault::Fraction),
        ("1 0 2 16 0 0 0 0 0 2147483648 10 1", 10, Fault::Range),
        ("1 0 3 16 0 0 0 0 47.5 -214.74836485 10 1", 10, Fault::Range),
        ("1 0 3 16 0 0 0 0 47.5 8.5 ten 1", 11, Fault::Number),
        ("1 0 3 16 0 0 0 0 47.5 8.5 340282356779733661637539395458142568448 1", 11, Fault::Range),
        ("1 0 3 16 0 0 0 0 47.5 8.5 10 true", 12, Fault::Number),
        ("1 0 3 16 0 0 0 0 47.5 8.5 10 256", 12, Fault::Range),
        ("1 0 3 16 0 0 0 0 47.5 8.5 10 1 # home", 0, Fault::Columns),
        ("1 0 3 16 0 0 0 0 47.5\08.5 10 1 1", 9, Fault::Number),
        // A command without a position has plain numbers in every frame; one that was scaled is refused (M-75).
        ("1 0 3 1000 0 0 0 0 28.6 0 0 1", 9, Fault::Fraction),
        ("1 0 1 1000 0 0 0 0 0 0.5 0 1", 10, Fault::Fraction),
        ("1 0 3 1000 0 0 0 0 120000000 0 0 1", 9, Fault::Range),
        ("1 0 0 1000 0 0 0 0 0 -1000000 0 1", 10, Fault::Range),
        ("1 0 3 177 0.5 0 0 0 0 0 0 1", 5, Fault::Jump),
        ("1 0 3 177 -1 0 0 0 0 0 0 1", 5, Fault::Jump),
        ("1 0 3 177 nan 0 0 0 0 0 0 1", 5, Fault::Jump),
        ("1 0 3 177 65536 0 0 0 0 0 0 1", 5, Fault::Jump),
        ("1 0 3 177 3 0 0 0 0 0 0 1", 5, Fault::Jump),
    ] {
        let first = "0 0 3 16 0 0 0 0 47.5 8.5 10 1";
        for end in ["", "\n", "\r\n", "\r\n2 0 3 16 0 0 0 0 47.5 8.5 10 1\r\n"] {
            let file = format!("QGC WPL 110\r\n{first}\r\n{row}{end}");
            assert_eq!(read(&file, HomeRow::None), Err(Error { line: 3, column, fault }), "{file:?}");
        }
    }
    let long = format!("QGC WPL 110\n\n# one\n0 0 3 16 0 0 0 {}\n", "0".repeat(65));
    assert_eq!(read(long, HomeRow::None), Err(Error { line: 4, column: 8, fault: Fault::TooLong }));
    let long = format!("QGC WPL 110\n0 0 3 16 0 0 0 0 47.5 8.5 10 1 {}\n", "0".repeat(65));
    assert_eq!(read(long, HomeRow::None), Err(Error { line: 2, column: 0, fault: Fault::Columns }));
    let long = format!("QGC WPL 110\n\n# one\n0 0 3 16 0 0 0 0 {}.5 8.5 10 1\n", "0".repeat(62));
    assert!(read(long, HomeRow::None).is_ok(), "64 bytes fit");
}

#[test]
fn other_files_are_refused_at_the_header() {
    for (file, line, fault) in [
        ("", 1, Fault::Header),
        ("\n# nothing\n", 3, Fault::Header),
        ("QGC", 1, Fault::Header),
        ("QGC WPL\n110\n", 1, Fault::Header),
        ("QGC WPL 110 1\n", 1, Fault::Header),
        ("qgc wpl 110\n", 1, Fault::Header),
        ("QGC-WPL-110\n", 1, Fault::Header),
        ("QGC WPLX 110\n", 1, Fault::Header),
        ("QGC WPL 100\n", 1, Fault::Version),
        ("QGC WPL 111\n", 1, Fault::Version),
        ("QGC WPL PB 110\n", 1, Fault::Version),
        ("{\"fileType\": \"Plan\"}\n", 1, Fault::Header),
        ("-35.363000\t149.165000\n", 1, Fault::Header),
        ("RALLY -35.3618\t149.1649\t40\t40\t0\t0\n", 1, Fault::Header),
        ("\n\n0 0 3 16 0 0 0 0 47.5 8.5 10 1\n", 3, Fault::Header),
        ("\n\u{FEFF}QGC WPL 110\n", 2, Fault::Header),
        ("QGC \u{FEFF}WPL 110\n", 1, Fault::Header),
        (&"QGC".repeat(30), 1, Fault::Header),
    ] {
        assert_eq!(read(file, HomeRow::None), Err(Error { line, column: 0, fault }), "{file:?}");
    }
    assert_eq!(read("QGC WPL 110\r\n", HomeRow::First), Ok((Vec::new(), None)), "an empty plan");
}

#[test]
fn error_is_readable_and_ends_the_reading() {
    let mut reader = Reader::new(HomeRow::None);
    let mut file = "QGC WPL 110\n0 0 3 16 0 0 0 north 47.5 8.5 10 1\n1 0 3 16 0 0 0 0 47.5 8.5 10 1\n".as_bytes();
    let error = reader.next(&mut file).unwrap_err();
    assert_eq!(error.to_string(), "line 2 param4: not a number");
    assert!(!file.is_empty(), "the next row is unread");
    assert_eq!(reader.next(&mut file), Err(error));
    assert_eq!(reader.finish(), Err(error));
    let error = read("QGC WPL 100\n", HomeRow::None).unwrap_err();
    assert_eq!(error.to_string(), "line 1: version is not 110 or 120");
    let error = read("QGC WPL 110\n1 2 3\n", HomeRow::None).unwrap_err();
    assert_eq!(error.to_string(), "line 2: not 12 columns");
}

#[test]
fn index_is_checked_by_option() {
    // W-2, W-5
    let file = "QGC WPL 110\n0 0 3 16 0 0 0 0 47.5 8.5 10 1\n\n7 0 3 16 0 0 0 0 47.5 8.5 10 1\n";
    assert_eq!(read(file, HomeRow::None).unwrap().0.len(), 2);
    for home_row in [HomeRow::None, HomeRow::First] {
        let numbered = Reader::new(home_row).numbered();
        let error = Error { line: 4, column: 1, fault: Fault::Index };
        assert_eq!(read_in_pieces(numbered.clone(), [file.as_bytes()]), Err(error));
        assert!(read_in_pieces(numbered, [file.replace('7', "1").as_bytes()]).is_ok());
    }
}

#[test]
fn jumps_count_rows_in_the_file_and_items_in_the_plan() {
    // W-6
    let row = |to: &str| format!("0 0 2 177 {to} 2 0 0 0 0 0 1\n");
    let file = |to: &str| format!("QGC WPL 110\n{}{}{}", row("0"), row("2"), row(to));
    let targets = |plan: Plan| plan.0.iter().map(|item| item.params[0]).collect::<Vec<_>>();
    assert_eq!(read(file("1"), HomeRow::None).map(targets), Ok(vec![0.0, 2.0, 1.0]));
    assert_eq!(read(file("1"), HomeRow::First).map(targets), Ok(vec![1.0, 0.0]));
    let error = |line| Err(Error { line, column: 5, fault: Fault::Jump });
    // A jump to home and one past the end, which is detected at the end of the file.
    assert_eq!(read(file("0"), HomeRow::First), error(4));
    assert_eq!(read(file("3"), HomeRow::None), error(4));
    assert_eq!(read(file("3"), HomeRow::First), error(4));

    let home = waypoint(1, 2, 3.0);
    let plan = [jump(1.0, 2.0), jump(0.0, -1.0)];
    let file = write(&plan, Some(&home)).unwrap();
    assert_eq!(read(&file, HomeRow::First), Ok((plan.to_vec(), Some(home))));
    assert_eq!(read(&file, HomeRow::None).map(targets), Ok(vec![0.0, 2.0, 1.0]));
    // Home is not an item, whatever its command.
    let home = jump(0.0, 0.0);
    assert_eq!(read(write(&[], Some(&home)).unwrap(), HomeRow::First), Ok((Vec::new(), Some(home))));
}

#[test]
fn written_file_has_the_common_form() {
    // W-3, W-4, W-8: LF, single tabs, contiguous indices, `current` on the home row only, 7 decimals.
    let home = item(GLOBAL, MavCmd::NAV_WAYPOINT, [0.0; 4], (473_977_419, 85_455_938, 488.1));
    let plan = [
        item(RELATIVE, MavCmd::NAV_TAKEOFF, [0.1, -0.0, 1e-7, NAN], (-5, UNSET, 16_777_216.0)),
        item(MavFrame::MISSION, MavCmd(65_535), [1e30, 0.0, 0.0, 0.0], (i32::MIN, 7, f32::NEG_INFINITY)),
        Item { autocontinue: 255, ..item(MavFrame::LOCAL_NED, MavCmd(0), [0.0; 4], (-12_345_678, 5, 0.0)) },
        jump(0.0, -1.0),
    ];
    let expected = "QGC WPL 110\n\
        0\t1\t0\t16\t0\t0\t0\t0\t47.3977419\t8.5455938\t488.1\t1\n\
        1\t0\t3\t22\t0.1\t-0\t1e-7\tnan\t-0.0000005\tnan\t16777216\t1\n\
        2\t0\t2\t65535\t1e30\t0\t0\t0\t-2147483648\t7\t-inf\t1\n\
        3\t0\t1\t0\t0\t0\t0\t0\t-1234.5678\t0.0005\t0\t255\n\
        4\t0\t2\t177\t1\t-1\t0\t0\t0\t0\t0\t1\n";
    assert_eq!(String::from_utf8(write(&plan, Some(&home)).unwrap()).unwrap(), expected);
    let expected = "QGC WPL 110\n0\t0\t2\t177\t0\t-1\t0\t0\t0\t0\t0\t1\n";
    assert_eq!(String::from_utf8(write(&plan[3..], None).unwrap()).unwrap(), expected);
}

#[test]
fn unrepresentable_plan_is_refused() {
    let home = waypoint(0, 0, 0.0);
    for (item, fault) in [
        (Item { frame: MavFrame(13), ..home }, Fault::Frame),
        (Item { frame: MavFrame(255), ..home }, Fault::Frame),
        (Item { command: MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, x: 120_000_000, ..home }, Fault::Range),
        (Item { command: MavCmd::DO_GIMBAL_MANAGER_PITCHYAW, y: -1_000_000, ..home }, Fault::Range),
        (jump(0.5, 1.0), Fault::Jump),
        (jump(-1.0, 1.0), Fault::Jump),
        (jump(NAN, 1.0), Fault::Jump),
        (jump(65_535.0, 1.0), Fault::Jump),
    ] {
        assert_eq!(write(&[item], Some(&home)), Err(fault), "{item:?}");
    }
    let mut writer = Writer::new(HomeRow::None);
    for _ in 0..65_535 {
        writer.row(&home).unwrap();
    }
    assert_eq!(writer.row(&home), Err(Fault::TooMany));

    let mut file = write(&vec![home; 65_535], None).unwrap();
    assert_eq!(read(&file, HomeRow::None).unwrap().0.len(), 65_535);
    file.extend_from_slice(b"0 0 3 16 0 0 0 0 0 0 0 1");
    assert_eq!(read(&file, HomeRow::None), Err(Error { line: 65_537, column: 0, fault: Fault::TooMany }));
}

/// Any item that a file can represent: one kind of NaN, and no jump, because its target depends on the other items.
fn any_item() -> impl Strategy<Value = Item> {
    let frame = prop::sample::select((0..=12u8).chain([20, 21]).collect::<Vec<_>>());
    let float = prop_oneof![
        any::<u32>().prop_map(f32::from_bits).prop_map(|value| if value.is_nan() { NAN } else { value }),
        (-1_000_000i32..1_000_000).prop_map(|value| value as f32 / 100.0),
        prop::sample::select(vec![0.0, -0.0, NAN, f32::INFINITY, f32::MIN_POSITIVE, f32::MAX]),
    ];
    let integer = prop_oneof![any::<i32>(), Just(i32::MAX), Just(i32::MIN), -10_000_000..10_000_000];
    (frame, any::<u16>(), any::<u8>(), prop::array::uniform5(float), integer.clone(), integer)
        .prop_map(|(frame, command, autocontinue, [a, b, c, d, z], x, y)| Item {
            frame: MavFrame(frame),
            command: MavCmd(command),
            autocontinue,
            params: [a, b, c, d],
            x,
            y,
            z,
        })
        .prop_filter("no jump", |item| item.command != MavCmd::DO_JUMP)
        .prop_map(|item| plain(item, has_position(item.command)))
}

/// Whether the definitions give the command a position, or do not know it.
fn has_position(command: MavCmd) -> bool {
    let rule = mavstack::dialect::rules::ALL.iter().find(|rule| rule.command() == command);
    let in_mission = Item { command, frame: MavFrame::MISSION, ..waypoint(0, 0, 0.0) };
    let needs_frame = |rule: &CommandRule| rule.check(&in_mission) == Err(MavMissionResult::UNSUPPORTED_FRAME);
    command == MavCmd::DO_LAND_START || rule.is_none_or(needs_frame)
}

/// Returns the item without numbers that were scaled like degrees, if it has no position (M-75).
fn plain(item: Item, has_position: bool) -> Item {
    let number = |number: i32| if number == UNSET { number } else { number % 1_000_000 };
    if has_position || item.frame == MavFrame::MISSION {
        return item;
    }
    Item { x: number(item.x), y: number(item.y), ..item }
}

proptest! {
    #[test]
    fn written_plan_is_read_back_bit_for_bit(
        mut plan in prop::collection::vec(any_item(), 0..20),
        jumps in prop::collection::vec((0usize..20, 0usize..20), 0..3),
        home in prop::option::of(any_item()),
        size in 1usize..200,
    ) {
        // W-4, W-8
        prop_assume!(home.is_none_or(|home| home.command != MavCmd(0)));
        let count = plan.len().max(1);
        for (at, to) in jumps {
            if let Some(item) = plan.get_mut(at) {
                (item.command, item.params[0]) = (MavCmd::DO_JUMP, (to % count) as f32);
                *item = plain(*item, false);
            }
        }
        let file = write(&plan, home.as_ref()).unwrap();
        let reader = Reader::new(if home.is_some() { HomeRow::First } else { HomeRow::None }).numbered();
        prop_assert_eq!(read_in_pieces(reader, file.chunks(size)), Ok((plan, home)));
    }

    #[test]
    fn any_file_is_read_the_same_in_pieces(
        bytes in prop_oneof![
            prop::collection::vec(any::<u8>(), 0..300),
            r"QGC WPL 1[12]0\n([0-9. \t\r\n#naeE+-]{0,40}\n){0,8}".prop_map(String::into_bytes),
        ],
        cuts in prop::collection::vec(any::<u8>(), 0..20),
    ) {
        assert_pieces_do_not_matter(&bytes, &cuts);
    }

    #[test]
    fn damaged_file_gives_a_plan_or_an_error(
        which in 0usize..6,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 1..4),
        cuts in prop::collection::vec(any::<u8>(), 0..20),
    ) {
        let samples: [&[u8]; 6] = [
            include_bytes!("../wpl/qgroundcontrol.waypoints"),
            include_bytes!("../wpl/qgroundcontrol_120.waypoints"),
            include_bytes!("../wpl/mission_planner.waypoints"),
            include_bytes!("../wpl/mission_planner_no_home.txt"),
            include_bytes!("../wpl/mavproxy_mission.txt"),
            include_bytes!("../wpl/mavproxy_fence.txt"),
        ];
        let mut file = samples[which].to_vec();
        for (at, byte, how) in damage {
            let at = at.index(file.len());
            match how {
                0 => file[at] = byte,
                1 => file.insert(at, byte),
                _ => drop(file.remove(at)),
            }
        }
        assert_pieces_do_not_matter(&file, &cuts);
    }
}

fn assert_pieces_do_not_matter(file: &[u8], cuts: &[u8]) {
    for home_row in [HomeRow::First, HomeRow::None] {
        let mut pieces = Vec::new();
        let mut rest = file;
        for &cut in cuts {
            let (piece, behind) = rest.split_at(usize::from(cut).min(rest.len()));
            pieces.push(piece);
            rest = behind;
        }
        pieces.push(rest);
        let whole = read(file, home_row);
        assert_eq!(read_in_pieces(Reader::new(home_row), pieces), whole);
        if let Ok((items, home)) = whole {
            // What was read can be written, and reads the same.
            let again = write(&items, home.as_ref()).unwrap();
            let expected = if home.is_some() { HomeRow::First } else { HomeRow::None };
            assert_eq!(read(again, expected), Ok((items, home)));
        }
    }
}
