//! Reading: bytes to items (W-1, W-2, W-5 to W-7).

use heapless::Vec;

use super::{HomeRow, decimal, decimals, is_wrongly_scaled, jump_target, scale};
use crate::dialect::{MavCmd, MavFrame};
use crate::message::Item;

/// Maximum length of a column in bytes. C's `%f` writes the largest `f32` with 47.
const MAX_COLUMN: usize = 64;
const COLUMNS: [&str; 12] =
    ["index", "current", "frame", "command", "param1", "param2", "param3", "param4", "x", "y", "z", "autocontinue"];
/// The number of the column with a jump's target, param1.
const JUMP: u8 = 5;
const BYTE_ORDER_MARK: [u8; 3] = [0xEF, 0xBB, 0xBF];

/// Why a file cannot be read, or an item cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Fault {
    /// The file does not begin with `QGC WPL` and a version.
    Header,
    /// The version is neither 110 nor 120.
    Version,
    /// A row has more or fewer than twelve columns.
    Columns,
    /// The text is not a number, or not an integer in a column of integers.
    Number,
    /// A column has more than 64 bytes.
    TooLong,
    /// The number does not fit in the item: it is too large, or infinite in x or y. Also a plain number in x or y that was scaled
    /// like degrees (M-75).
    Range,
    /// x or y is not a whole number, but an integer parameter: in [`MavFrame::MISSION`], or of a command without a position.
    Fraction,
    /// The meaning of x and y is not known in this frame.
    Frame,
    /// The rows are not numbered 0, 1, 2… ([`Reader::numbered`]).
    Index,
    /// The target of a [`DO_JUMP`](MavCmd::DO_JUMP) is home, or not a row of the file.
    Jump,
    /// There are more than 65,535 rows, the number of sequence numbers.
    TooMany,
}

impl Fault {
    /// Returns a description in a few words, for a text to the operator.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Header => "not a QGC WPL file",
            Self::Version => "version is not 110 or 120",
            Self::Columns => "not 12 columns",
            Self::Number => "not a number",
            Self::TooLong => "too long",
            Self::Range => "number out of range",
            Self::Fraction => "not a whole number",
            Self::Frame => "unknown frame",
            Self::Index => "not in sequence",
            Self::Jump => "no row to jump to",
            Self::TooMany => "too many rows",
        }
    }
}

impl core::fmt::Display for Fault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl core::error::Error for Fault {}

/// A fault in a file, and its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Error {
    /// The number of the line, from 1. Header, comments and blank lines count.
    pub line: u32,
    /// The number of the column, from 1 (index) to 12 (autocontinue); 0 for the whole line.
    pub column: u8,
    /// The fault.
    pub fault: Fault,
}

impl Error {
    /// Returns the column's name; empty for the whole line.
    pub fn column_name(&self) -> &'static str {
        let at = self.column.checked_sub(1).map(usize::from);
        at.and_then(|at| COLUMNS.get(at)).copied().unwrap_or_default()
    }
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let column = self.column_name();
        let space = if column.is_empty() { "" } else { " " };
        write!(f, "line {}{space}{column}: {}", self.line, self.fault)
    }
}

impl core::error::Error for Error {}

/// Reads a plan from a file in blocks of any length.
///
/// Use the items only after [`finish`](Self::finish) has succeeded, because a fault may be found at the end of the
/// file.
#[derive(Clone, Debug)]
pub struct Reader {
    home_row: HomeRow,
    numbered: bool,
    home: Option<Item>,
    /// Rows so far, home included.
    rows: u16,
    /// Whether the header was read.
    in_rows: bool,
    /// The first fault, after which nothing is read.
    error: Option<Error>,
    line: u32,
    /// Columns of this line so far.
    column: u8,
    is_comment: bool,
    /// The bytes of the current column so far.
    text: Vec<u8, MAX_COLUMN>,
    item: Item,
    /// The largest target of a jump, and the line of that jump.
    farthest: Option<(u16, u32)>,
}

impl Reader {
    /// Returns a reader for one file. `home_row` gives the meaning of row 0 of a version 110 file.
    pub const fn new(home_row: HomeRow) -> Self {
        Self {
            home_row,
            numbered: false,
            home: None,
            rows: 0,
            in_rows: false,
            error: None,
            line: 1,
            column: 0,
            is_comment: false,
            text: Vec::new(),
            item: Item {
                frame: MavFrame::GLOBAL,
                command: MavCmd(0),
                autocontinue: 0,
                params: [0.0; 4],
                x: 0,
                y: 0,
                z: 0.0,
            },
            farthest: None,
        }
    }

    /// Requires that the rows are numbered 0, 1, 2… By default the index is ignored, as in other readers.
    #[must_use]
    pub const fn numbered(mut self) -> Self {
        self.numbered = true;
        self
    }

    /// Returns the planned home; `None` until its row was read.
    pub const fn home(&self) -> Option<Item> {
        self.home
    }

    /// Reads to the end of the next item's line, and removes the bytes that it has read from the front of `bytes`.
    /// Returns `None` when it has read all of them.
    ///
    /// # Errors
    ///
    /// The first fault of the file. All later calls return the same error.
    pub fn next(&mut self, bytes: &mut &[u8]) -> Result<Option<Item>, Error> {
        self.error.map_or(Ok(()), Err)?;
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            match self.byte(byte) {
                Ok(false) => {}
                Ok(true) => return Ok(Some(self.item)),
                Err((column, fault)) => return Err(self.fail(self.line, column, fault)),
            }
        }
        Ok(None)
    }

    /// Ends the file. Returns the item of the last line if that line has no end.
    ///
    /// # Errors
    ///
    /// The first fault of the file. Two faults are found only here: there is no header ([`Header`](Fault::Header)), or
    /// the target of a jump is not a row ([`Jump`](Fault::Jump)).
    pub fn finish(&mut self) -> Result<Option<Item>, Error> {
        let last = self.line;
        let item = self.next(&mut b"\n".as_slice())?;
        match self.farthest {
            _ if !self.in_rows => Err(self.fail(last, 0, Fault::Header)),
            Some((row, line)) if row >= self.rows => Err(self.fail(line, JUMP, Fault::Jump)),
            _ => Ok(item),
        }
    }

    fn fail(&mut self, line: u32, column: u8, fault: Fault) -> Error {
        *self.error.insert(Error { line, column, fault })
    }

    /// Reads a byte. Returns whether it ends the line of an item, which is then in `item`. An error has the column's
    /// number.
    fn byte(&mut self, byte: u8) -> Result<bool, (u8, Fault)> {
        let mut is_item = false;
        if byte.is_ascii_whitespace() {
            if !self.text.is_empty() {
                self.column = self.column.saturating_add(1);
                self.column()?;
                self.text.clear();
            }
            if byte == b'\n' {
                is_item = self.end_of_line()?;
                self.line = self.line.saturating_add(1);
                self.column = 0;
                self.is_comment = false;
            }
        } else if self.is_comment || (byte == b'#' && self.column == 0 && self.text.is_empty()) {
            self.is_comment = true;
        } else if self.text.push(byte).is_err() {
            return Err(match self.column.saturating_add(1) {
                _ if !self.in_rows => (0, Fault::Header),
                column @ 1..=12 => (column, Fault::TooLong),
                _ => (0, Fault::Columns),
            });
        } else if self.line == 1 && self.column == 0 && self.text == BYTE_ORDER_MARK {
            self.text.clear();
        }
        Ok(is_item)
    }

    /// Handles the end of a column. An error has the column's number, or 0 for the whole line.
    fn column(&mut self) -> Result<(), (u8, Fault)> {
        if !self.in_rows {
            return self.header_column().map_err(|fault| (0, fault));
        }
        self.row_column().map_err(|fault| (if fault == Fault::Columns { 0 } else { self.column }, fault))
    }

    /// Handles the end of a column of the header.
    fn header_column(&mut self) -> Result<(), Fault> {
        match (self.column, self.text.as_slice()) {
            (1, b"QGC") | (2, b"WPL") | (3, b"110") => Ok(()),
            (3, b"120") => {
                self.home_row = HomeRow::None;
                Ok(())
            }
            (3, _) => Err(Fault::Version),
            _ => Err(Fault::Header),
        }
    }

    /// Handles the end of a column of a row.
    fn row_column(&mut self) -> Result<(), Fault> {
        let text = self.text.as_slice();
        let item = &mut self.item;
        let column = self.column;
        match column {
            1..=4 | 12 => {
                let value = decimal::parse_integer(text)?;
                if matches!(column, 1 | 4) {
                    if column == 4 {
                        item.command = MavCmd(value);
                    } else if self.numbered && value != self.rows {
                        return Err(Fault::Index);
                    }
                    return Ok(());
                }
                let value = u8::try_from(value).map_err(|_| Fault::Range)?;
                match column {
                    3 => item.frame = MavFrame(value),
                    12 => item.autocontinue = value,
                    _ => {}
                }
                scale(item.frame).ok_or(Fault::Frame)?;
            }
            9 | 10 => {
                let is_home = self.home_row == HomeRow::First && self.rows == 0;
                let decimals = decimals(item, is_home).ok_or(Fault::Frame)?;
                let value = decimal::parse_scaled(text, decimals)?;
                if is_wrongly_scaled(item, value, decimals) {
                    return Err(Fault::Range);
                }
                *(if column == 9 { &mut item.x } else { &mut item.y }) = value;
            }
            _ => {
                let [param1, param2, param3, param4] = &mut item.params;
                let field = match column {
                    5 => param1,
                    6 => param2,
                    7 => param3,
                    8 => param4,
                    11 => &mut item.z,
                    _ => return Err(Fault::Columns),
                };
                *field = decimal::parse_f32(text)?;
            }
        }
        Ok(())
    }

    /// Handles the end of a line. Returns whether it has an item. An error has the column's number.
    fn end_of_line(&mut self) -> Result<bool, (u8, Fault)> {
        if self.column == 0 {
            return Ok(false);
        }
        if !self.in_rows {
            self.in_rows = self.column == 3;
            return if self.in_rows { Ok(false) } else { Err((0, Fault::Header)) };
        }
        if self.column != 12 {
            return Err((0, Fault::Columns));
        }
        let row = self.rows;
        self.rows = row.checked_add(1).ok_or((0, Fault::TooMany))?;
        let has_home = self.home_row == HomeRow::First;
        if has_home && row == 0 {
            // Old versions of Mission Planner write command 0 if they know no home.
            if self.item.command == MavCmd(0) {
                self.item.command = MavCmd::NAV_WAYPOINT;
            }
            self.home = Some(self.item);
            return Ok(false);
        }
        if let Some(target) = jump_target(&self.item) {
            let target = target.map_err(|fault| (JUMP, fault))?;
            if self.farthest.is_none_or(|(row, _)| row < target) {
                self.farthest = Some((target, self.line));
            }
            if has_home {
                let [param1, ..] = &mut self.item.params;
                *param1 = target.checked_sub(1).ok_or((JUMP, Fault::Jump))?.into();
            }
        }
        Ok(true)
    }
}
