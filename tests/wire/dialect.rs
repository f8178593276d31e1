//! The checked-in dialect against the table that pymavlink's parser computed from upstream's definitions: id, name,
//! `CRC_EXTRA` (S-3), wire order (S-4), lengths and target offsets of every message.

use crate::all::{self, Declared, Visit};
use mavstack::Message;
use mavstack::dialect::{
    Common, Heartbeat, HighLatency2, MavCmd, MavMissionResult, MavModeFlag, MavResult, MavType, MissionItemInt,
};
use mavstack::message::Dialect;
use std::fmt::Debug;

const TABLE: &str = include_str!("../../dialect/tests/definitions/wire.csv");

/// The row of a message in the table.
#[derive(Debug, PartialEq)]
struct Row {
    id: u32,
    name: String,
    crc_extra: u8,
    lengths: (u8, u8),
    targets: (Option<u8>, Option<u8>),
    fields: Vec<String>,
}

fn expected() -> Vec<Row> {
    let row = |line: &str| {
        let columns: Vec<_> = line.split(',').collect();
        let number = |at: usize| columns[at].parse().expect("a number");
        let offset = |at: usize| (!columns[at].is_empty()).then(|| number(at));
        (columns[0] == "common").then(|| Row {
            id: columns[1].parse().expect("an id"),
            name: columns[2].into(),
            crc_extra: number(3),
            lengths: (number(4), number(5)),
            targets: (offset(6), offset(7)),
            fields: columns[8].split(' ').map(str::to_owned).collect(),
        })
    };
    TABLE.lines().filter_map(row).collect()
}

/// The rows computed from the message types.
#[derive(Default)]
struct Rows(Vec<Row>);

impl Visit for Rows {
    fn visit<M: Message + Declared + Debug + Default + PartialEq>(&mut self) {
        assert_eq!(M::CRC_EXTRA, M::crc_extra(), "{}", M::NAME);
        // After the message's name one line per field; deeper lines are elements of arrays.
        let debug = format!("{:#?}", M::default());
        let fields = debug.lines().filter_map(|line| line.strip_prefix("    "));
        let fields = fields.filter(|line| line.starts_with(|c: char| c.is_ascii_alphabetic()));
        let length = |length: usize| u8::try_from(length).expect("at most 255");
        self.0.push(Row {
            id: M::ID,
            name: M::NAME.into(),
            crc_extra: M::CRC_EXTRA,
            lengths: (length(M::BASE_LEN), length(M::MAX_LEN)),
            targets: (M::INFO.target_system(), M::INFO.target_component()),
            fields: fields.map(|line| line.split(':').next().expect("a name").into()).collect(),
        });
    }
}

#[test]
fn every_message_has_the_wire_form_of_the_reference() {
    let mut rows = Rows::default();
    all::each(&mut rows);
    let expected = expected();
    for (row, expected) in rows.0.iter().zip(&expected) {
        assert_eq!(row, expected);
    }
    assert_eq!((rows.0.len(), expected.len()), (235, 235));
}

#[test]
fn message_table_agrees_with_the_types() {
    let rows = Common::MESSAGES.rows();
    let expected = expected();
    assert_eq!(rows.len(), expected.len());
    for (row, expected) in rows.iter().zip(&expected) {
        let found = (row.id(), row.crc_extra(), (row.base_len(), row.max_len()));
        assert_eq!(found, (expected.id, expected.crc_extra, expected.lengths), "{}", expected.name);
        assert_eq!((row.target_system(), row.target_component()), expected.targets, "{}", expected.name);
        assert_eq!(Common::MESSAGES.get(expected.id), Some(row));
    }
    assert_eq!(size_of_val(rows), 1_880, "bytes of the table");
}

#[test]
fn type_names_are_rust_style_and_others_as_in_mavlink() {
    let heartbeat =
        Heartbeat { r#type: MavType::QUADROTOR, base_mode: MavModeFlag::SAFETY_ARMED, ..Default::default() };
    assert_eq!((heartbeat.r#type.0, heartbeat.base_mode.0), (2, 128));
    assert_eq!((MavCmd::NAV_WAYPOINT.0, MavCmd::COMPONENT_ARM_DISARM.0), (16_u16, 400));
    assert_eq!((MavResult::IN_PROGRESS.0, MavMissionResult::NO_SPACE.0), (5_u8, 4));
    assert_eq!((HighLatency2::NAME, HighLatency2::ID), ("HIGH_LATENCY2", 235));
    let _: MavCmd = MissionItemInt::default().command;
}
