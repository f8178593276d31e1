//! Generation beside `mavstack::dialect`: leaves out what that has already, and finds what a dialect adds to it.

use crate::{
    Dialect, Error, builtin, load,
    model::{Entry, Enum, Message, Origin},
};

/// The dialect of `mavstack::dialect`.
pub(crate) struct Beside {
    pub(crate) common: Dialect,
}

impl Beside {
    pub(crate) fn new() -> Result<Self, Error> {
        Ok(Self { common: load::common()? })
    }

    /// Removes the enumerations and messages of common. Returns enumerations with the entries that the dialect adds to
    /// those of common.
    ///
    /// The dialect may include another version of common than ours, if both mean the same on the wire: same id, name
    /// and digest, and no field that ours does not have.
    pub(crate) fn remove(&self, enums: &mut Vec<&Enum>, messages: &mut Vec<&Message>) -> Result<Vec<Enum>, Error> {
        for message in messages.iter() {
            self.check(message)?;
        }
        messages.retain(|message| self.common.message(&message.name).is_none());
        let mut added = Vec::new();
        for enumeration in enums.iter() {
            let Some(theirs) = self.common.enumeration(&enumeration.name) else { continue };
            let mut entries = Vec::new();
            for entry in &enumeration.entries {
                let same = |other: &&Entry| other.name == entry.name || other.value == entry.value;
                match theirs.entries.iter().find(same) {
                    None => entries.push(entry.clone()),
                    Some(other) if other.name == entry.name && other.value == entry.value => {}
                    // Renamed in a later or earlier version of common.
                    Some(other) if other.value == entry.value && is_of_common(&entry.origin) => {}
                    Some(other) => {
                        let problem = format!(
                            "mavstack has {} = {}; use another name and value, or do not use --beside-common",
                            other.name, other.value
                        );
                        return Err(entry.origin.error(format!("entry {}.{}", enumeration.name, entry.name), problem));
                    }
                }
            }
            if !entries.is_empty() {
                added.push(Enum { entries, ..(*enumeration).clone() });
            }
        }
        enums.retain(|enumeration| self.common.enumeration(&enumeration.name).is_none());
        Ok(added)
    }

    fn check(&self, message: &Message) -> Result<(), Error> {
        let same = |other: &&Message| other.id == message.id || other.name == message.name;
        let Some(theirs) = self.common.messages.iter().find(same) else { return Ok(()) };
        let is_same = theirs.id == message.id && theirs.name == message.name;
        if is_same && theirs.crc_extra() == message.crc_extra() && theirs.max_len() >= message.max_len() {
            return Ok(());
        }
        let problem = format!(
            "mavstack has another {} with id {}; use another name and id, or do not use --beside-common",
            theirs.name, theirs.id
        );
        Err(message.origin.error(format!("message {}", message.name), problem))
    }
}

/// Returns whether an element is defined in a file of common, in any version.
fn is_of_common(origin: &Origin) -> bool {
    origin.file.file_name().is_some_and(|name| builtin::path(&name.to_string_lossy()).is_some())
}
