//! The definitions in this crate: minimal, standard and common, from which `mavstack::dialect` is generated.

use std::path::{Path, PathBuf};

/// Stands for the files' directory in error messages.
const PLACE: &str = "<mavstack-dialect>";

const FILES: [(&str, &str); 3] = [
    ("common.xml", include_str!("../definitions/common.xml")),
    ("minimal.xml", include_str!("../definitions/minimal.xml")),
    ("standard.xml", include_str!("../definitions/standard.xml")),
];

/// Returns the text of the definition with a path from [`path`].
pub(crate) fn text(path: &Path) -> Option<&'static str> {
    let name = path.strip_prefix(PLACE).ok()?;
    FILES.iter().find(|(file, _)| name == Path::new(file)).map(|(_, text)| *text)
}

/// Returns the path of the definition with this file name; `None` if there is no such definition.
pub(crate) fn path(name: &str) -> Option<PathBuf> {
    let path = Path::new(PLACE).join(name);
    text(&path).is_some().then_some(path)
}
