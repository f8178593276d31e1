//! Generates Rust declarations of a dialect, or of a selection from it: enumerations, rules and types of commands,
//! messages. The macros of `mavstack` expand them. The text is formatted as by rustfmt.

use crate::{
    Dialect, Error,
    beside::Beside,
    commands,
    doc::Doc,
    model::{Entry, Enum, Field, Message, Scalar},
    names, rules, unknown,
};
use std::{
    collections::{BTreeSet, HashMap, HashSet},
    fmt::Write as _,
    path::Path,
};

/// The options of [`generate`].
#[derive(Clone, Debug)]
pub struct Options {
    /// Name of the struct that lists the messages.
    pub name: String,
    /// Path of the crate with the macros.
    pub crate_path: String,
    /// Messages, enumerations and typed commands to generate; all if `None`. The enumerations in their fields are
    /// included.
    pub only: Option<Vec<String>>,
    /// Leaves out what `mavstack::dialect` has already.
    ///
    /// - Fields use the enumerations of `mavstack::dialect`.
    /// - Entries that the definition adds to one of these enumerations, most often to MAV_CMD, become constants in a
    ///   module with its name.
    /// - The dialect has all messages of common and its own.
    ///
    /// So the firmware has a single type for each message of common, and compiles in a fraction of the time.
    pub beside_common: bool,
}

impl Options {
    /// Returns options for all of `input`. The struct has the name of the file.
    pub fn for_file(input: &Path) -> Self {
        let stem = input.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let name = names::camel(&stem);
        let name = if name.starts_with(|c: char| c.is_ascii_alphabetic()) { name } else { format!("Dialect{name}") };
        Self { name, crate_path: "mavstack".into(), only: None, beside_common: false }
    }
}

/// Generates the declarations.
///
/// # Errors
///
/// - The selection has a name that does not exist.
/// - [`Options::name`] is not the name of a Rust type.
/// - With [`Options::beside_common`], a message or entry contradicts the one in common.
pub fn generate(dialect: &Dialect, options: &Options) -> Result<String, Error> {
    let identifier = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if !options.name.starts_with(|c: char| c.is_ascii_uppercase()) || !options.name.chars().all(identifier) {
        let problem = "not a name for a Rust type; use a capital letter, followed by letters and digits";
        return Err(Error::whole(input(dialect), &format!("--name {}", options.name), problem));
    }
    let beside = options.beside_common.then(Beside::new).transpose()?;
    let mut selection = Selection::new(dialect, options)?;
    let mut types = Types::new(dialect, options);
    let mut added = Vec::new();
    if let Some(beside) = &beside {
        added = beside.remove(&mut selection.enums, &mut selection.messages)?;
        let theirs = Options { name: "Common".into(), ..options.clone() };
        let path = |name: String| format!("{}::dialect::{name}", options.crate_path);
        let enums = Types::new(&beside.common, &theirs).enums;
        types.theirs = enums.into_iter().map(|(name, (ty, repr))| (name.to_owned(), (path(ty), repr))).collect();
    }
    let mut out = header(dialect, options, &selection);
    for enumeration in &selection.enums {
        out.push('\n');
        types.enumeration(&mut out, enumeration);
    }
    for enumeration in &added {
        out.push('\n');
        types.added(&mut out, enumeration);
    }
    let mut all = selection.enums.iter().copied().chain(&added);
    if let Some(commands) = all.find(|enumeration| enumeration.name == names::COMMANDS) {
        out.push('\n');
        rules::write(&mut out, dialect, commands, &options.crate_path);
        let type_of = |name: &str| types.path_from_inside(name);
        let is_selected = |entry: &Entry| selection.commands.as_ref().is_none_or(|only| only.contains(&entry.value));
        commands::write(&mut out, dialect, commands, &options.crate_path, &type_of, is_selected);
    }
    for message in &selection.messages {
        out.push('\n');
        types.message(&mut out, dialect, message);
    }
    out.push('\n');
    types.dialect(&mut out, dialect, options, &selection);
    Ok(out)
}

fn input(dialect: &Dialect) -> &Path {
    dialect.files.last().map_or(Path::new(""), |file| file)
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The items that are generated.
struct Selection<'a> {
    enums: Vec<&'a Enum>,
    messages: Vec<&'a Message>,
    /// The ids of the commands that get a type; all if `None`.
    commands: Option<BTreeSet<i128>>,
}

impl<'a> Selection<'a> {
    fn new(dialect: &'a Dialect, options: &Options) -> Result<Self, Error> {
        let Some(only) = &options.only else {
            let (enums, messages) = (dialect.enums.iter().collect(), dialect.messages.iter().collect());
            return Ok(Self { enums, messages, commands: None });
        };
        let all_commands = dialect.enumeration(names::COMMANDS).map_or(&[][..], |commands| &commands.entries);
        let mut commands = BTreeSet::new();
        let mut enums: BTreeSet<&str> = BTreeSet::new();
        let mut ids = BTreeSet::new();
        for name in only {
            if let Some(message) = dialect.message(name) {
                ids.insert(message.id);
                enums.extend(message.fields.iter().map(|field| field.enumeration.as_str()));
            } else if dialect.enumeration(name).is_some() {
                enums.insert(name);
            } else if let Some(entry) = all_commands.iter().find(|entry| entry.name == *name) {
                commands.insert(entry.value);
                enums.insert(names::COMMANDS);
                enums.extend(commands::enumerations(dialect, entry).map(|enumeration| enumeration.name.as_str()));
            } else {
                let problem =
                    "there is no message, enum or command with this name; use MAVLink's names, such as COMMAND_LONG";
                return Err(Error::whole(input(dialect), &format!("--only {name}"), problem));
            }
        }
        Ok(Self {
            enums: dialect.enums.iter().filter(|e| enums.contains(e.name.as_str())).collect(),
            messages: dialect.messages.iter().filter(|message| ids.contains(&message.id)).collect(),
            commands: Some(commands),
        })
    }
}

fn header(dialect: &Dialect, options: &Options, selection: &Selection) -> String {
    let files: Vec<_> = dialect.files.iter().rev().map(|file| file_name(file)).collect();
    let mut out =
        String::from("// @generated by mavstack-dialect. Do not edit: change the definitions and generate again.\n");
    let mut doc = Doc::new();
    doc.text(&format!("Declarations generated from {}.", files.join(", ")));
    doc.write(&mut out, "//! ");
    out.push('\n');
    let fields = || selection.messages.iter().flat_map(|message| &message.fields);
    if fields().any(|field| field.name.contains(|c: char| c.is_ascii_uppercase())) {
        out.push_str("#![allow(non_snake_case, reason = \"fields have MAVLink's names\")]\n\n");
    }
    let has_char = |array| fields().any(|field| field.scalar == Scalar::Char && field.array.is_some() == array);
    let is_secret =
        |message: &&Message| message.fields.iter().any(|field| names::is_secret(&message.name, &field.name));
    let has_secret = selection.messages.iter().any(is_secret);
    for (name, is_used) in [("Char", has_char(false)), ("Secret", has_secret), ("Text", has_char(true))] {
        if is_used {
            let _ = writeln!(out, "use {}::message::{name};", options.crate_path);
        }
    }
    out
}

/// The names of the Rust types of the whole dialect. They do not depend on the selection.
struct Types<'a> {
    /// Path of the crate with the macros.
    path: &'a str,
    messages: HashMap<&'a str, String>,
    /// Name and representation of each enumeration.
    enums: HashMap<&'a str, (String, Scalar)>,
    /// Path and representation of the enumerations of `mavstack::dialect`.
    theirs: HashMap<String, (String, Scalar)>,
}

impl<'a> Types<'a> {
    /// Names messages first, sorted by id, then enumerations, sorted by name. So if two names are equal, the message
    /// keeps it.
    fn new(dialect: &'a Dialect, options: &'a Options) -> Self {
        let mut taken: HashSet<String> = names::RESERVED_TYPES.map(str::to_owned).into();
        taken.insert(options.name.clone());
        let mut named = |name: &str, suffix| names::unique(&mut taken, &names::camel(name), suffix);
        let messages = dialect.messages.iter().map(|m| (m.name.as_str(), named(&m.name, "Message"))).collect();
        let enums = dialect.enums.iter().map(|e| {
            let name = named(&e.name, "Enum");
            (e.name.as_str(), (name, representation(dialect, e)))
        });
        Self { path: &options.crate_path, messages, enums: enums.collect(), theirs: HashMap::new() }
    }

    /// Returns an enumeration's type and representation.
    fn enumerated(&self, name: &str) -> Option<&(String, Scalar)> {
        self.theirs.get(name).or_else(|| self.enums.get(name))
    }

    /// Returns the path of an enumeration's type from inside a submodule.
    fn path_from_inside(&self, name: &str) -> String {
        match self.theirs.get(name) {
            Some((path, _)) => path.clone(),
            None => format!("super::{}", self.enums[name].0),
        }
    }

    /// Writes a module with the entries that are added to an enumeration of `mavstack::dialect`.
    fn added(&self, out: &mut String, added: &Enum) {
        let Some((path, _)) = self.theirs.get(&added.name) else { return };
        let name = path.rsplit(':').next().unwrap_or_default();
        let _ = writeln!(out, "/// The entries that are added to `{}`.", added.name);
        out.push_str("#[allow(missing_docs, reason = \"entries have MAVLink's names\")]\n");
        let _ = writeln!(out, "pub mod {} {{\n    use {path};\n", added.name.to_ascii_lowercase());
        for (entry, constant) in added.entries.iter().zip(names::constants(added)) {
            entry_doc(entry).write(out, "    /// ");
            let _ = writeln!(out, "    pub const {constant}: {name} = {name}({});", entry.value);
        }
        out.push_str("}\n");
    }

    fn enumeration(&self, out: &mut String, enumeration: &Enum) {
        let (name, repr) = &self.enums[enumeration.name.as_str()];
        let kind = if enumeration.bitmask { "wire_bitmask" } else { "wire_enum" };
        let _ = writeln!(out, "{}::{kind}! {{", self.path);
        let mut doc = Doc::new();
        if enumeration.description.is_empty() {
            doc.text(&format!("`{}`.", enumeration.name));
        } else {
            doc.prose(&enumeration.description);
            doc.text(&format!("(`{}`)", enumeration.name));
        }
        doc.lifecycle(enumeration.lifecycle.as_ref());
        doc.write(out, "    /// ");
        let _ = writeln!(out, "    pub struct {name}: {} {{", repr.rust_name());
        for (entry, constant) in enumeration.entries.iter().zip(names::constants(enumeration)) {
            entry_doc(entry).write(out, "        /// ");
            let value = if enumeration.bitmask && entry.value > 9 {
                format!("{:#x}", entry.value)
            } else {
                entry.value.to_string()
            };
            let _ = writeln!(out, "        {constant} = {value},");
        }
        out.push_str("    }\n}\n");
    }

    fn message(&self, out: &mut String, dialect: &Dialect, message: &Message) {
        let _ = writeln!(out, "{}::message! {{", self.path);
        let mut doc = Doc::new();
        if message.description.is_empty() {
            doc.text(&format!("`{}`.", message.name));
        } else {
            doc.prose(&message.description);
        }
        doc.lifecycle(message.lifecycle.as_ref());
        doc.write(out, "    /// ");
        let name = &self.messages[message.name.as_str()];
        let _ = writeln!(
            out,
            "    pub struct {name}: {} = {}, crc_extra = {} {{",
            message.name,
            message.id,
            message.crc_extra()
        );
        message.base().into_iter().for_each(|field| self.field(out, dialect, message, field));
        if message.extensions().next().is_some() {
            out.push_str("    } extensions {\n");
            message.extensions().for_each(|field| self.field(out, dialect, message, field));
        }
        out.push_str("    }\n}\n");
    }

    fn field(&self, out: &mut String, dialect: &Dialect, message: &Message, field: &Field) {
        let mut ty = field.scalar.rust_name();
        let mut see = None;
        if let Some((name, repr)) = self.enumerated(&field.enumeration) {
            if *repr == field.scalar {
                ty = name;
            } else {
                see = Some(name.as_str());
            }
        }
        let is_secret = names::is_secret(&message.name, &field.name);
        let mut unknown = unknown_value(dialect, field, ty);
        if is_secret {
            unknown = unknown.map(|value| format!("Secret({value})"));
        }
        let ty = match field.array {
            None => ty.to_owned(),
            Some(length) if field.scalar == Scalar::Char => format!("Text<{length}>"),
            Some(length) => format!("[{ty}; {length}]"),
        };
        let ty = if is_secret { format!("Secret<{ty}>") } else { ty };
        field_doc(field, see).write(out, "        /// ");
        let unknown = unknown.map_or(String::new(), |value| format!(" = {value}"));
        let _ = writeln!(out, "        {}: {ty}{unknown},", names::field(&field.name));
    }

    fn dialect(&self, out: &mut String, dialect: &Dialect, options: &Options, selection: &Selection) {
        let what = if options.only.is_some() { "A selection of the messages" } else { "All messages" };
        let _ = writeln!(out, "{}::dialect! {{", self.path);
        let mut doc = Doc::new();
        let (beside, base) = match options.beside_common {
            true => (", and all of common", format!(" + {}::dialect::Common", options.crate_path)),
            false => ("", String::new()),
        };
        doc.text(&format!("{what} of {} and its includes{beside}.", file_name(input(dialect))));
        doc.write(out, "    /// ");
        let _ = writeln!(out, "    pub struct {}: [", options.name);
        for message in &selection.messages {
            let _ = writeln!(out, "        {},", self.messages[message.name.as_str()]);
        }
        let _ = writeln!(out, "    ]{base};\n}}");
    }
}

/// Returns the type of an enumeration. Of the integer types that hold all values, it is the one that most of its fields
/// have, and the smaller of two that are equally frequent. Without fields it is the smallest.
pub(crate) fn representation(dialect: &Dialect, enumeration: &Enum) -> Scalar {
    let holds = |scalar: &Scalar| {
        scalar.range().is_some_and(|(min, max)| enumeration.entries.iter().all(|e| (min..=max).contains(&e.value)))
    };
    let fields = dialect.messages.iter().flat_map(|message| &message.fields);
    let mut uses: HashMap<Scalar, usize> = HashMap::new();
    for field in fields.filter(|field| field.enumeration == enumeration.name) {
        *uses.entry(field.scalar).or_default() += 1;
    }
    // `ALL` is sorted by size, unsigned before signed. `max_by_key` returns the last of several maxima, hence `rev`.
    let candidates = Scalar::ALL.into_iter().filter(holds).rev();
    candidates.max_by_key(|scalar| uses.get(scalar).copied().unwrap_or(0)).unwrap_or(Scalar::U64)
}

/// Returns the literal that means "not known" in a field with elements of type `element`; `None` if the value is zero
/// or there is none.
fn unknown_value(dialect: &Dialect, field: &Field, element: &str) -> Option<String> {
    // The attribute was checked when the definition was loaded.
    let values = unknown::values(dialect, field).unwrap_or_default();
    let is_set = |value: &Option<unknown::Value>| value.is_some_and(|value| !value.is_zero());
    if !values.iter().any(is_set) {
        return None;
    }
    let is_number = match field.scalar {
        // A `Text` is built from its bytes.
        Scalar::Char => field.array.is_some(),
        scalar => element == scalar.rust_name(),
    };
    let zero = match field.scalar {
        Scalar::F32 | Scalar::F64 => unknown::Value::Float(0.0),
        _ => unknown::Value::Integer(0),
    };
    let literal = |value: Option<unknown::Value>| {
        let number = value.unwrap_or(zero).literal(field.scalar);
        if is_number { number } else { format!("{element}({number})") }
    };
    let literals: Vec<_> = values.iter().map(|value| literal(*value)).collect();
    let first = literals.first()?;
    let all = match field.array {
        None => return Some(first.clone()),
        Some(length) if literals.iter().all(|literal| literal == first) => format!("[{first}; {length}]"),
        Some(length) => {
            let set = literals.iter().enumerate().filter(|&(at, _)| values.get(at).is_some_and(is_set));
            let set: String = set.map(|(at, literal)| format!("all[{at}] = {literal}; ")).collect();
            format!("{{ let mut all = [{}; {length}]; {set}all }}", literal(None))
        }
    };
    Some(if field.scalar == Scalar::Char { format!("Text::from_wire({all})") } else { all })
}

fn entry_doc(entry: &Entry) -> Doc {
    let mut doc = Doc::new();
    doc.prose(&entry.description);
    doc.lifecycle(entry.lifecycle.as_ref());
    let params: Vec<_> = entry.params.iter().filter(|param| !param.reserved && !param.label.is_empty()).collect();
    for param in &params {
        let mut facts = Vec::new();
        if !param.units.is_empty() {
            facts.push(crate::doc::escape(&param.units));
        }
        facts.extend(crate::doc::range(param.minimum, param.maximum));
        if !param.enumeration.is_empty() {
            facts.push(format!("`{}`", param.enumeration));
        }
        let facts = if facts.is_empty() { String::new() } else { format!(" ({})", facts.join(", ")) };
        let end = if params.last().is_some_and(|last| last.index == param.index) { "." } else { ";" };
        doc.phrase(format!("{}: {}{facts}{end}", param.index, crate::doc::escape(&param.label)));
    }
    doc
}

/// Returns the doc comment of a field: description, unit, range and other attributes.
fn field_doc(field: &Field, see: Option<&str>) -> Doc {
    let mut doc = Doc::new();
    doc.prose(&field.description);
    if !field.units.is_empty() {
        doc.text(&format!("({})", crate::doc::escape(&field.units)));
    }
    let mut facts = Vec::new();
    facts.extend(field.version.map(|version| format!("Version of the definitions: {version}.")));
    facts.extend(crate::doc::range(field.minimum, field.maximum).map(|range| format!("Range: {range}.")));
    if !field.invalid.is_empty() {
        facts.push(format!("Unknown: `{}`.", field.invalid));
    }
    if !field.multiplier.is_empty() {
        facts.push(format!("In units of `{}`.", field.multiplier));
    }
    facts.extend(field.default.map(|default| format!("Default: {default}.")));
    if field.instance {
        facts.push("Identifies the instance.".into());
    }
    facts.extend(see.map(|name| format!("See [`{name}`].")));
    if !facts.is_empty() {
        doc.text(&facts.join(" "));
    }
    doc
}
