//! Reads the declarations in a Rust file: `message!`, `command!`, `wire_enum!`, `wire_bitmask!`, and the constants that are rules of
//! commands.

use std::path::Path;
use std::sync::Arc;

use proc_macro2::{Delimiter, Group, Ident, TokenStream, TokenTree};

use super::tokens::{Cursor, split, text};
use crate::{Error, Origin};

/// The declarations of a file, in its order.
#[derive(Default)]
pub(super) struct Source {
    pub enums: Vec<Enumeration>,
    pub messages: Vec<Message>,
    pub commands: Vec<Command>,
    pub rules: Vec<Rule>,
}

pub(super) struct Enumeration {
    pub name: String,
    /// Its type in Rust.
    pub repr: String,
    pub bitmask: bool,
    pub description: String,
    /// Name, value as written, and description.
    pub entries: Vec<(String, String, String)>,
    pub origin: Origin,
}

pub(super) struct Message {
    /// MAVLink's name.
    pub name: String,
    pub id: String,
    pub description: String,
    pub base: Vec<Field>,
    pub extensions: Vec<Field>,
    pub origin: Origin,
}

pub(super) struct Command {
    pub name: String,
    /// The last part of the rule's path.
    pub rule: String,
    pub description: String,
    pub fields: Vec<Field>,
    pub origin: Origin,
}

/// A field of a message or of a command.
pub(super) struct Field {
    pub name: String,
    pub ty: Vec<TokenTree>,
    /// What is behind `=`: the value for "not known", or the number of the parameter.
    pub value: Vec<TokenTree>,
    pub description: String,
    pub origin: Origin,
}

/// A constant of type `CommandRule`.
pub(super) struct Rule {
    pub name: String,
    pub value: Vec<TokenTree>,
    pub origin: Origin,
}

/// Reads the declarations of a file.
pub(super) fn read(file: &Arc<Path>, rust: &str) -> Result<Source, Error> {
    let tokens: TokenStream = rust.parse().map_err(|error| {
        let problem = format!("is not Rust: {error}");
        Error::whole(file, "the file", problem)
    })?;
    let mut source = Source::default();
    source.visit(file, tokens)?;
    Ok(source)
}

impl Source {
    /// Finds the declarations among these tokens, also inside modules. Leaves out tests and definitions of macros.
    fn visit(&mut self, file: &Arc<Path>, tokens: TokenStream) -> Result<(), Error> {
        let mut cursor = Cursor::new(file, tokens);
        while let Some(token) = cursor.next() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' => {
                    if let Some(TokenTree::Group(attribute)) = cursor.peek()
                        && text(attribute.stream()).replace(' ', "").starts_with("cfg(test)")
                    {
                        cursor.skip_item();
                    }
                }
                TokenTree::Group(group) => self.visit(file, group.stream())?,
                TokenTree::Ident(ident) if ident == "macro_rules" => cursor.skip_item(),
                TokenTree::Ident(ident) if ident == "const" => self.constant(&mut cursor),
                TokenTree::Ident(ident) if cursor.takes('!') => {
                    if let Some(TokenTree::Group(body)) = cursor.next() {
                        self.invocation(file, &ident, &body)?;
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Reads a constant if it is a rule: `NAME: CommandRule = …;`.
    fn constant(&mut self, cursor: &mut Cursor<'_>) {
        // Constant functions and generics are no constants.
        let Some((name, ty)) = cursor.declared() else { return };
        if ty == "CommandRule" {
            let origin = cursor.origin();
            cursor.until(&['=']);
            cursor.takes('=');
            self.rules.push(Rule { name, value: cursor.until(&[';']), origin });
        }
    }

    fn invocation(&mut self, file: &Arc<Path>, name: &Ident, body: &Group) -> Result<(), Error> {
        let mut cursor = Cursor::new(file, body.stream());
        match name.to_string().as_str() {
            "message" => self.messages.push(message(&mut cursor)?),
            "command" => self.commands.push(command(&mut cursor)?),
            "wire_enum" => self.enums.push(enumeration(&mut cursor, false)?),
            "wire_bitmask" => self.enums.push(enumeration(&mut cursor, true)?),
            // Another macro may contain some.
            _ => self.visit(file, body.stream())?,
        }
        Ok(())
    }
}

/// `pub struct CraneReport: CRANE_REPORT = 53_000 { … } extensions { … }`
fn message(cursor: &mut Cursor<'_>) -> Result<Message, Error> {
    let (description, origin) = cursor.head()?;
    cursor.ident("the name of the struct")?;
    cursor.punct(':')?;
    let name = cursor.ident("MAVLink's name of the message")?;
    cursor.punct('=')?;
    let id = cursor.literal()?;
    if cursor.takes(',') {
        // The digest, which the generator computes again.
        cursor.skip_to_group();
    }
    let base = fields(cursor)?;
    let extensions = if cursor.takes_ident("extensions") { fields(cursor)? } else { Vec::new() };
    Ok(Message { name, id, description, base, extensions, origin })
}

/// `pub struct Winch = WINCH { … }`
fn command(cursor: &mut Cursor<'_>) -> Result<Command, Error> {
    let (description, origin) = cursor.head()?;
    let name = cursor.ident("the name of the struct")?;
    cursor.punct('=')?;
    let mut rule = String::new();
    while let Some(TokenTree::Ident(_) | TokenTree::Punct(_)) = cursor.peek() {
        if let Some(TokenTree::Ident(part)) = cursor.next() {
            rule = part.to_string();
        }
    }
    Ok(Command { name, rule, description, fields: fields(cursor)?, origin })
}

/// `pub struct CraneHook: u8 { CLOSED = 0, … }`
fn enumeration(cursor: &mut Cursor<'_>, bitmask: bool) -> Result<Enumeration, Error> {
    let (description, origin) = cursor.head()?;
    let name = cursor.ident("the name of the struct")?;
    cursor.punct(':')?;
    let repr = cursor.ident("an integer type")?;
    let mut body = cursor.body()?;
    let mut entries = Vec::new();
    while body.peek().is_some() {
        let description = body.docs();
        let entry = body.ident("the name of an entry")?;
        body.punct('=')?;
        let value = text(body.until(&[',']).into_iter().collect()).replace(' ', "");
        body.takes(',');
        entries.push((entry, value, description));
    }
    Ok(Enumeration { name, repr, bitmask, description, entries, origin })
}

/// `{ /// Time since boot (ms). time_boot_ms: u32, tension: i16 = i16::MAX, … }`
fn fields(cursor: &mut Cursor<'_>) -> Result<Vec<Field>, Error> {
    let body = cursor.body()?;
    let mut fields = Vec::new();
    for tokens in split(body, ',') {
        let mut field = cursor.of(tokens);
        let (description, origin) = (field.docs(), field.origin());
        let name = field.ident("the name of a field")?;
        field.punct(':')?;
        let ty = field.until(&['=']);
        let value = if field.takes('=') { field.until(&[]) } else { Vec::new() };
        let name = name.trim_start_matches("r#").to_owned();
        fields.push(Field { name, ty, value, description, origin });
    }
    Ok(fields)
}

/// Returns the content of a group with this delimiter, if that is all that there is.
pub(super) fn only_group(tokens: &[TokenTree], delimiter: Delimiter) -> Option<TokenStream> {
    match tokens {
        [TokenTree::Group(group)] if group.delimiter() == delimiter => Some(group.stream()),
        _ => None,
    }
}
