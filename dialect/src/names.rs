//! The names of Rust items, from MAVLink's names.

use crate::model::Enum;
use std::{collections::HashSet, path::Path};

/// The enumeration whose entries are commands.
pub(crate) const COMMANDS: &str = "MAV_CMD";

/// Rust's keywords that cannot be written raw, and so cannot be names of fields.
pub(crate) const REFUSED_FIELDS: [&str; 4] = ["Self", "crate", "self", "super"];

/// Rust's keywords that can be written raw.
const KEYWORDS: [&str; 48] = [
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "do", "dyn", "else", "enum",
    "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop", "macro", "match", "mod", "move",
    "mut", "override", "priv", "pub", "ref", "return", "static", "struct", "trait", "true", "try", "type", "typeof",
    "unsafe", "unsized", "use", "virtual", "where", "while", "yield",
];

/// Fields with keys and passwords, by message. Their type is not shown in logs.
const SECRETS: [(&str, &[&str]); 5] = [
    ("AUTH_KEY", &["key"]),
    ("CELLULAR_CONFIG", &["pin", "new_pin", "puk"]),
    ("CHANGE_OPERATOR_CONTROL", &["passkey"]),
    ("SETUP_SIGNING", &["secret_key"]),
    ("WIFI_CONFIG_AP", &["password"]),
];

/// Names that are in scope where the declarations are expanded.
pub(crate) const RESERVED_TYPES: [&str; 15] = [
    "Char",
    "Clone",
    "Copy",
    "Debug",
    "Default",
    "Eq",
    "None",
    "Option",
    "Ord",
    "PartialEq",
    "PartialOrd",
    "Secret",
    "Self",
    "Some",
    "Text",
];

/// Converts a name to camel case: `HIGH_LATENCY2` → `HighLatency2`. An underscore between two digits is kept.
pub(crate) fn camel(name: &str) -> String {
    let mut camel = String::new();
    for word in name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty()) {
        if camel.ends_with(|c: char| c.is_ascii_digit()) && word.starts_with(|c: char| c.is_ascii_digit()) {
            camel.push('_');
        }
        let (first, rest) = word.split_at(1);
        camel.push_str(&first.to_ascii_uppercase());
        camel.push_str(&rest.to_ascii_lowercase());
    }
    camel
}

/// Returns a field's name: MAVLink's, written raw if it is a keyword.
pub(crate) fn field(name: &str) -> String {
    if KEYWORDS.contains(&name) { format!("r#{name}") } else { name.to_owned() }
}

/// Returns the name of the module for a file: `My-Vehicle.xml` → `my_vehicle`.
pub(crate) fn module(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let name: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let is_taken = KEYWORDS.contains(&name.as_str()) || REFUSED_FIELDS.contains(&name.as_str());
    if is_taken || !name.starts_with(|c: char| c.is_ascii_alphabetic()) { format!("dialect_{name}") } else { name }
}

/// Returns whether a field is a key or a password.
pub(crate) fn is_secret(message: &str, field: &str) -> bool {
    SECRETS.iter().any(|(name, fields)| *name == message && fields.contains(&field))
}

/// Reserves and returns a free name: `name`, or else `name` with `suffix`, or else with a number after it.
pub(crate) fn unique(taken: &mut HashSet<String>, name: &str, suffix: &str) -> String {
    let mut free = name.to_owned();
    let mut number = 1;
    while !taken.insert(free.clone()) {
        free = if number == 1 { format!("{name}{suffix}") } else { format!("{name}{suffix}{number}") };
        number += 1;
    }
    free
}

/// Returns the names of an enumeration's constants, in the order of its entries, without their common prefix.
pub(crate) fn constants(enumeration: &Enum) -> Vec<String> {
    let prefix = prefix(enumeration);
    let mut taken = HashSet::new();
    if enumeration.bitmask {
        // `wire_bitmask!` declares `EMPTY`.
        taken.insert("EMPTY".to_owned());
    }
    if enumeration.name == COMMANDS {
        // `ALL` is the list of rules.
        taken.insert("ALL".to_owned());
    }
    let constant = |name: &str| {
        let name = name[prefix..].to_ascii_uppercase();
        if name.starts_with(|c: char| c.is_ascii_digit()) { format!("_{name}") } else { name }
    };
    enumeration.entries.iter().map(|entry| unique(&mut taken, &constant(&entry.name), "_")).collect()
}

/// Returns the length of the prefix: `ENUM_NAME_` if all names begin with it, or else the longest common prefix that
/// ends in `_`.
fn prefix(enumeration: &Enum) -> usize {
    let own = format!("{}_", enumeration.name);
    let names = || enumeration.entries.iter().map(|entry| entry.name.as_str());
    // The rest must be a name, not only underscores.
    let fits = |prefix: &str| {
        names().all(|name| name.strip_prefix(prefix).is_some_and(|rest| rest.contains(|c: char| c != '_')))
    };
    if fits(&own) {
        return own.len();
    }
    match enumeration.entries.as_slice() {
        [first, _, ..] => {
            let ends = first.name.char_indices().filter(|&(_, c)| c == '_').map(|(at, _)| at + 1);
            ends.filter(|&end| fits(&first.name[..end])).max().unwrap_or(0)
        }
        _ => 0,
    }
}
