//! Writes a definition in MAVLink's XML schema.

use std::fmt::Write as _;

use crate::Dialect;
use crate::model::{Entry, Enum, Field, Message, Param};

/// Returns the XML of a definition that includes common.
pub(super) fn written(dialect: &Dialect) -> String {
    let mut out = String::from(
        "<?xml version=\"1.0\"?>\n<!-- Made by mavstack-dialect from declarations in Rust: change these. -->\n",
    );
    out.push_str("<mavlink>\n  <include>common.xml</include>\n");
    if !dialect.enums.is_empty() {
        out.push_str("  <enums>\n");
        dialect.enums.iter().for_each(|e| enumeration(&mut out, e));
        out.push_str("  </enums>\n");
    }
    if !dialect.messages.is_empty() {
        out.push_str("  <messages>\n");
        dialect.messages.iter().for_each(|m| message(&mut out, m));
        out.push_str("  </messages>\n");
    }
    out.push_str("</mavlink>\n");
    out
}

fn enumeration(out: &mut String, enumeration: &Enum) {
    out.push_str("    <enum");
    attribute(out, "name", &enumeration.name);
    attribute(out, "bitmask", if enumeration.bitmask { "true" } else { "" });
    out.push_str(">\n");
    description(out, "      ", &enumeration.description);
    for item in &enumeration.entries {
        entry(out, item);
    }
    out.push_str("    </enum>\n");
}

fn entry(out: &mut String, entry: &Entry) {
    out.push_str("      <entry");
    attribute(out, "value", &entry.value.to_string());
    attribute(out, "name", &entry.name);
    attribute(out, "hasLocation", if entry.has_location == Some(true) { "true" } else { "" });
    out.push_str(">\n");
    description(out, "        ", &entry.description);
    for item in &entry.params {
        param(out, item);
    }
    out.push_str("      </entry>\n");
}

fn param(out: &mut String, param: &Param) {
    let number = |number: Option<f64>| number.map_or(String::new(), |number| number.to_string());
    out.push_str("        <param");
    attribute(out, "index", &param.index.to_string());
    attribute(out, "label", &param.label);
    attribute(out, "units", &param.units);
    attribute(out, "enum", &param.enumeration);
    attribute(out, "minValue", &number(param.minimum));
    attribute(out, "maxValue", &number(param.maximum));
    attribute(out, "increment", &number(param.increment));
    attribute(out, "default", &number(param.default));
    let _ = writeln!(out, ">{}</param>", escaped(&param.description));
}

fn message(out: &mut String, message: &Message) {
    out.push_str("    <message");
    attribute(out, "id", &message.id.to_string());
    attribute(out, "name", &message.name);
    out.push_str(">\n");
    // The schema asks for a description.
    let _ = writeln!(out, "      <description>{}</description>", escaped(&message.description));
    message.fields.iter().filter(|item| !item.extension).for_each(|item| field(out, item));
    if message.extensions().next().is_some() {
        out.push_str("      <extensions/>\n");
    }
    message.extensions().for_each(|item| field(out, item));
    out.push_str("    </message>\n");
}

fn field(out: &mut String, field: &Field) {
    let array = field.array.map_or(String::new(), |length| format!("[{length}]"));
    out.push_str("      <field");
    attribute(out, "type", &format!("{}{array}", field.scalar.wire_name()));
    attribute(out, "name", &field.name);
    attribute(out, "enum", &field.enumeration);
    attribute(out, "units", &field.units);
    attribute(out, "display", &field.display);
    attribute(out, "invalid", &field.invalid);
    let _ = writeln!(out, ">{}</field>", escaped(&field.description));
}

fn description(out: &mut String, indent: &str, text: &str) {
    if !text.is_empty() {
        let _ = writeln!(out, "{indent}<description>{}</description>", escaped(text));
    }
}

/// Writes an attribute; nothing if it is empty.
fn attribute(out: &mut String, name: &str, value: &str) {
    if !value.is_empty() {
        let _ = write!(out, " {name}=\"{}\"", escaped(value));
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
