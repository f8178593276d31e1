//! Loads a file with its includes, merges and checks them.

use crate::{
    Dialect, Error, builtin,
    model::{Enum, Message},
    parse::{self, Include},
    unknown,
};
use std::{
    collections::{HashMap, hash_map::Entry as Slot},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Reads `input` and all files that it includes.
///
/// An included file is searched in the directory of the file that includes it, then in `include_dirs` in their order,
/// then among the definitions of this crate: `common.xml`, `standard.xml` and `minimal.xml`. A file that is included
/// several times is read once.
///
/// # Errors
///
/// The first error: a file that cannot be read, malformed XML, or a definition that MAVLink does not allow.
pub fn load(input: &Path, include_dirs: &[PathBuf]) -> Result<Dialect, Error> {
    let mut loader = Loader::new(include_dirs);
    loader.file(input)?;
    loader.finish()
}

/// As [`load`], for a definition that is not in a file yet: `file` is its name.
#[cfg(feature = "cli")]
pub(crate) fn text(file: &Path, xml: &str) -> Result<Dialect, Error> {
    let mut loader = Loader::new(&[]);
    loader.text(&file.into(), file.into(), xml)?;
    loader.finish()
}

/// Loads the definitions from which `mavstack::dialect` is generated.
pub(crate) fn common() -> Result<Dialect, Error> {
    let mut loader = Loader::new(&[]);
    loader.builtin(builtin::path("common.xml").unwrap_or_default())?;
    loader.finish()
}

struct Loader<'a> {
    include_dirs: &'a [PathBuf],
    /// Canonical paths of the chain of includes that leads to the current file.
    path: Vec<PathBuf>,
    /// Canonical paths of the files that were read.
    done: Vec<PathBuf>,
    dialect: Dialect,
    /// Indices of the messages by id, and by name.
    ids: HashMap<u32, usize>,
    names: HashMap<String, usize>,
    enums: HashMap<String, usize>,
}

impl<'a> Loader<'a> {
    fn new(include_dirs: &'a [PathBuf]) -> Self {
        Self {
            include_dirs,
            path: Vec::new(),
            done: Vec::new(),
            dialect: Dialect { files: Vec::new(), enums: Vec::new(), messages: Vec::new() },
            ids: HashMap::new(),
            names: HashMap::new(),
            enums: HashMap::new(),
        }
    }

    /// Sorts and checks what was read.
    fn finish(self) -> Result<Dialect, Error> {
        let mut dialect = self.dialect;
        dialect.messages.sort_by_key(|message| message.id);
        dialect.enums.sort_by(|a, b| a.name.cmp(&b.name));
        for enumeration in &mut dialect.enums {
            enumeration.entries.sort_by_key(|entry| entry.value);
        }
        check_references(&dialect)?;
        Ok(dialect)
    }

    /// Reads a file and, recursively, its includes. The depth is bounded, because no file is twice in a chain.
    fn file(&mut self, file: &Path) -> Result<(), Error> {
        let unreadable = |error: std::io::Error| Error::whole(file, "the file", format!("cannot be read: {error}"));
        let canonical = fs::canonicalize(file).map_err(unreadable)?;
        let text = String::from_utf8(fs::read(&canonical).map_err(unreadable)?)
            .map_err(|error| Error::whole(file, "the file", format!("{error}; save it as UTF-8")))?;
        let shared: Arc<Path> = file.into();
        self.text(&shared, canonical, &text)
    }

    /// Reads a definition of this crate.
    fn builtin(&mut self, path: PathBuf) -> Result<(), Error> {
        let text = builtin::text(&path).unwrap_or_default();
        self.text(&path.as_path().into(), path, text)
    }

    fn text(&mut self, shared: &Arc<Path>, canonical: PathBuf, text: &str) -> Result<(), Error> {
        let parsed = parse::parse(shared, text)?;
        self.path.push(canonical);
        for include in &parsed.includes {
            self.include(shared, include)?;
        }
        if let Some(canonical) = self.path.pop() {
            self.done.push(canonical);
        }
        self.dialect.files.push(shared.clone());
        parsed.enums.into_iter().try_for_each(|enumeration| self.enumeration(enumeration))?;
        parsed.messages.into_iter().try_for_each(|message| self.message(message))
    }

    fn include(&mut self, from: &Path, include: &Include) -> Result<(), Error> {
        let element = format!("include {}", include.name);
        let beside = from.parent().unwrap_or(Path::new(""));
        let found = std::iter::once(beside)
            .chain(self.include_dirs.iter().map(PathBuf::as_path))
            .map(|dir| dir.join(&include.name))
            .find_map(|file| fs::canonicalize(&file).ok().filter(|file| file.is_file()).map(|real| (file, real)));
        let builtin = || builtin::path(&include.name);
        // Definitions of this crate include only each other.
        let found = if builtin::text(from).is_some() { None } else { found };
        let Some((file, canonical)) = found.or_else(|| builtin().map(|path| (path.clone(), path))) else {
            let problem = "there is no such file in this file's directory or in those given with --include-dir; add it, or \
                           add its directory (minimal.xml, standard.xml and common.xml are built in)";
            return Err(include.origin.error(element, problem));
        };
        if let Some(first) = self.path.iter().position(|open| *open == canonical) {
            let names = self.path.iter().skip(first).chain([&canonical]);
            let names: Vec<_> = names.filter_map(|path| path.file_name()).map(|name| name.to_string_lossy()).collect();
            let problem = format!("the includes are circular: {}; remove one", names.join(" → "));
            return Err(include.origin.error(element, problem));
        }
        if self.done.contains(&canonical) {
            return Ok(());
        }
        if builtin::text(&file).is_some() { self.builtin(file) } else { self.file(&file) }
    }

    /// Adds an enumeration, or its entries to the one of the same name.
    fn enumeration(&mut self, new: Enum) -> Result<(), Error> {
        let index = match self.enums.entry(new.name.clone()) {
            Slot::Occupied(slot) => *slot.get(),
            Slot::Vacant(slot) => {
                slot.insert(self.dialect.enums.len());
                self.dialect.enums.push(Enum { entries: Vec::new(), ..new.clone() });
                self.dialect.enums.len() - 1
            }
        };
        let merged = &mut self.dialect.enums[index];
        merged.bitmask |= new.bitmask;
        if merged.description.is_empty() {
            merged.description = new.description;
        }
        merged.lifecycle = merged.lifecycle.take().or(new.lifecycle);
        for entry in new.entries {
            let clash = merged.entries.iter().find(|other| other.name == entry.name || other.value == entry.value);
            if let Some(other) = clash {
                let what = if other.name == entry.name { "name".into() } else { format!("value {}", entry.value) };
                let problem =
                    format!("this {what} is taken by {} at {}; use another", other.name, place(&other.origin));
                return Err(entry.origin.error(format!("entry {}.{}", merged.name, entry.name), problem));
            }
            merged.entries.push(entry);
        }
        Ok(())
    }

    fn message(&mut self, message: Message) -> Result<(), Error> {
        let index = self.dialect.messages.len();
        let taken = |what: String, other: usize| {
            let other = &self.dialect.messages[other];
            let problem = format!("this {what} is taken by {} at {}; use another", other.name, place(&other.origin));
            Err(message.origin.error(format!("message {}", message.name), problem))
        };
        if let Some(other) = self.ids.insert(message.id, index) {
            return taken(format!("id {}", message.id), other);
        }
        if let Some(other) = self.names.insert(message.name.clone(), index) {
            return taken("name".into(), other);
        }
        self.dialect.messages.push(message);
        Ok(())
    }
}

fn place(origin: &crate::Origin) -> String {
    format!("{}:{}", origin.file.display(), origin.line)
}

/// Checks that every enumeration named by a field exists, and that each field's `invalid` attribute is valid. (A
/// command's parameter may name a missing enumeration, because tools only display it.)
fn check_references(dialect: &Dialect) -> Result<(), Error> {
    for message in &dialect.messages {
        for field in &message.fields {
            let error = |problem| field.origin.error(format!("field {}.{}", message.name, field.name), problem);
            if !field.enumeration.is_empty() && dialect.enumeration(&field.enumeration).is_none() {
                return Err(error(format!(
                    "there is no enum {}; define it, or include the file that does",
                    field.enumeration
                )));
            }
            unknown::values(dialect, field).map_err(error)?;
        }
    }
    Ok(())
}
