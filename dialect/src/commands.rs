//! The typed commands: from the parameters of `MAV_CMD`'s entries to declarations of `mavstack`'s `command!`, one a
//! command, one line a parameter.
//!
//! - A parameter without a label, or reserved, has no field. A command without fields has no type.
//! - Parameters 5, 6, 7 of a command with a location are one field, `location`. Where the unit of 5 or 6 is a length, the
//!   place is not on the globe: such a command has no type.
//! - A label becomes a name in snake case: `Accept Radius` → `accept_radius`. A keyword is written raw; where two would be
//!   the same, the later has the number of its parameter behind it.
//! - The type follows the rule of the parameter (see `rules`): an enumeration is its type, and MAV_BOOL a `bool`; an
//!   integer is the smallest type that holds its range; all else is an `f32`. It is an `Option` exactly where NaN passes.

use crate::{
    Dialect,
    doc::Doc,
    model::{Entry, Enum, Param},
    names::{self, COMMANDS},
    rules::{self, Values},
};
use std::{collections::HashSet, fmt::Write as _};

/// The enumeration of two values that is a `bool`.
const BOOL: &str = "MAV_BOOL";

/// An enumeration's type, as the module of commands names it.
pub(crate) type TypeOf<'a> = &'a dyn Fn(&str) -> String;

/// A type to write.
struct Command<'a> {
    entry: &'a Entry,
    /// Of the rule.
    constant: String,
    name: String,
}

/// The enumerations that the fields of a command's type have.
pub(crate) fn enumerations<'a>(dialect: &'a Dialect, entry: &'a Entry) -> impl Iterator<Item = &'a Enum> {
    let rules = fields(entry).into_iter().flatten().filter_map(|param| rules::rule(dialect, entry, param));
    rules.filter_map(|rule| match rule.values_are {
        Values::Enum(enumeration) if enumeration.name != BOOL => Some(enumeration),
        _ => None,
    })
}

/// Writes the module of the commands of which `is_selected` says so; nothing when none of them has fields.
pub(crate) fn write(
    out: &mut String,
    dialect: &Dialect,
    commands: &Enum,
    crate_path: &str,
    type_of: TypeOf,
    is_selected: impl Fn(&Entry) -> bool,
) {
    let mut taken: HashSet<String> = names::RESERVED_TYPES.map(str::to_owned).into();
    taken.insert("Location".into());
    // All are named, so that a name does not depend on the selection.
    let named = commands.entries.iter().zip(names::constants(commands)).map(|(entry, constant)| {
        let name = names::camel(&constant);
        let name = if name.starts_with(|c: char| c.is_ascii_digit()) { format!("_{name}") } else { name };
        Command { entry, constant, name: names::unique(&mut taken, &name, "Command") }
    });
    let written: Vec<_> = named.filter(|command| is_selected(command.entry)).collect();
    let written: Vec<_> = written.iter().filter_map(|command| Some((command, fields(command.entry)?))).collect();
    if written.is_empty() {
        return;
    }
    let mut doc = Doc::new();
    doc.text(&format!(
        "The commands of `{COMMANDS}` that have parameters, these under their names. A type costs flash where a firmware \
         decodes it."
    ));
    out.push('\n');
    doc.write(out, "/// ");
    out.push_str("#[allow(dead_code, reason = \"a firmware decodes a few\")]\npub mod commands {\n");
    out.push_str("    use super::command_rules;\n");
    if written.iter().any(|(command, _)| is_located(command.entry)) {
        let _ = writeln!(out, "    use {crate_path}::Location;");
    }
    for (command, params) in written {
        out.push('\n');
        declaration(out, dialect, command, &params, crate_path, type_of);
    }
    out.push_str("}\n");
}

fn declaration(
    out: &mut String,
    dialect: &Dialect,
    command: &Command<'_>,
    params: &[&Param],
    crate_path: &str,
    type_of: TypeOf,
) {
    let Command { entry, constant, name } = command;
    let _ = writeln!(out, "    {crate_path}::command! {{");
    let mut doc = Doc::new();
    if entry.description.is_empty() {
        doc.text(&format!("`{}`.", entry.name));
    } else {
        doc.prose(&entry.description);
    }
    doc.lifecycle(entry.lifecycle.as_ref());
    doc.write(out, "        /// ");
    let _ = writeln!(out, "        pub struct {name} = command_rules::{constant} {{");
    let mut taken = HashSet::from(["location".to_owned()]);
    for param in params {
        let field = names::unique(&mut taken, &field_name(param), &format!("_{}", param.index));
        param_doc(param).write(out, "            /// ");
        let ty = field_type(dialect, entry, param, type_of);
        let _ = writeln!(out, "            {}: {ty} = {},", names::field(&field), param.index);
    }
    if is_located(entry) {
        out.push_str("            location: Location = 5,\n");
    }
    out.push_str("        }\n    }\n");
}

/// The parameters that have a field of their own; nothing when the command has no type.
fn fields(entry: &Entry) -> Option<Vec<&Param>> {
    let is_place = |param: &Param| is_located(entry) && param.index >= 5;
    let is_length = |param: &Param| matches!(param.index, 5 | 6) && matches!(param.units.as_str(), "m" | "cm" | "mm");
    if u16::try_from(entry.value).is_err() || (is_located(entry) && entry.params.iter().any(is_length)) {
        return None;
    }
    let fields: Vec<_> = entry.params.iter().filter(|param| rules::is_used(param) && !is_place(param)).collect();
    (is_located(entry) || !fields.is_empty()).then_some(fields)
}

fn is_located(entry: &Entry) -> bool {
    entry.has_location == Some(true)
}

fn field_type(dialect: &Dialect, entry: &Entry, param: &Param, type_of: TypeOf) -> String {
    let Some(rule) = rules::rule(dialect, entry, param) else { return "Option<f32>".into() };
    let ty = match rule.values_are {
        Values::Floats => "f32".into(),
        Values::Integers(minimum, maximum) => integer(minimum, maximum).into(),
        Values::Enum(enumeration) if enumeration.name == BOOL => "bool".into(),
        Values::Enum(enumeration) => type_of(&enumeration.name),
    };
    if rule.may_be_nan { format!("Option<{ty}>") } else { ty }
}

/// The smallest that holds the range.
fn integer(minimum: Option<f64>, maximum: Option<f64>) -> &'static str {
    let (least, most) = (minimum.unwrap_or(f64::MIN), maximum.unwrap_or(f64::MAX));
    let holds = |min: f64, max: f64| min <= least && most <= max;
    match least {
        0.0.. if holds(0.0, u8::MAX.into()) => "u8",
        0.0.. if holds(0.0, u16::MAX.into()) => "u16",
        0.0.. => "u32",
        _ if holds(i8::MIN.into(), i8::MAX.into()) => "i8",
        _ if holds(i16::MIN.into(), i16::MAX.into()) => "i16",
        _ => "i32",
    }
}

/// `Accept Radius` → `accept_radius`, `UseAltitude` → `use_altitude`; what is no letter or digit divides words.
fn field_name(param: &Param) -> String {
    let mut name = String::new();
    let mut before = ' ';
    for c in param.label.chars() {
        let is_new_word = before.is_ascii_lowercase() && c.is_ascii_uppercase();
        if (is_new_word || !c.is_ascii_alphanumeric()) && !name.is_empty() && !name.ends_with('_') {
            name.push('_');
        }
        if c.is_ascii_alphanumeric() {
            name.push(c.to_ascii_lowercase());
        }
        before = c;
    }
    let name = name.trim_end_matches('_');
    match name.chars().next() {
        None => format!("param{}", param.index),
        Some(first) if first.is_ascii_digit() => format!("_{name}"),
        _ if names::REFUSED_FIELDS.contains(&name) => format!("{name}_"),
        _ => name.to_owned(),
    }
}

/// Unit and range; the name says the rest.
fn param_doc(param: &Param) -> Doc {
    let mut doc = Doc::new();
    doc.prose(&param.description);
    if !param.units.is_empty() {
        doc.text(&format!("({})", crate::doc::escape(&param.units)));
    }
    if let Some(range) = crate::doc::range(param.minimum, param.maximum) {
        doc.text(&format!("Range: {range}."));
    }
    if !param.multiplier.is_empty() {
        doc.text(&format!("In units of `{}`.", param.multiplier));
    }
    if let Some(default) = param.default {
        doc.text(&format!("Default: {default}."));
    }
    doc
}
