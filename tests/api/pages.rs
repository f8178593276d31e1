//! The README, the guides and the other pages: their links have targets, and the commands and files that they name exist.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The address of the repository. Only the workspace's manifest contains it.
const ADDRESS: &str = "github.com/mavstack/mavstack";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files below this folder with this extension, without build output and hidden folders.
fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_left_out = name.starts_with('.') || name == "target";
        if path.is_dir() && !is_left_out {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|found| found == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// A Markdown file.
struct Page {
    path: PathBuf,
    /// Its text without code blocks.
    text: String,
}

impl Page {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let mut is_code = false;
        let mut prose = String::new();
        for line in text.lines() {
            let is_fence = line.trim_start().starts_with("```");
            is_code ^= is_fence;
            if !is_code && !is_fence && !line.starts_with("    ") {
                prose.push_str(line);
            }
            prose.push('\n');
        }
        Self { path: path.into(), text: prose }
    }

    fn all() -> Vec<Self> {
        files(root(), "md").iter().map(|path| Self::read(path)).collect()
    }

    fn name(&self) -> String {
        self.path.strip_prefix(root()).unwrap().display().to_string()
    }

    /// Returns the code spans, and the text without them.
    fn code(&self) -> (Vec<&str>, String) {
        let (mut spans, mut prose) = (Vec::new(), String::new());
        for (part, text) in self.text.split('`').enumerate() {
            if part % 2 == 0 { prose.push_str(text) } else { spans.push(text) }
        }
        (spans, prose)
    }

    /// Returns the targets of its links and pictures, and the labels without a definition.
    fn links(&self) -> (Vec<String>, Vec<String>) {
        let (_, prose) = self.code();
        let (mut targets, mut used, mut defined) = (Vec::new(), Vec::new(), BTreeSet::new());
        for line in prose.lines() {
            if let Some((label, target)) = line.strip_prefix('[').and_then(|line| line.split_once("]: ")) {
                defined.insert(label.to_lowercase());
                targets.push(target.trim().to_owned());
            }
        }
        // A link's text may begin on one line and end on the next.
        let mut rest = &prose[..];
        while let Some((_, after)) = rest.split_once('[') {
            let Some((text, after)) = after.split_once(']') else { break };
            rest = after;
            if let Some(target) = after.strip_prefix('(').and_then(|after| after.split(')').next()) {
                targets.push(target.to_owned());
            } else if let Some(label) = after.strip_prefix('[').and_then(|after| after.split(']').next()) {
                used.push(if label.is_empty() { text.to_lowercase() } else { label.to_lowercase() });
                rest = after.split_once(']').map_or("", |(_, after)| after);
            } else if !after.starts_with(": ") {
                used.push(text.to_lowercase());
            }
        }
        used.retain(|label| !defined.contains(label));
        (targets, used)
    }

    /// Returns the anchors of its headings, as forges and rustdoc generate them.
    fn anchors(&self) -> BTreeSet<String> {
        let headings = self.text.lines().filter(|line| line.starts_with('#'));
        let anchor = |heading: &str| -> String {
            let words = heading.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
            words.chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_')).collect()
        };
        headings.map(anchor).collect()
    }
}

#[test]
fn every_relative_link_has_a_target() {
    let mut dead = Vec::new();
    for page in Page::all() {
        for target in page.links().0 {
            // External links, and links that rustdoc checks.
            if target.contains("://") || target.contains("::") {
                continue;
            }
            let (path, anchor) = target.split_once('#').map_or((&target[..], None), |(path, id)| (path, Some(id)));
            let to = if path.is_empty() { page.path.clone() } else { page.path.with_file_name("").join(path) };
            let is_dead = match anchor {
                Some(id) => !to.is_file() || !Page::read(&to).anchors().contains(id),
                None => !to.exists(),
            };
            if is_dead {
                dead.push(format!("{}: {target}", page.name()));
            }
        }
    }
    assert!(dead.is_empty(), "dead links:\n{}", dead.join("\n"));
}

/// A `[label]` without a definition would be shown as plain text.
#[test]
fn every_label_of_the_readme_and_the_guides_is_defined() {
    let mut undefined = Vec::new();
    for page in Page::all().iter().filter(|page| page.name() == "README.md" || page.name().starts_with("docs")) {
        undefined.extend(page.links().1.iter().map(|label| format!("{}: [{label}]", page.name())));
    }
    assert!(undefined.is_empty(), "labels without a definition:\n{}", undefined.join("\n"));
}

/// In rustdoc a guide is a module, so a link from guide to guide needs a label that `src/guides.rs` defines too.
#[test]
fn every_guide_is_in_the_documentation_and_links_to_the_others_by_label() {
    let guides = fs::read_to_string(root().join("src/guides.rs")).unwrap();
    for path in files(&root().join("docs"), "md") {
        let page = Page::read(&path);
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        let label = file.trim_end_matches(".md");
        let module = label.replace('-', "_");
        assert!(guides.contains(&format!("\"../docs/{file}\"")), "src/guides.rs has no page for docs/{file}");
        let definition = format!("[{label}]: crate::guides::{module}");
        assert!(guides.contains(&definition), "src/guides.rs lacks \"{definition}\"");
        let (_, prose) = page.code();
        assert!(
            !prose.contains(".md)"),
            "docs/{file}: write [text][label] with a definition at the end, which rustdoc's replaces; \
             an inline link to a file leads nowhere there"
        );
        for line in prose.lines().filter(|line| line.starts_with('[') && line.contains("]: ")) {
            let (label, target) = line.split_once("]: ").unwrap();
            let is_guide = target.strip_suffix(".md") == label.strip_prefix('[');
            assert!(target.contains("://") || is_guide, "docs/{file}: {line}: rustdoc has no such page");
        }
    }
}

#[test]
fn repository_address_is_in_one_place() {
    let mut elsewhere = Vec::new();
    for path in ["md", "rs", "toml", "yml", "py"].iter().flat_map(|extension| files(root(), extension)) {
        let name = path.strip_prefix(root()).unwrap().display().to_string();
        let is_meant = name == "Cargo.toml" || path.ends_with(file!().rsplit('/').next().unwrap());
        if !is_meant && fs::read_to_string(&path).unwrap().contains(ADDRESS) {
            elsewhere.push(name);
        }
    }
    assert!(elsewhere.is_empty(), "link by relative path, or to `guides`, not to {ADDRESS}: {elsewhere:?}");
}

/// Detects moved files and renamed tests.
#[test]
fn every_file_and_test_that_a_page_names_exists() {
    const FOLDERS: [&str; 10] =
        [".ci/", "benches/", "crates/", "dialect/", "docs/", "examples/", "fuzz/", "src/", "tests/", "xtask/"];
    let mut missing = Vec::new();
    for page in Page::all() {
        let name = page.name();
        // Other pages describe their own folder, or the past.
        if !(name.starts_with("docs") || ["README.md", "CONTRIBUTING.md"].contains(&&name[..])) {
            continue;
        }
        let (spans, _) = page.code();
        for span in &spans {
            let is_path = FOLDERS.iter().any(|folder| span.starts_with(folder));
            if is_path && !span.contains([' ', '<', '*', '…']) && !root().join(span).exists() {
                missing.push(format!("{name}: `{span}`"));
            }
        }
        let words: Vec<_> = spans.iter().flat_map(|span| span.split_whitespace()).collect();
        for pair in words.windows(2).filter(|pair| pair[0] == "--test") {
            let test = root().join("tests").join(pair[1]);
            if !test.with_extension("rs").exists() && !test.join("main.rs").exists() {
                missing.push(format!("{name}: `cargo test --test {}`", pair[1]));
            }
        }
    }
    assert!(missing.is_empty(), "missing files and tests:\n{}", missing.join("\n"));
}

/// The README can be read in a few minutes; further content belongs to the guides.
#[test]
fn readme_is_short() {
    let len = fs::metadata(root().join("README.md")).unwrap().len();
    assert!(len <= 9_000, "README.md has {len} bytes: move something to docs/");
}
