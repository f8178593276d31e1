//! The checked-in file matches `crane.xml`, and its messages match MAVLink's own tools.

use example_checked_in::crane::{Crane, CraneControl, CraneHook, CraneReport};
use mavstack::dialect::{Common, MavResult};
use mavstack::message::Dialect;
use mavstack::{Message, Text};
use mavstack_dialect::{Options, generate, is_current, load};
use std::path::Path;

#[test]
fn the_checked_in_file_is_up_to_date() {
    let input = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/crane.xml"));
    let options = Options { beside_common: true, ..Options::for_file(input) };
    let text = generate(&load(input, &[]).expect("valid definitions"), &options).expect("declarations");
    let output = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src/crane.rs"));
    assert!(is_current(output, &text), "run `mavstack-dialect --beside-common crane.xml src/crane.rs`");
}

#[test]
fn the_dialect_contains_its_own_messages_and_common() {
    let (own, common) = (Crane::MESSAGES, Common::MESSAGES);
    assert_eq!(own.rows().len(), common.rows().len() + 2);
    for row in common.rows() {
        assert_eq!(own.get(row.id()), Some(row));
    }
    // The values that pymavlink computes.
    assert_eq!((CraneReport::CRC_EXTRA, CraneControl::CRC_EXTRA), (104, 139));
    assert_eq!((CraneReport::BASE_LEN, CraneReport::MAX_LEN, CraneControl::MAX_LEN), (28, 29, 6));
}

#[test]
fn a_report_round_trips() {
    let report = CraneReport {
        hook: CraneHook::OPEN,
        result: MavResult::FAILED,
        line_out: 12.5,
        cargo: Text::new("anchor"),
        temperature: 41,
        ..Default::default()
    };
    assert_eq!((CraneReport::UNKNOWN.tension, CraneReport::default().tension), (i16::MAX, 0));
    let mut payload = [0; CraneReport::MAX_LEN];
    assert_eq!(report.encode(&mut payload), Some(29));
    assert_eq!(CraneReport::decode(&payload), report);
}
