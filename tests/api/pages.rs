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

/// The pages of `docs/` without the table of contents of the book.
fn guides() -> Vec<PathBuf> {
    files(&root().join("docs"), "md").into_iter().filter(|path| !path.ends_with("SUMMARY.md")).collect()
}

/// In rustdoc a guide is a module, so a link from guide to guide needs a label that `src/guides.rs` defines too.
#[test]
fn every_guide_is_in_the_documentation_and_links_to_the_others_by_label() {
    let modules = fs::read_to_string(root().join("src/guides.rs")).unwrap();
    for path in guides() {
        let page = Page::read(&path);
        let name = page.name();
        let label = path.file_stem().unwrap().to_string_lossy().into_owned();
        let module = name.trim_start_matches("docs/").trim_end_matches(".md").replace('-', "_").replace('/', "::");
        assert!(modules.contains(&format!("\"../{name}\"")), "src/guides.rs has no page for {name}");
        let definition = format!("[{label}]: crate::guides::{module}\n");
        assert!(modules.contains(&definition), "src/guides.rs lacks \"{definition}\"");
        let (_, prose) = page.code();
        assert!(
            !prose.contains(".md)"),
            "{name}: write [text][label] with a definition at the end, which rustdoc's replaces; \
             an inline link to a file leads nowhere there"
        );
        for line in prose.lines().filter(|line| line.starts_with('[') && line.contains("]: ")) {
            let (label, target) = line.split_once("]: ").unwrap();
            let is_guide = target.rsplit('/').next().unwrap().strip_suffix(".md") == label.strip_prefix('[');
            assert!(target.contains("://") || is_guide, "{name}: {line}: rustdoc has no such page");
        }
    }
}

/// `cargo xtask book` builds the pages that `docs/SUMMARY.md` lists.
#[test]
fn every_guide_is_in_the_book() {
    let (listed, _) = Page::read(&root().join("docs/SUMMARY.md")).links();
    let listed: BTreeSet<_> = listed.into_iter().map(|target| format!("docs/{target}")).collect();
    let guides: BTreeSet<_> = guides().iter().map(|path| Page::read(path).name()).collect();
    assert_eq!(listed, guides);
}

/// A block of Rust on a page.
struct Block {
    /// The line of its fence, counted from 1.
    line: usize,
    /// The file that it quotes: `<!-- quote: FILE -->` in the line before the fence.
    source: Option<String>,
    code: Vec<String>,
}

impl Block {
    fn all(page: &str) -> Vec<Self> {
        let mut blocks = Vec::new();
        let mut lines = (1..).zip(page.lines());
        let mut before = "";
        while let Some((line, text)) = lines.next() {
            if text.trim_start().starts_with("```") {
                let code = lines.by_ref().map(|(_, text)| text.to_owned()).take_while(|text| text.trim() != "```");
                let code = code.collect();
                if text.trim_start().starts_with("```rust") {
                    let source = before.strip_prefix("<!-- quote: ").and_then(|rest| rest.strip_suffix(" -->"));
                    blocks.push(Self { line, source: source.map(str::to_owned), code });
                }
            }
            before = text;
        }
        blocks
    }

    /// Returns the first line that is not in the source, if the block is no part of it. A part may be indented further there.
    fn difference(&self, source: &str) -> Option<&str> {
        let source: Vec<_> = source.lines().collect();
        let equal = |from: &usize| {
            let lines = &source[*from..];
            let indent = lines[0].len().saturating_sub(self.code[0].len());
            let is_equal = |(quoted, line): &(&String, &&str)| {
                let cut = line.get(indent..).unwrap_or_default();
                **quoted == cut && (quoted.is_empty() || line[..indent].trim().is_empty())
            };
            self.code.iter().zip(lines).take_while(is_equal).count()
        };
        let most = (0..source.len()).map(|from| equal(&from)).max().unwrap_or_default();
        self.code.get(most).map(String::as_str)
    }
}

/// Returns what is wrong with the blocks of Rust on a page.
fn faults_of_blocks(page: &str, is_doctested: bool, read: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let mut faults = Vec::new();
    for block in Block::all(page) {
        let line = block.line;
        if block.code.iter().any(|text| text == "#" || text.starts_with("# ")) {
            faults.push(format!("{line}: a hidden line, which a web page shows"));
        }
        match &block.source {
            None if is_doctested => {}
            None => {
                faults.push(format!("{line}: write `<!-- quote: FILE -->` in the line before, and compile that file"))
            }
            Some(file) => match read(file) {
                None => faults.push(format!("{line}: there is no {file}")),
                Some(source) => {
                    let difference = block.difference(&source);
                    faults
                        .extend(difference.map(|text| format!("{line}: {file} has another line in place of {text:?}")));
                }
            },
        }
    }
    faults
}

/// Code on a page is quoted from a file that is compiled, or it is a test of the crate that the page documents.
#[test]
fn every_block_of_rust_is_quoted() {
    let mut faults = Vec::new();
    for page in Page::all() {
        let text = fs::read_to_string(&page.path).unwrap();
        let library = fs::read_to_string(page.path.with_file_name("src/lib.rs")).unwrap_or_default();
        let is_doctested =
            library.contains("#![doc = include_str!(\"../README.md\")]") && !text.contains("```rust,ignore");
        let read = |file: &str| fs::read_to_string(root().join(file)).ok();
        let found = faults_of_blocks(&text, is_doctested, read);
        faults.extend(found.into_iter().map(|fault| format!("{}:{fault}", page.name())));
    }
    assert!(faults.is_empty(), "blocks of Rust:\n{}", faults.join("\n"));
}

#[test]
fn a_quote_that_differs_is_found() {
    let page = |marker: &str, code: &str| format!("Text\n{marker}\n```rust\n{code}\n```\n");
    let source = "mod a {\n    fn b() {\n        c();\n\n        d();\n    }\n}\n";
    let read = |file: &str| (file == "a.rs").then(|| source.to_owned());
    let faults =
        |marker: &str, code: &str, is_doctested: bool| faults_of_blocks(&page(marker, code), is_doctested, read).len();
    let marker = "<!-- quote: a.rs -->";
    assert_eq!(faults(marker, "fn b() {\n    c();\n\n    d();\n}", false), 0);
    assert_eq!(faults(marker, "        d();\n    }\n}", false), 0);
    for other in
        ["fn b() {\n    d();\n}", "fn b() {\n  c();", "c();\nd();", "fn b() {\n    c();\n\n    d();\n}\n}", "b() {"]
    {
        assert_eq!(faults(marker, other, false), 1, "{other}");
    }
    assert_eq!(faults("<!-- quote: b.rs -->", "c();", false), 1, "no such file");
    assert_eq!((faults("", "c();", false), faults("", "c();", true)), (1, 0), "no marker");
    assert_eq!(faults(marker, "c();\n# hidden();", false), 2, "a hidden line");
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

/// The README can be read in a few minutes, a guide in a quarter of an hour: link to another page, or delete what is said twice.
#[test]
fn pages_are_short() {
    const BOUNDS: [(&str, u64); 6] = [
        ("README.md", 9_000),
        ("docs/start.md", 15_000),
        ("docs/transports.md", 15_000),
        ("docs/vehicle.md", 15_000),
        ("docs/tasks.md", 15_000),
        ("docs/storage.md", 12_000),
    ];
    const ALL: u64 = 250_000;
    let len = |path: &Path| fs::metadata(path).unwrap().len();
    for (page, bound) in BOUNDS {
        let len = len(&root().join(page));
        assert!(len <= bound, "{page} has {len} bytes, more than {bound}");
    }
    let all =
        len(&root().join("README.md")) + files(&root().join("docs"), "md").iter().map(|path| len(path)).sum::<u64>();
    assert!(all <= ALL, "README.md and docs/ have {all} bytes, more than {ALL}");
}
