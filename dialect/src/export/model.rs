//! What the declarations mean: the model of their definition, with MAVLink's names and types.

use std::collections::HashSet;

use proc_macro2::{Delimiter, TokenTree};

use super::rule::{self, Kind};
use super::source::{self, Source, only_group};
use super::tokens::split;
use crate::commands::BOOL;
use crate::model::{Entry, Enum, Field, Message, Param, Scalar};
use crate::names::{self, COMMANDS};
use crate::{Dialect, Error, Origin, emit, parse};

/// Returns the definition of what a file declares. `common` is what it may use besides.
pub(super) fn definition(source: &Source, common: &Dialect) -> Result<Dialect, Error> {
    let enums = source.enums.iter().map(enumeration).collect::<Result<Vec<_>, _>>()?;
    let mut types = Types { enums: Vec::new(), units: units(common) };
    types.enums.extend(common.enums.iter().map(|e| (names::camel(&e.name), e, emit::representation(common, e))));
    for (declared, meant) in source.enums.iter().zip(&enums) {
        let scalar = scalar(&declared.repr).ok_or_else(|| {
            let problem = format!("`{}` is no integer type of MAVLink", declared.repr);
            declared.origin.error(format!("enumeration {}", declared.name), problem)
        })?;
        types.enums.push((declared.name.clone(), meant, scalar));
    }
    let messages = source.messages.iter().map(|message| types.message(message)).collect::<Result<Vec<_>, _>>()?;
    let commands = source.commands.iter().map(|command| types.command(source, command));
    let entries = commands.collect::<Result<Vec<_>, _>>()?;
    let mut all = enums.clone();
    if let Some(first) = entries.first() {
        let origin = first.origin.clone();
        let (name, description) = (COMMANDS.to_owned(), String::new());
        all.push(Enum { name, bitmask: false, description, lifecycle: None, entries, origin });
    }
    Ok(Dialect { files: Vec::new(), enums: all, messages })
}

/// All units in a definition.
fn units(dialect: &Dialect) -> HashSet<&str> {
    dialect.messages.iter().flat_map(|message| &message.fields).map(|field| field.units.as_str()).collect()
}

fn enumeration(declared: &source::Enumeration) -> Result<Enum, Error> {
    let name = snake(&declared.name);
    let entry = |(entry, value, description): &(String, String, String)| {
        let problem = "the value of an entry must be written as a number";
        let value = parse::integer(&plain(value))
            .ok_or_else(|| declared.origin.error(format!("entry {}.{entry}", declared.name), problem))?;
        // A name that begins with a digit has a `_` in Rust.
        let entry = format!("{name}_{}", entry.trim_start_matches('_'));
        Ok(entry_of(entry, value, description, &declared.origin))
    };
    let entries = declared.entries.iter().map(entry).collect::<Result<_, _>>()?;
    let (description, origin) = (declared.description.clone(), declared.origin.clone());
    Ok(Enum { name, bitmask: declared.bitmask, description, lifecycle: None, entries, origin })
}

fn entry_of(name: String, value: i128, description: &str, origin: &Origin) -> Entry {
    Entry {
        name,
        value,
        description: description.to_owned(),
        lifecycle: None,
        has_location: None,
        is_destination: None,
        has_altitude_only: false,
        mission_only: false,
        in_mission: true,
        in_fence: false,
        in_rally: false,
        as_command: true,
        params: Vec::new(),
        origin: origin.clone(),
    }
}

/// The types that fields may have besides numbers, and the units.
struct Types<'a> {
    /// Enumerations with their names in Rust and the types of their values; those of the file are last.
    enums: Vec<(String, &'a Enum, Scalar)>,
    units: HashSet<&'a str>,
}

/// A field's type.
struct Type<'a> {
    scalar: Scalar,
    enumeration: Option<&'a Enum>,
    array: Option<u8>,
}

impl<'a> Types<'a> {
    fn message(&self, declared: &source::Message) -> Result<Message, Error> {
        let failed = |problem: &str| declared.origin.error(format!("message {}", declared.name), problem);
        let id = parse::integer(&plain(&declared.id)).and_then(|id| u32::try_from(id).ok());
        let id = id.ok_or_else(|| failed("the id must be written as a number"))?;
        let base = declared.base.iter().map(|field| self.field(declared, field, false));
        let extensions = declared.extensions.iter().map(|field| self.field(declared, field, true));
        let fields = base.chain(extensions).collect::<Result<_, _>>()?;
        let (name, description, origin) =
            (declared.name.clone(), declared.description.clone(), declared.origin.clone());
        Ok(Message { id, name, description, lifecycle: None, fields, origin })
    }

    fn field(&self, message: &source::Message, declared: &source::Field, extension: bool) -> Result<Field, Error> {
        let failed =
            |problem: String| declared.origin.error(format!("field {}.{}", message.name, declared.name), problem);
        let unknown = || {
            failed(format!(
                "`{}` is no type of MAVLink, and no enumeration of this file or of common",
                joined(&declared.ty)
            ))
        };
        let ty = self.type_of(&declared.ty).ok_or_else(unknown)?;
        let invalid = match declared.value.as_slice() {
            [] => String::new(),
            value => self.invalid(value).ok_or_else(|| {
                failed(format!(
                    "`{}` has no XML: write a number, a limit such as `u16::MAX`, or an entry",
                    joined(value)
                ))
            })?,
        };
        let (description, units) = self.described(&declared.description);
        let is_bitmask = ty.enumeration.is_some_and(|enumeration| enumeration.bitmask);
        Ok(Field {
            name: declared.name.clone(),
            scalar: ty.scalar,
            array: ty.array,
            version: None,
            extension,
            units,
            enumeration: ty.enumeration.map(|enumeration| enumeration.name.clone()).unwrap_or_default(),
            invalid,
            multiplier: String::new(),
            minimum: None,
            maximum: None,
            default: None,
            instance: false,
            display: if is_bitmask { "bitmask".into() } else { String::new() },
            print_format: String::new(),
            description,
            origin: declared.origin.clone(),
        })
    }

    /// Returns what a type means; `None` if nothing in MAVLink. The scalar of an enumeration is that of its struct.
    fn type_of(&self, tokens: &[TokenTree]) -> Option<Type<'a>> {
        if let Some(array) = only_group(tokens, Delimiter::Bracket) {
            let parts = split(array, ';');
            let [element, length] = parts.as_slice() else { return None };
            let length = joined(length).parse().ok()?;
            return Some(Type { array: Some(length), ..self.type_of(element)? });
        }
        let (name, arguments) = path(tokens)?;
        match name.as_str() {
            "Text" => {
                let length = joined(&arguments).parse().ok()?;
                Some(Type { scalar: Scalar::Char, enumeration: None, array: Some(length) })
            }
            // The type of a key on the wire is that of its content.
            "Secret" | "Option" => self.type_of(&arguments),
            name => match (scalar(name), self.enumeration(name)) {
                (Some(scalar), _) => Some(Type { scalar, enumeration: None, array: None }),
                (None, Some((enumeration, scalar))) => {
                    Some(Type { scalar, enumeration: Some(enumeration), array: None })
                }
                (None, None) => None,
            },
        }
    }

    /// Returns the enumeration with this name in Rust. Those of the file come before those of common.
    fn enumeration(&self, name: &str) -> Option<(&'a Enum, Scalar)> {
        let (_, enumeration, scalar) = self.enums.iter().rev().find(|(rust, ..)| rust == name)?;
        Some((enumeration, *scalar))
    }

    /// Returns a value in MAVLink's notation of `invalid`; `None` for an expression that has none.
    fn invalid(&self, tokens: &[TokenTree]) -> Option<String> {
        if let Some(array) = only_group(tokens, Delimiter::Bracket) {
            let repeated = split(array.clone(), ';');
            if let [value, _] = repeated.as_slice() {
                return Some(format!("[{}]", self.invalid(value)?));
            }
            let values: Option<Vec<_>> = split(array, ',').iter().map(|value| self.invalid(value)).collect();
            return Some(format!("[{}]", values?.join(",")));
        }
        if let [TokenTree::Ident(_), .., TokenTree::Group(value)] = tokens {
            // `MavResult(255)`, `Secret([0; 32])`
            return self.invalid(&value.stream().into_iter().collect::<Vec<_>>());
        }
        let text = joined(tokens);
        if let Some(integer) = parse::integer(&plain(&text)) {
            return Some(integer.to_string());
        }
        if let Some(number) = number(&text) {
            return Some(number.to_string());
        }
        let mut parts = text.rsplit("::");
        let (last, of) = (parts.next()?, parts.next()?);
        match (scalar(of), last) {
            (Some(_), "NAN") => Some("NaN".into()),
            (Some(scalar), "MAX" | "MIN") if scalar.range().is_some() => {
                let name = scalar.wire_name().trim_end_matches("_t").to_ascii_uppercase();
                Some(format!("{name}_{last}"))
            }
            _ => {
                let (enumeration, _) = self.enumeration(of)?;
                let mut entries = names::constants(enumeration).into_iter().zip(&enumeration.entries);
                entries.find(|(constant, _)| constant == last).map(|(_, entry)| entry.name.clone())
            }
        }
    }

    /// Splits a unit in parentheses from a description.
    fn described(&self, text: &str) -> (String, String) {
        // Names of code are in backticks in Rust only.
        let text = &text.replace('`', "");
        for (open, _) in text.match_indices('(') {
            let Some((unit, after)) = text.get(open + 1..).and_then(|rest| rest.split_once(')')) else { break };
            if !unit.is_empty() && self.units.contains(unit) {
                let before = text.get(..open).unwrap_or_default().trim_end();
                let description = if after.starts_with(|c: char| c.is_ascii_punctuation()) || before.is_empty() {
                    format!("{before}{after}")
                } else {
                    format!("{before} {}", after.trim_start())
                };
                return (description.trim().to_owned(), unit.to_owned());
            }
        }
        (text.to_owned(), String::new())
    }

    fn command(&self, source: &Source, declared: &source::Command) -> Result<Entry, Error> {
        let failed = |problem: String| declared.origin.error(format!("command {}", declared.name), problem);
        let rule = source.rules.iter().find(|rule| rule.name == declared.rule).ok_or_else(|| {
            failed(format!("`{}` is no constant of this file with the type `CommandRule`", declared.rule))
        })?;
        let rules = rule::of(rule)?;
        let name = format!("{COMMANDS}_{}", declared.rule);
        let mut entry = entry_of(name, rules.id, &declared.description, &declared.origin);
        for field in &declared.fields {
            let index = number(&joined(&field.value)).map(|index| index as u8).filter(|index| (1..=7).contains(index));
            let index = index.ok_or_else(|| failed(format!("`{}` has no parameter from 1 to 7", field.name)))?;
            if path(&field.ty).is_some_and(|(name, _)| name == "Location") {
                continue;
            }
            entry.params.push(self.param(&rules, field, index)?);
        }
        if rules.is_located {
            entry.has_location = Some(true);
            let place = |index, label: &str| Param { index, label: label.into(), ..Param::default() };
            entry.params.extend([place(5, "Latitude"), place(6, "Longitude")]);
            entry.params.extend(rules.has_altitude.then(|| Param { units: "m".into(), ..place(7, "Altitude") }));
        }
        entry.params.sort_by_key(|param| param.index);
        Ok(entry)
    }

    fn param(&self, rules: &rule::CommandRule, field: &source::Field, index: u8) -> Result<Param, Error> {
        let failed = |problem: &str| field.origin.error(format!("parameter {}", field.name), problem);
        let rule = rules.params.iter().find(|rule| rule.index == index);
        let (description, units) = self.described(&field.description);
        let mut param = Param { index, label: field.name.clone(), units, description, ..Param::default() };
        let (mut name, arguments) = path(&field.ty).unwrap_or_default();
        if name == "Option" {
            name = path(&arguments).unwrap_or_default().0;
        }
        param.enumeration = match self.enumeration(&name) {
            _ if name == "bool" => BOOL.to_owned(),
            Some((enumeration, _)) => enumeration.name.clone(),
            None => String::new(),
        };
        let Some(rule) = rule.filter(|rule| rule.kind != Kind::Any) else { return Ok(param) };
        param.default = rule.may_be_nan.then_some(f64::NAN);
        if !param.enumeration.is_empty() {
            return Ok(param);
        }
        if rule.kind == Kind::Listed {
            return Err(failed("its values have no names: declare them by `wire_enum!` or `wire_bitmask!`"));
        }
        (param.minimum, param.maximum) = (rule.minimum, rule.maximum);
        // The generator takes the step of a quantity for that of an input field.
        param.increment = (rule.kind == Kind::Integers).then_some(1.0);
        if rule.kind == Kind::Integers {
            param.units.clear();
        }
        Ok(param)
    }
}

/// Returns the last part of a path, and its arguments: `mavstack::Text<16>`.
fn path(tokens: &[TokenTree]) -> Option<(String, Vec<TokenTree>)> {
    let is = |token: &TokenTree, char| matches!(token, TokenTree::Punct(punct) if punct.as_char() == char);
    let end = tokens.iter().position(|token| is(token, '<')).unwrap_or(tokens.len());
    let (path, rest) = tokens.split_at_checked(end)?;
    let arguments = match rest {
        [] => Vec::new(),
        [_, arguments @ .., _] => arguments.to_vec(),
        _ => return None,
    };
    match path {
        [.., TokenTree::Ident(name)] => Some((name.to_string(), arguments)),
        _ => None,
    }
}

fn scalar(rust: &str) -> Option<Scalar> {
    Scalar::ALL.into_iter().find(|scalar| scalar.rust_name() == rust)
}

/// Returns tokens without spaces.
fn joined(tokens: &[TokenTree]) -> String {
    tokens.iter().map(TokenTree::to_string).collect::<String>().replace(' ', "")
}

/// Returns a literal without `_` and without its type: `31_010u32` → `31010`.
fn plain(literal: &str) -> String {
    let plain = literal.replace('_', "");
    // In a hexadecimal number, `f32` is digits.
    let types = Scalar::ALL.into_iter().filter(|scalar| !plain.starts_with("0x") || scalar.range().is_some());
    let ty = types.map(Scalar::rust_name).find(|name| plain.ends_with(name)).unwrap_or_default();
    plain.strip_suffix(ty).unwrap_or(&plain).to_owned()
}

/// Returns a literal number; `None` if it is another expression.
pub(super) fn number(text: &str) -> Option<f64> {
    let plain = plain(text);
    match parse::integer(&plain) {
        Some(integer) => Some(integer as f64),
        None if plain.starts_with(|c: char| c.is_ascii_digit() || c == '-') => plain.parse().ok(),
        None => None,
    }
}

/// Returns a name in capital letters, with `_` between its words: `CraneHook` → `CRANE_HOOK`.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for c in name.chars() {
        if c.is_ascii_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.push(c.to_ascii_uppercase());
    }
    snake
}
