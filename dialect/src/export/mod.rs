//! The other way round: a definition of the messages and commands that a firmware declares in Rust, for ground stations and mavgen,
//! which read only XML.
//!
//! ```text
//!   .rs ─▶ source: declarations ─▶ model: what they mean ─▶ xml ─▶ .xml
//!           tokens ─┘               rule ─┘
//! ```

mod model;
mod rule;
mod source;
mod tokens;
mod xml;

use std::path::Path;
use std::sync::Arc;

use crate::{Error, load};

/// Returns the definition, in XML, of what a Rust file declares by `mavstack`'s macros `message!`, `command!`, `wire_enum!` and
/// `wire_bitmask!`. It includes `common.xml`, whose enumerations fields may have. The file is read, not compiled:
///
/// - A field's type is a number, `Text<N>`, an array whose length is a number, or an enumeration of this file or of common.
/// - A value for "not known" is a number, a limit such as `u16::MAX`, NaN, an entry, or `[…; N]` of one of them.
/// - The rule of a command is a constant in this file, made by `CommandRule::without_position` or `at_position`, and the constructors
///   of `ParamRule`. Its name is the command's: `WINCH_SPEED` is MAV_CMD_WINCH_SPEED. What the definitions cannot express is left
///   out: an optional position.
/// - A unit in parentheses in a doc comment, such as `(mm)`, becomes the field's unit, if it is one of MAVLink.
///
/// Tests are left out: what is behind `#[cfg(test)]`.
///
/// # Errors
///
/// A declaration that has no XML, with its line; or the definition contradicts common, for example in an id.
pub fn export(file: &Path) -> Result<String, Error> {
    let unreadable = |error: std::io::Error| Error::whole(file, "the file", format!("cannot be read: {error}"));
    let rust = std::fs::read_to_string(file).map_err(unreadable)?;
    let shared: Arc<Path> = file.into();
    let source = source::read(&shared, &rust)?;
    if source.messages.is_empty() && source.commands.is_empty() {
        return Err(Error::whole(file, "the file", "declares no message and no command"));
    }
    let text = xml::written(&model::definition(&source, &load::common()?)?);
    // What loads has no id or name twice.
    load::text(&file.with_extension("xml"), &text)?;
    Ok(text)
}
