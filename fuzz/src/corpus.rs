//! The checked-in corpora: a tar archive per target. `tar -tf fuzz/corpus/decode.tar` lists one.
//!
//! Equal inputs give identical archives: names are sorted, and no times or owners are stored. The archives are not compressed,
//! because git compresses its objects and can store a new version as a delta.
//!
//! `xtask` includes this file.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::{Component, Path};

/// Inputs by name.
pub type Corpus = BTreeMap<String, Vec<u8>>;

/// Prefix of the names of inputs from `seeds.rs`. All other inputs were found by fuzzing.
pub const SEED: &str = "seed-";

/// Reads the inputs of an archive.
pub fn read(archive: &Path) -> Result<Corpus> {
    fs::read(archive).and_then(|bytes| unpack(&bytes)).map_err(|error| named(archive, &error))
}

/// Replaces an archive atomically.
pub fn write(archive: &Path, corpus: &Corpus) -> Result<()> {
    let part = archive.with_extension("part");
    let replace = |bytes| fs::write(&part, bytes).and_then(|()| fs::rename(&part, archive));
    pack(corpus).and_then(replace).map_err(|error| named(archive, &error))
}

fn named(archive: &Path, error: &Error) -> Error {
    Error::new(error.kind(), format!("{}: {error}", archive.display()))
}

fn unpack(bytes: &[u8]) -> Result<Corpus> {
    let mut corpus = Corpus::new();
    for entry in tar::Archive::new(bytes).entries()? {
        let mut entry = entry?;
        let path = entry.path()?.into_owned();
        // Only plain names are allowed, so that unpacking writes nothing outside its folder.
        let mut parts = path.components();
        let (Some(Component::Normal(name)), None) = (parts.next(), parts.next()) else {
            return Err(Error::new(ErrorKind::InvalidData, format!("{} is not a plain file name", path.display())));
        };
        let mut input = Vec::new();
        entry.read_to_end(&mut input)?;
        if corpus.insert(name.to_string_lossy().into_owned(), input).is_some() {
            return Err(Error::new(ErrorKind::InvalidData, format!("{} occurs twice", path.display())));
        }
    }
    Ok(corpus)
}

fn pack(corpus: &Corpus) -> Result<Vec<u8>> {
    let mut archive = tar::Builder::new(Vec::new());
    for (name, input) in corpus {
        let mut header = tar::Header::new_ustar();
        header.set_size(input.len() as u64);
        header.set_mode(0o644);
        header.set_mtime(0);
        archive.append_data(&mut header, name, &input[..])?;
    }
    archive.into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corpus(inputs: &[(&str, &[u8])]) -> Corpus {
        inputs.iter().map(|(name, input)| ((*name).to_owned(), input.to_vec())).collect()
    }

    #[test]
    fn archives_round_trip_and_are_deterministic() {
        let inputs: [(&str, &[u8]); 3] = [("b", &[0xFD; 513]), ("seed-000", &[]), ("a", b"x")];
        let packed = pack(&corpus(&inputs)).expect("packed");
        assert_eq!(unpack(&packed).expect("unpacked"), corpus(&inputs));
        let [first, second, third] = inputs;
        assert_eq!(pack(&corpus(&[third, first, second])).expect("packed"), packed);
    }

    #[test]
    fn names_with_folders_are_refused() {
        let packed = pack(&corpus(&[("a/b", b"x")])).expect("packed");
        assert!(unpack(&packed).is_err());
    }
}
