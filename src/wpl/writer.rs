//! Writing: items to lines (W-3, W-6).

use super::line::Line;
use super::{Fault, HomeRow, decimals, is_wrongly_scaled, jump_target};
use crate::message::Item;

/// Writes a plan as text: [`HEADER`](Self::HEADER), then one line for each item.
#[derive(Clone, Debug)]
pub struct Writer {
    home_row: HomeRow,
    rows: u16,
    line: Line,
}

impl Writer {
    /// The first line of the file.
    pub const HEADER: &'static [u8] = b"QGC WPL 110\n";

    /// Returns a writer for one file. With [`HomeRow::First`] the first item is the home position. QGroundControl
    /// always takes the first row as home.
    pub const fn new(home_row: HomeRow) -> Self {
        Self { home_row, rows: 0, line: Line::new() }
    }

    /// Returns the next row, including the end of its line.
    ///
    /// # Errors
    ///
    /// - [`Frame`](Fault::Frame): the meaning of x and y is not known in the item's frame.
    /// - [`Range`](Fault::Range): a command without a position has 1,000,000 or more in x or y outside
    ///   [`MavFrame::MISSION`](crate::dialect::MavFrame::MISSION), which no reader takes (M-75).
    /// - [`Jump`](Fault::Jump): the target of a [`DO_JUMP`](crate::dialect::MavCmd::DO_JUMP) is not a sequence number.
    /// - [`TooMany`](Fault::TooMany): there are more rows than sequence numbers.
    pub fn row(&mut self, item: &Item) -> Result<&[u8], Fault> {
        let rows = self.rows.checked_add(1).ok_or(Fault::TooMany)?;
        let has_home = self.home_row == HomeRow::First;
        let is_home = has_home && self.rows == 0;
        let decimals = decimals(item, is_home).ok_or(Fault::Frame)?;
        if is_wrongly_scaled(item, item.x, decimals) || is_wrongly_scaled(item, item.y, decimals) {
            return Err(Fault::Range);
        }
        let mut params = item.params;
        if let Some(target) = jump_target(item).filter(|_| !is_home) {
            let [param1, ..] = &mut params;
            *param1 = target?.checked_add(has_home.into()).ok_or(Fault::Jump)?.into();
        }

        let line = &mut self.line;
        line.clear();
        for integer in [self.rows, is_home.into(), item.frame.0.into(), item.command.0] {
            line.push_integer(integer.into());
            line.push(b'\t');
        }
        for param in params {
            line.push_f32(param);
            line.push(b'\t');
        }
        for coordinate in [item.x, item.y] {
            line.push_scaled(coordinate, decimals);
            line.push(b'\t');
        }
        line.push_f32(item.z);
        line.push(b'\t');
        line.push_integer(item.autocontinue.into());
        line.push(b'\n');
        self.rows = rows;
        Ok(line.as_bytes())
    }
}
