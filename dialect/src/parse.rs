//! Parses an XML file to its model. Unknown elements and attributes are refused, so that a mistyped `<field>` or
//! `minValue` is not ignored silently.

use crate::{
    Error,
    model::{Entry, Enum, Field, Lifecycle, Message, Origin, Param, Replacement, Scalar},
    names,
};
use roxmltree::{Document, Node};
use std::{path::Path, str::FromStr, sync::Arc};

/// Maximum length of a payload in bytes.
const MAX_PAYLOAD: usize = 255;
/// Maximum number of fields in a message, as in MAVLink's generators.
const MAX_FIELDS: usize = 64;

/// The attributes of each element in MAVLink's schema, including those that are not used.
const OF_ENUM: &[&str] = &["name", "bitmask"];
const OF_ENTRY: &[&str] = &[
    "name",
    "value",
    "hasLocation",
    "hasAltitudeOnly",
    "isDestination",
    "missionOnly",
    "mission",
    "fence",
    "rally",
    "command",
];
const OF_PARAM: &[&str] = &[
    "index",
    "label",
    "units",
    "enum",
    "minValue",
    "maxValue",
    "increment",
    "default",
    "reserved",
    "multiplier",
    "decimalPlaces",
    "instance",
];
const OF_MESSAGE: &[&str] = &["id", "name"];
const OF_FIELD: &[&str] = &[
    "type",
    "name",
    "enum",
    "units",
    "minValue",
    "maxValue",
    "increment",
    "default",
    "invalid",
    "instance",
    "multiplier",
    "display",
    "print_format",
];

/// A parsed file. Its includes are not yet read.
pub(crate) struct File {
    pub includes: Vec<Include>,
    pub enums: Vec<Enum>,
    pub messages: Vec<Message>,
}

pub(crate) struct Include {
    pub name: String,
    pub origin: Origin,
}

/// The context for parsing a document.
struct Source {
    file: Arc<Path>,
    /// Offsets of the lines' first bytes, from the second line on.
    lines: Vec<usize>,
    /// The version of the definitions, which HEARTBEAT reports.
    version: u8,
}

pub(crate) fn parse(file: &Arc<Path>, text: &str) -> Result<File, Error> {
    let document = Document::parse(text).map_err(|error| Error {
        file: file.to_path_buf(),
        line: Some(error.pos().row),
        element: "XML".into(),
        problem: format!("{error}; write well-formed XML without DTD"),
    })?;
    let lines = text.bytes().enumerate().filter(|&(_, byte)| byte == b'\n').map(|(at, _)| at + 1).collect();
    let mut source = Source { file: file.clone(), lines, version: 2 };

    let root = document.root_element();
    source.expect(&root, &["mavlink"], "the file")?;
    let mut parsed = File { includes: Vec::new(), enums: Vec::new(), messages: Vec::new() };
    for node in elements(&root) {
        match node.tag_name().name() {
            "include" => parsed.includes.push(Include { name: text_of(&node), origin: source.origin(&node) }),
            "version" => {
                let text = text_of(&node);
                source.version =
                    text.parse().map_err(|_| source.error(&node, "version", not_a(&text, "number from 0 to 255")))?;
            }
            "enums" => {
                for node in elements(&node) {
                    source.expect(&node, &["enum"], "<enums>")?;
                    parsed.enums.push(source.enumeration(&node)?);
                }
            }
            "messages" => {
                for node in elements(&node) {
                    source.expect(&node, &["message"], "<messages>")?;
                    parsed.messages.push(source.message(&node)?);
                }
            }
            _ => source.expect(&node, &["include", "version", "dialect", "enums", "messages"], "<mavlink>")?,
        }
    }
    Ok(parsed)
}

impl Source {
    fn origin(&self, node: &Node) -> Origin {
        let before = self.lines.partition_point(|&start| start <= node.range().start);
        Origin { file: self.file.clone(), line: u32::try_from(before + 1).unwrap_or(u32::MAX) }
    }

    fn error(&self, node: &Node, element: impl Into<String>, problem: impl Into<String>) -> Error {
        self.origin(node).error(element, problem)
    }

    /// Refuses an element whose name is not one of `names`.
    fn expect(&self, node: &Node, names: &[&str], inside: &str) -> Result<(), Error> {
        let name = node.tag_name().name();
        if names.contains(&name) {
            return Ok(());
        }
        let names: Vec<_> = names.iter().map(|name| format!("<{name}>")).collect();
        Err(self.error(node, name, format!("no such element in {inside}; use one of {}", names.join(", "))))
    }

    /// Refuses attributes whose names are not in `names`.
    fn expect_attributes(&self, node: &Node, element: &str, names: &[&str]) -> Result<(), Error> {
        match node.attributes().find(|attribute| !names.contains(&attribute.name())) {
            None => Ok(()),
            Some(unknown) => {
                let problem = format!("no such attribute: {}; use one of {}", unknown.name(), names.join(", "));
                Err(self.error(node, element, problem))
            }
        }
    }

    fn enumeration(&self, node: &Node) -> Result<Enum, Error> {
        let name = self.name(node, "enum", "")?;
        let element = format!("enum {name}");
        self.expect_attributes(node, &element, OF_ENUM)?;
        let mut entries: Vec<Entry> = Vec::new();
        // An entry without a value has one more than the largest value so far.
        let mut next = 1;
        for child in elements(node) {
            self.expect(&child, &["entry", "description", "wip", "deprecated", "superseded"], "<enum>")?;
            if child.has_tag_name("entry") {
                let entry = self.entry(&child, &name, next)?;
                next = next.max(entry.value.saturating_add(1));
                entries.push(entry);
            }
        }
        Ok(Enum {
            bitmask: self.flag(node, &element, "bitmask")?.unwrap_or(false),
            description: description(node),
            lifecycle: self.lifecycle(node, &element)?,
            entries,
            origin: self.origin(node),
            name,
        })
    }

    fn entry(&self, node: &Node, parent: &str, next: i128) -> Result<Entry, Error> {
        let name = self.name(node, "entry", parent)?;
        let element = format!("entry {parent}.{name}");
        self.expect_attributes(node, &element, OF_ENTRY)?;
        let value = match node.attribute("value") {
            None => next,
            Some(text) => integer(text.trim())
                .ok_or_else(|| self.error(node, &element, not_a(text, "number: write 5, 0x1F, 0b101 or 2**4")))?,
        };
        if Scalar::U64.range().is_none_or(|(_, max)| value > max) || value < i64::MIN.into() {
            return Err(self.error(
                node,
                element,
                format!("the value {value} does not fit in 64 bits; use a smaller one"),
            ));
        }
        let mut params: Vec<Param> = Vec::new();
        for child in elements(node) {
            self.expect(&child, &["param", "description", "wip", "deprecated", "superseded"], "<entry>")?;
            if child.has_tag_name("param") {
                let param = self.param(&child, &element)?;
                if params.iter().any(|other| other.index == param.index) {
                    let problem = format!("param {} is defined twice; remove one", param.index);
                    return Err(self.error(&child, element, problem));
                }
                params.push(param);
            }
        }
        params.sort_by_key(|param| param.index);
        Ok(Entry {
            value,
            description: description(node),
            lifecycle: self.lifecycle(node, &element)?,
            has_location: self.flag(node, &element, "hasLocation")?,
            is_destination: self.flag(node, &element, "isDestination")?,
            has_altitude_only: self.flag(node, &element, "hasAltitudeOnly")?.unwrap_or(false),
            mission_only: self.flag(node, &element, "missionOnly")?.unwrap_or(false),
            in_mission: self.flag(node, &element, "mission")?.unwrap_or(false),
            in_fence: self.flag(node, &element, "fence")?.unwrap_or(false),
            in_rally: self.flag(node, &element, "rally")?.unwrap_or(false),
            as_command: self.flag(node, &element, "command")?.unwrap_or(false),
            params,
            origin: self.origin(node),
            name,
        })
    }

    fn param(&self, node: &Node, parent: &str) -> Result<Param, Error> {
        let element = format!("param of {parent}");
        self.expect_attributes(node, &element, OF_PARAM)?;
        let index: u8 = self.number(node, &element, "index")?.ok_or_else(|| self.missing(node, &element, "index"))?;
        if !(1..=7).contains(&index) {
            return Err(self.error(node, element, format!("the index is {index}; use one of params 1 to 7")));
        }
        Ok(Param {
            index,
            label: text_attribute(node, "label"),
            units: text_attribute(node, "units"),
            enumeration: text_attribute(node, "enum"),
            minimum: self.number(node, &element, "minValue")?,
            maximum: self.number(node, &element, "maxValue")?,
            increment: self.number(node, &element, "increment")?,
            default: self.number(node, &element, "default")?,
            reserved: self.flag(node, &element, "reserved")?.unwrap_or(false),
            multiplier: text_attribute(node, "multiplier"),
            description: text_of(node),
        })
    }

    fn message(&self, node: &Node) -> Result<Message, Error> {
        let name = self.name(node, "message", "")?;
        let element = format!("message {name}");
        self.expect_attributes(node, &element, OF_MESSAGE)?;
        let id: u32 = self.number(node, &element, "id")?.ok_or_else(|| self.missing(node, &element, "id"))?;
        if id >= 1 << 24 {
            return Err(self.error(
                node,
                element,
                format!("the id {id} has more than 24 bits; use one below 16777216"),
            ));
        }
        let mut fields: Vec<Field> = Vec::new();
        let mut extension = false;
        for child in elements(node) {
            self.expect(
                &child,
                &["field", "extensions", "description", "wip", "deprecated", "superseded"],
                "<message>",
            )?;
            if child.has_tag_name("extensions") {
                if extension {
                    return Err(self.error(&child, element, "<extensions> is there twice; remove one"));
                }
                extension = true;
            }
            if child.has_tag_name("field") {
                let field = self.field(&child, &name, extension)?;
                if let Some(first) = fields.iter().find(|first| first.name == field.name) {
                    let problem = format!("this name is taken by the field in line {}; use another", first.origin.line);
                    return Err(self.error(&child, format!("field {name}.{}", field.name), problem));
                }
                fields.push(field);
            }
        }
        let message = Message {
            id,
            description: description(node),
            lifecycle: self.lifecycle(node, &element)?,
            fields,
            origin: self.origin(node),
            name,
        };
        let (count, length) = (message.fields.len(), message.max_len());
        if message.base_len() == 0 {
            return Err(self.error(node, element, "there is no field before <extensions>; add at least one"));
        }
        if count > MAX_FIELDS {
            let problem = format!("{count} fields, of at most {MAX_FIELDS}; use arrays, or split the message");
            return Err(self.error(node, element, problem));
        }
        if length > MAX_PAYLOAD {
            let problem = format!(
                "the payload has {length} bytes, of at most {MAX_PAYLOAD}; shorten arrays, or split the message"
            );
            return Err(self.error(node, element, problem));
        }
        Ok(message)
    }

    fn field(&self, node: &Node, parent: &str, extension: bool) -> Result<Field, Error> {
        let name = self.name(node, "field", parent)?;
        let element = format!("field {parent}.{name}");
        self.expect_attributes(node, &element, OF_FIELD)?;
        if names::REFUSED_FIELDS.contains(&name.as_str()) {
            return Err(self.error(node, element, "a field cannot have this name in Rust; use another"));
        }
        let text = node.attribute("type").ok_or_else(|| self.missing(node, &element, "type"))?;
        let (scalar, array) = field_type(text).map_err(|problem| self.error(node, &element, problem))?;
        let own_text = text_of(node);
        Ok(Field {
            scalar,
            array,
            version: (text == "uint8_t_mavlink_version").then_some(self.version),
            extension,
            units: text_attribute(node, "units"),
            enumeration: text_attribute(node, "enum"),
            invalid: text_attribute(node, "invalid"),
            multiplier: text_attribute(node, "multiplier"),
            minimum: self.number(node, &element, "minValue")?,
            maximum: self.number(node, &element, "maxValue")?,
            default: self.number(node, &element, "default")?,
            instance: self.flag(node, &element, "instance")?.unwrap_or(false),
            display: text_attribute(node, "display"),
            print_format: text_attribute(node, "print_format"),
            description: if own_text.is_empty() { description(node) } else { own_text },
            origin: self.origin(node),
            name,
        })
    }

    fn lifecycle(&self, node: &Node, element: &str) -> Result<Option<Lifecycle>, Error> {
        for child in elements(node) {
            let replacement = || -> Result<Replacement, Error> {
                let attribute =
                    |name| child.attribute(name).map(str::to_owned).ok_or_else(|| self.missing(&child, element, name));
                Ok(Replacement { since: attribute("since")?, replaced_by: attribute("replaced_by")? })
            };
            return Ok(Some(match child.tag_name().name() {
                "wip" => Lifecycle::WorkInProgress,
                "deprecated" => Lifecycle::Deprecated(replacement()?),
                "superseded" => Lifecycle::Superseded(replacement()?),
                _ => continue,
            }));
        }
        Ok(None)
    }

    /// Returns the attribute `name`, which becomes an identifier in all languages and a part of `CRC_EXTRA`.
    fn name(&self, node: &Node, kind: &str, parent: &str) -> Result<String, Error> {
        let element = if parent.is_empty() { kind.to_owned() } else { format!("{kind} of {parent}") };
        let name = node.attribute("name").ok_or_else(|| self.missing(node, &element, "name"))?;
        let letter = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.chars().all(letter) && name.starts_with(|c: char| c.is_ascii_alphabetic()) {
            return Ok(name.to_owned());
        }
        let problem = not_a(name, "name; begin with a letter, and use only A to Z, a to z, 0 to 9 and _");
        Err(self.error(node, element, problem))
    }

    fn flag(&self, node: &Node, element: &str, name: &str) -> Result<Option<bool>, Error> {
        match node.attribute(name).map(str::trim) {
            None => Ok(None),
            Some("true" | "1") => Ok(Some(true)),
            Some("false" | "0") => Ok(Some(false)),
            Some(text) => {
                Err(self.error(node, element, format!("{name}: `{text}` is not a boolean; use `true` or `false`")))
            }
        }
    }

    fn number<T: FromStr>(&self, node: &Node, element: &str, name: &str) -> Result<Option<T>, Error> {
        let Some(text) = node.attribute(name).map(str::trim) else { return Ok(None) };
        // `integer` accepts more notations than `parse`.
        let number = text.parse().ok().or_else(|| integer(text)?.to_string().parse().ok());
        match number {
            Some(number) => Ok(Some(number)),
            None => Err(self.error(node, element, format!("{name}: {}", not_a(text, "number that fits")))),
        }
    }

    fn missing(&self, node: &Node, element: &str, attribute: &str) -> Error {
        self.error(node, element, format!("the attribute `{attribute}` is missing; add it"))
    }
}

fn not_a(text: &str, what: &str) -> String {
    format!("`{text}` is not a {what}")
}

fn elements<'a, 'input: 'a>(node: &Node<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> + use<'a, 'input> {
    node.children().filter(Node::is_element)
}

/// Returns an element's own text, with normalised white space.
fn text_of(node: &Node) -> String {
    let text: String = node.children().filter(Node::is_text).filter_map(|text| text.text()).collect();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn description(node: &Node) -> String {
    elements(node).find(|child| child.has_tag_name("description")).map(|child| text_of(&child)).unwrap_or_default()
}

fn text_attribute(node: &Node, name: &str) -> String {
    node.attribute(name).map(str::trim).unwrap_or_default().to_owned()
}

/// Parses an integer in a notation of MAVLink's schema: `5`, `0x1F`, `0b101`, `2**4`.
pub(crate) fn integer(text: &str) -> Option<i128> {
    if let Some((base, exponent)) = text.split_once("**") {
        return base.trim().parse::<i128>().ok()?.checked_pow(exponent.trim().parse().ok()?);
    }
    let lower = text.to_ascii_lowercase();
    match (lower.strip_prefix("0x"), lower.strip_prefix("0b")) {
        (Some(digits), _) => i128::from_str_radix(digits, 16).ok(),
        (_, Some(digits)) => i128::from_str_radix(digits, 2).ok(),
        _ => lower.parse().ok(),
    }
}

/// Parses a field's type: a scalar, and the length if it is an array.
fn field_type(text: &str) -> Result<(Scalar, Option<u8>), String> {
    let (element, array) = match text.split_once('[') {
        None => (text, None),
        Some((element, length)) => {
            let length = length.strip_suffix(']').and_then(|digits| digits.parse::<u8>().ok()).filter(|&n| n > 0);
            let length = length.ok_or_else(|| not_a(text, "type: the length of an array is from 1 to 255"))?;
            (element, Some(length))
        }
    };
    if text == "uint8_t_mavlink_version" {
        return Ok((Scalar::U8, None));
    }
    let scalar = Scalar::ALL.into_iter().find(|scalar| scalar.wire_name() == element).ok_or_else(|| {
        let names: Vec<_> = Scalar::ALL.iter().map(|scalar| scalar.wire_name()).collect();
        format!("unknown type `{element}`; use one of {}", names.join(", "))
    })?;
    Ok((scalar, array))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_in_all_notations_of_the_schema() {
        for (text, value) in [("17", 17), ("-3", -3), ("0x1F", 31), ("0B101", 5), ("2**4", 16)] {
            assert_eq!(integer(text), Some(value), "{text}");
        }
        for text in ["", "x", "0x", "1.5", "2**", "2**999", "99999999999999999999999999999999999999999"] {
            assert_eq!(integer(text), None, "{text}");
        }
    }

    #[test]
    fn types_are_scalars_and_arrays() {
        assert_eq!(field_type("char[16]"), Ok((Scalar::Char, Some(16))));
        assert_eq!(field_type("char"), Ok((Scalar::Char, None)));
        assert_eq!(field_type("uint8_t_mavlink_version"), Ok((Scalar::U8, None)));
        for text in ["uint7_t", "float[0]", "float[256]", "float[", "float[3]x", "", "[3]"] {
            assert!(field_type(text).is_err(), "{text}");
        }
    }
}
