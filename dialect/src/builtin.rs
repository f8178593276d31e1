//! The definitions that come with this crate: minimal, standard and common, those that `mavstack::dialect` is made from.

use std::path::{Path, PathBuf};

/// What the files are called in messages to people, in place of a directory.
const PLACE: &str = "<mavstack-dialect>";

const FILES: [(&str, &str); 3] = [
    ("common.xml", include_str!("../definitions/common.xml")),
    ("minimal.xml", include_str!("../definitions/minimal.xml")),
    ("standard.xml", include_str!("../definitions/standard.xml")),
];

/// The text of the definition that a path made by [`path`] names.
pub(crate) fn text(path: &Path) -> Option<&'static str> {
    let name = path.strip_prefix(PLACE).ok()?;
    FILES.iter().find(|(file, _)| name == Path::new(file)).map(|(_, text)| *text)
}

/// Names the definition of this file name, if it is one of these.
pub(crate) fn path(name: &str) -> Option<PathBuf> {
    let path = Path::new(PLACE).join(name);
    text(&path).is_some().then_some(path)
}
