//! The typed commands: declarations of `mavstack`'s `command!`, one for each command, from the parameters of
//! `MAV_CMD`'s entries.
//!
//! - A parameter without a label, or a reserved one, has no field. A command without fields has no type.
//! - Parameters 5, 6 and 7 of a command with a location are one field, `location`. If the unit of 5 or 6 is a length,
//!   the location is not on the globe, and the command has no type.
//! - A label becomes a name in snake case: `Accept Radius` → `accept_radius`. A keyword is written raw. If two names
//!   are equal, the number of its parameter is appended to the second.
//! - The type of a field follows the parameter's rule (see `rules`). An enumeration has its own type, and MAV_BOOL is a
//!   `bool`. An integer has the smallest type that holds its range. Everything else is an `f32`. The type is an
//!   `Option` if the rule allows NaN.

use crate::{
    Dialect,
    doc::Doc,
    model::{Entry, Enum, Param},
    names::{self, COMMANDS},
    rules::{self, Values},
};
use std::{collections::HashSet, fmt::Write as _};

/// The enumeration that becomes a `bool`.
pub(crate) const BOOL: &str = "MAV_BOOL";

/// Returns the path of an enumeration's type from inside the module of commands.
pub(crate) type TypeOf<'a> = &'a dyn Fn(&str) -> String;

/// A command for which a type is declared.
struct Command<'a> {
    entry: &'a Entry,
    /// Name of the constant with the rule.
    constant: String,
    /// Name of the type.
    name: String,
}

/// Returns the enumerations in the fields of a command's type.
pub(crate) fn enumerations<'a>(dialect: &'a Dialect, entry: &'a Entry) -> impl Iterator<Item = &'a Enum> {
    let rules = fields(entry).into_iter().flatten().filter_map(|param| rules::rule(dialect, entry, param));
    rules.filter_map(|rule| match rule.values_are {
        Values::Enum(enumeration) if enumeration.name != BOOL => Some(enumeration),
        _ => None,
    })
}

/// Writes the module with the types of the selected commands; nothing if none of them has fields.
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
    // Names all commands, so that a name does not depend on the selection.
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
        "The commands of `{COMMANDS}` that have parameters, as types with named fields. A type takes flash only if the \
         firmware decodes it."
    ));
    out.push('\n');
    doc.write(out, "/// ");
    out.push_str("#[allow(dead_code, reason = \"a firmware decodes only some commands\")]\npub mod commands {\n");
    out.push_str("    use super::rules;\n");
    if written.iter().any(|(command, _)| is_located(command.entry)) {
        let _ = writeln!(out, "    use {crate_path}::message::Location;");
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
    let _ = writeln!(out, "        pub struct {name} = rules::{constant} {{");
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

/// Returns the parameters that have a field of their own; `None` if the command has no type.
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

/// Returns the smallest type that holds the range.
fn integer(minimum: Option<f64>, maximum: Option<f64>) -> &'static str {
    let (minimum, maximum) = (minimum.unwrap_or(f64::MIN), maximum.unwrap_or(f64::MAX));
    let holds = |min: f64, max: f64| min <= minimum && maximum <= max;
    match minimum {
        0.0.. if holds(0.0, u8::MAX.into()) => "u8",
        0.0.. if holds(0.0, u16::MAX.into()) => "u16",
        0.0.. => "u32",
        _ if holds(i8::MIN.into(), i8::MAX.into()) => "i8",
        _ if holds(i16::MIN.into(), i16::MAX.into()) => "i16",
        _ => "i32",
    }
}

/// Converts a label to a field name: `Accept Radius` → `accept_radius`, `UseAltitude` → `use_altitude`. Characters
/// other than letters and digits separate words.
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

/// Returns the doc comment of a field: description, unit, range and default.
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
