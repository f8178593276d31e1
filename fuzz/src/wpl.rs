//! Any text, in any pieces: it is rejected with a line number, or it is written and read again without a change (W-1 to W-8).
//!
//! ```text
//!   bit 0: row 0 is home; bits 1 to 7: length of the pieces  text …
//! ```

use mavstack::Item;
use mavstack::dialect::{MavCmd, MavFrame};
use mavstack::wpl::{Error, HomeRow, Reader, Writer};

type Plan = (Vec<Item>, Option<Item>);

fn read(text: &[u8], home_row: HomeRow, piece: usize) -> Result<Plan, Error> {
    let mut reader = Reader::new(home_row);
    let mut items = Vec::new();
    for mut piece in text.chunks(piece) {
        while let Some(item) = reader.next(&mut piece)? {
            items.push(item);
        }
        assert!(piece.is_empty(), "unread bytes");
    }
    items.extend(reader.finish()?);
    Ok((items, reader.home()))
}

/// Returns an item with floats as bits, so that NaN equals NaN. All NaNs are equal, because a file keeps no NaN payload.
fn bits(item: &Item) -> (MavFrame, u16, u8, [u32; 5], i32, i32) {
    let Item { frame, command, autocontinue, params: [a, b, c, d], x, y, z } = *item;
    // The target of a jump is a row number, which has no sign.
    let a = if command == MavCmd::DO_JUMP && a == 0.0 { 0.0 } else { a };
    let bits = |value: f32| if value.is_nan() { f32::NAN.to_bits() } else { value.to_bits() };
    (frame, command.0, autocontinue, [a, b, c, d, z].map(bits), x, y)
}

fn all(plan: &Plan) -> Vec<(MavFrame, u16, u8, [u32; 5], i32, i32)> {
    plan.1.iter().chain(&plan.0).map(bits).collect()
}

/// Runs the target.
pub fn run(data: &[u8]) {
    let [how, text @ ..] = data else { return };
    let home_row = if how & 1 == 1 { HomeRow::First } else { HomeRow::None };
    let piece = usize::from(how >> 1).max(1);
    let plan = match read(text, home_row, piece) {
        Ok(plan) => plan,
        Err(error) => {
            assert!(error.line >= 1, "{error:?}");
            let whole = read(text, home_row, text.len().max(1));
            assert_eq!(whole.err(), Some(error), "the error does not depend on the pieces");
            return;
        }
    };
    let home_row = if plan.1.is_some() { HomeRow::First } else { HomeRow::None };
    let mut writer = Writer::new(home_row);
    let mut written = Writer::HEADER.to_vec();
    for item in plan.1.iter().chain(&plan.0) {
        match writer.row(item) {
            Ok(row) => written.extend(row),
            Err(fault) => panic!("{item:?} was read but cannot be written: {fault:?}"),
        }
    }
    let again = read(&written, home_row, 64);
    let again = again.unwrap_or_else(|error| panic!("{error:?} in {}", String::from_utf8_lossy(&written)));
    assert_eq!(all(&again), all(&plan));
}
