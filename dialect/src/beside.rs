//! What of a dialect `mavstack::dialect` has already, and what the dialect adds to it.

use crate::{
    Dialect, Error, builtin, load,
    model::{Entry, Enum, Message, Origin},
};

/// The dialect that is there already.
pub(crate) struct Beside {
    pub(crate) common: Dialect,
}

impl Beside {
    pub(crate) fn new() -> Result<Self, Error> {
        Ok(Self { common: load::common()? })
    }

    /// Takes out what is there already; returns enumerations that have only what is added to one of the same name.
    ///
    /// Another state of common than ours is no fault as long as the two mean the same: the same id, digest and name, and no
    /// field that we do not have.
    pub(crate) fn take_out(&self, enums: &mut Vec<&Enum>, messages: &mut Vec<&Message>) -> Result<Vec<Enum>, Error> {
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
                    // Renamed since, or before.
                    Some(other) if other.value == entry.value && is_of_common(&entry.origin) => {}
                    Some(other) => {
                        let problem = format!(
                            "mavstack has {} = {}; take another name and value, or leave --beside-common out",
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
            "mavstack has another {} with id {}; take another name and id, or leave --beside-common out",
            theirs.name, theirs.id
        );
        Err(message.origin.error(format!("message {}", message.name), problem))
    }
}

/// Whether an element stands in a file of common, in whatever state of it.
fn is_of_common(origin: &Origin) -> bool {
    origin.file.file_name().is_some_and(|name| builtin::path(&name.to_string_lossy()).is_some())
}
