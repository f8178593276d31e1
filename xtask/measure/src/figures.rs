//! Each figure once: `docs/figures.toml`, and the pages that show what is in it.
//!
//! - A command writes what it measured into its section of the file with `--accept`. Without, it fails if a figure has moved.
//! - A page shows a figure between `<!-- fig:size.heartbeat.m4-s -->` and `<!-- /fig -->`, and a table between
//!   `<!-- table:size -->` and `<!-- /table -->`.
//! - `cargo measure figures`, and a test, fail if a page disagrees with the file; `--write` corrects the pages.

use std::fs;
use std::path::{Path, PathBuf};

use crate::system::{Result, output, root};
use crate::{options, size};

/// The file. A section that no command here measures is written by hand; its `command` says what prints its figures.
const FILE: &str = "docs/figures.toml";
/// What the file begins with.
const HEAD: &str =
    "# The figures that pages show, by the command that measures them: CONTRIBUTING.md says how to change one.\n";
/// Keys of a section that are no figures.
const COMMAND: &str = "command";
const RUSTC: &str = "rustc";
const COMMIT: &str = "commit";

/// Files, and folders of files, that may show figures.
const PAGES: [&str; 6] = ["README.md", "CONTRIBUTING.md", "dialect/README.md", "docs", "fuzz/README.md", "src"];

/// Writes a table from the figures.
type Table = fn(&Figures) -> String;

/// Tables that pages show whole, by their names.
const TABLES: [(&str, Table); 3] =
    [("size", size::table), ("options", options::table), ("vehicles", options::vehicles)];

/// Tables with `{section.key}` in place of each figure.
const TEMPLATES: [(&str, &str); 11] = [
    ("boards", include_str!("tables/boards.txt")),
    ("calls", include_str!("tables/calls.txt")),
    ("delays", include_str!("tables/delays.txt")),
    ("erases", include_str!("tables/erases.txt")),
    ("late", include_str!("tables/late.txt")),
    ("libraries", include_str!("tables/libraries.txt")),
    ("load", include_str!("tables/load.txt")),
    ("speed", include_str!("tables/speed.txt")),
    ("targets", include_str!("tables/targets.txt")),
    ("times", include_str!("tables/times.txt")),
    ("work", include_str!("tables/work.txt")),
];

/// A figure as it was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    key: String,
    value: String,
    /// By how many percent it may differ from the accepted value; `None` where it changes with the machine or the build.
    tolerance: Option<f64>,
}

impl Figure {
    /// A figure that may have any value.
    pub fn new(key: impl Into<String>, value: impl ToString) -> Self {
        Self { key: key.into(), value: value.to_string(), tolerance: None }
    }

    /// Returns whether this is its key.
    #[cfg(test)]
    pub fn is(&self, key: &str) -> bool {
        self.key == key
    }

    /// The same, which may differ from the accepted value by so many percent.
    pub fn within(self, percent: f64) -> Self {
        Self { tolerance: Some(percent), ..self }
    }
}

/// Compares what `cargo measure <section>` has measured with the file, or with `accepts` writes it there and on the pages.
///
/// `rustc` is the version of the compiler. With another one than the file names, differences are printed and are no errors.
pub fn settle(section: &str, rustc: &str, figures: &[Figure], accepts: bool) -> Result {
    let mut all = Figures::read()?;
    let changes = changes(all.section(section), figures);
    for change in &changes {
        println!("{section}.{change}");
    }
    if accepts {
        all.replace(section, rustc, &commit(), figures);
        let path = root().join(FILE);
        fs::write(&path, all.text()).map_err(|error| format!("{FILE}: {error}"))?;
        return all.check(true);
    }
    if changes.is_empty() {
        return Ok(());
    }
    if all.get(&format!("{section}.{RUSTC}")).is_some_and(|accepted| accepted != rustc) {
        println!("These figures are of another compiler than those in {FILE}, so the differences are no errors.");
        return Ok(());
    }
    Err(format!(
        "figures differ from {FILE}: {}. If the change is intended, run `cargo measure {section} --accept` and describe it in \
         CHANGELOG.md",
        changes.join("; ")
    ))
}

/// `cargo measure figures`: compares the pages with the file, or with `writes` corrects them.
pub fn check(writes: bool) -> Result {
    Figures::read()?.check(writes)
}

/// Returns the figures that moved beyond their tolerance, and those that are gone. A new one is shown by no page yet.
fn changes(old: &[Entry], new: &[Figure]) -> Vec<String> {
    let mut changes = Vec::new();
    for Figure { key, value, tolerance } in new {
        let before = old.iter().find(|(known, _)| known == key).map(|(_, before)| before);
        let (Some(before), Some(percent)) = (before, tolerance) else { continue };
        let has_moved = match (number(before), number(value)) {
            (Some(before), Some(value)) => (value - before).abs() * 100.0 > before.abs() * percent,
            _ => before != value,
        };
        if has_moved {
            changes.push(format!("{key}: {before} -> {value}"));
        }
    }
    let is_gone = |key: &str| ![COMMAND, RUSTC, COMMIT].contains(&key) && new.iter().all(|figure| figure.key != key);
    changes.extend(old.iter().filter(|(key, _)| is_gone(key)).map(|(key, _)| format!("{key}: gone")));
    changes
}

/// Returns the number that a figure shows.
pub fn number(value: &str) -> Option<f64> {
    value.replace(',', "").replace('−', "-").parse().ok()
}

/// Formats with commas between thousands.
pub fn grouped(number: u64) -> String {
    if number < 1000 { number.to_string() } else { format!("{},{:03}", grouped(number / 1000), number % 1000) }
}

/// Returns the checked-out commit. Changes of pages, and of the figures themselves, are no changes of what is measured.
fn commit() -> String {
    let folder = root().to_string_lossy();
    let git = |arguments: &[&str]| output("git", &[&["-C", &folder], arguments].concat());
    let Some(commit) = git(&["rev-parse", "--short=10", "HEAD"]) else { return "unknown".to_owned() };
    let changes = git(&["status", "--porcelain", "--", ".", ":!docs", ":!*.md"]).unwrap_or_default();
    if changes.is_empty() { commit } else { format!("{commit} with changes") }
}

/// A key and its value.
type Entry = (String, String);

/// The content of the file: sections with their keys and values, in order.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Figures(Vec<(String, Vec<Entry>)>);

impl Figures {
    /// Reads the file.
    pub fn read() -> Result<Self> {
        let text = fs::read_to_string(root().join(FILE)).map_err(|error| format!("{FILE}: {error}"))?;
        Self::parse(&text)
    }

    /// Parses the part of TOML that the file uses: `[section]` and `key = "value"`.
    pub fn parse(text: &str) -> Result<Self> {
        let mut sections: Vec<(String, Vec<Entry>)> = Vec::new();
        for (at, line) in text.lines().enumerate() {
            let wrong = || format!("{FILE}:{}: expected `[section]` or `key = \"value\"`: {line}", at + 1);
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            if let Some(name) = line.strip_prefix('[') {
                sections.push((name.strip_suffix(']').ok_or_else(wrong)?.to_owned(), Vec::new()));
                continue;
            }
            let (key, value) = line.split_once(" = ").ok_or_else(wrong)?;
            let value = value.strip_prefix('"').and_then(|value| value.strip_suffix('"')).ok_or_else(wrong)?;
            let (_, entries) = sections.last_mut().ok_or_else(wrong)?;
            if entries.iter().any(|(known, _)| known == key) {
                return Err(format!("{FILE}:{}: {key} is there twice", at + 1));
            }
            entries.push((key.to_owned(), value.to_owned()));
        }
        Ok(Self(sections))
    }

    /// The opposite of [`parse`](Self::parse).
    fn text(&self) -> String {
        let mut text = HEAD.to_owned();
        for (section, entries) in &self.0 {
            text += &format!("\n[{section}]\n");
            entries.iter().for_each(|(key, value)| text += &format!("{key} = \"{value}\"\n"));
        }
        text
    }

    fn section(&self, name: &str) -> &[Entry] {
        self.0.iter().find(|(section, _)| section == name).map_or(&[], |(_, entries)| entries)
    }

    /// Returns the value of `section.key`.
    pub fn get(&self, id: &str) -> Option<&str> {
        let (section, key) = id.split_once('.')?;
        self.section(section).iter().find(|(known, _)| known == key).map(|(_, value)| value.as_str())
    }

    fn replace(&mut self, section: &str, rustc: &str, commit: &str, figures: &[Figure]) {
        let command = format!("cargo measure {section}");
        let head = [(COMMAND, command.as_str()), (RUSTC, rustc), (COMMIT, commit)];
        let head = head.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let figures = figures.iter().map(|figure| (figure.key.clone(), figure.value.clone()));
        let entries = head.into_iter().chain(figures).collect();
        match self.0.iter_mut().find(|(known, _)| known == section) {
            Some((_, old)) => *old = entries,
            None => self.0.push((section.to_owned(), entries)),
        }
    }

    /// Compares the pages with the figures, or with `writes` corrects them.
    fn check(&self, writes: bool) -> Result {
        let mut faults = Vec::new();
        for path in pages()? {
            let name = path.strip_prefix(root()).unwrap_or(&path).display();
            let text = fs::read_to_string(&path).map_err(|error| format!("{name}: {error}"))?;
            let (fresh, differences) = self.filled(&text).map_err(|error| format!("{name}: {error}"))?;
            if writes && fresh != text {
                fs::write(&path, fresh).map_err(|error| format!("{name}: {error}"))?;
                println!("{name}: written");
            } else {
                faults.extend(differences.into_iter().map(|difference| format!("{name}: {difference}")));
            }
        }
        if faults.is_empty() {
            return Ok(());
        }
        Err(format!(
            "{}\n{FILE} has other figures; `cargo measure figures --write` corrects the pages",
            faults.join("\n")
        ))
    }

    /// Returns the page `text` with all marked figures and tables as they are in the file, and what was different.
    fn filled(&self, text: &str) -> Result<(String, Vec<String>)> {
        let (text, mut differences) = replaced(text, "fig", |id| {
            self.get(id).map(str::to_owned).ok_or_else(|| format!("{FILE} has no figure {id}"))
        })?;
        let (text, tables) = replaced(&text, "table", |name| {
            if let Some((_, template)) = TEMPLATES.iter().find(|(known, _)| *known == name) {
                return Ok(format!("\n{}", self.inserted(template)?));
            }
            let (_, table) = TABLES.iter().find(|(known, _)| *known == name).ok_or(format!("no table {name}"))?;
            Ok(format!("\n{}", table(self)))
        })?;
        differences.extend(tables);
        Ok((text, differences))
    }
}

impl Figures {
    /// Returns the template with its figures.
    fn inserted(&self, template: &str) -> Result<String> {
        let mut parts = template.split('{');
        let mut text = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (id, rest) = part.split_once('}').ok_or_else(|| format!("a template has no `}}` after `{{{part}`"))?;
            text += self.get(id).ok_or_else(|| format!("{FILE} has no figure {id}"))?;
            text += rest;
        }
        Ok(text)
    }
}

/// Replaces what is between `<!-- kind:id -->` and `<!-- /kind -->` by the value of each id, and lists what was different.
///
/// An id begins with a small letter, so that a text about the marks can write ID.
fn replaced(text: &str, kind: &str, value: impl Fn(&str) -> Result<String>) -> Result<(String, Vec<String>)> {
    let (begin, end) = (format!("<!-- {kind}:"), format!("<!-- /{kind} -->"));
    let (mut fresh, mut rest, mut differences) = (String::new(), text, Vec::new());
    while let Some((before, after)) = rest.split_once(&begin) {
        fresh += before;
        fresh += &begin;
        rest = after;
        if !rest.starts_with(|c: char| c.is_ascii_lowercase()) {
            continue;
        }
        let unclosed = || format!("`{begin}{}` has no {end}", after.lines().next().unwrap_or_default());
        let line = fresh.rsplit('\n').next().unwrap_or_default().trim_end_matches(&begin);
        if kind == "fig" && !line.contains(|c: char| c.is_alphanumeric() || c == '|') {
            // Markdown would take the whole line as HTML.
            return Err(format!("a line must not begin with `{begin}`; break it elsewhere"));
        }
        let (id, after) = rest.split_once(" -->").ok_or_else(unclosed)?;
        let (shown, after) = after.split_once(&end).ok_or_else(unclosed)?;
        if shown.contains(&begin) {
            return Err(unclosed());
        }
        let value = value(id)?;
        if shown != value {
            differences.push(match kind {
                "fig" => format!("{id} is {value}, not {shown}"),
                _ => format!("the {kind} {id} differs"),
            });
        }
        fresh += &format!("{id} -->{value}{end}");
        rest = after;
    }
    Ok((fresh + rest, differences))
}

/// Returns the files that may show figures.
fn pages() -> Result<Vec<PathBuf>> {
    let mut pages = Vec::new();
    PAGES.iter().try_for_each(|page| collect(&root().join(page), &mut pages))?;
    Ok(pages)
}

fn collect(path: &Path, pages: &mut Vec<PathBuf>) -> Result {
    if path.is_dir() {
        let entries = fs::read_dir(path).map_err(|error| format!("{}: {error}", path.display()))?;
        entries.flatten().try_for_each(|entry| collect(&entry.path(), pages))?;
    } else if path.extension().is_some_and(|extension| extension == "md" || extension == "rs") {
        pages.push(path.to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# The figures that pages show, by the command that measures them: CONTRIBUTING.md says how to change one.\n\n\
        [size]\ncommand = \"cargo measure size\"\nrustc = \"1.95.0\"\na.flash = \"1,000\"\na.ram = \"0\"\n\n[by-hand]\nb = \"x\"\n";

    fn figures() -> Figures {
        Figures::parse(TEXT).expect("figures")
    }

    /// Every page of the repository agrees with the file.
    #[test]
    fn no_page_shows_another_figure() {
        assert_eq!(check(false), Ok(()));
    }

    #[test]
    fn a_template_has_the_figures() {
        let inserted = |template| figures().inserted(template);
        assert_eq!(inserted("| a | {size.a.flash} | {by-hand.b} |\n"), Ok("| a | 1,000 | x |\n".to_owned()));
        assert!(inserted("{size.c}").is_err() && inserted("{size.a.flash").is_err());
    }

    #[test]
    fn the_file_is_written_as_it_is_read() {
        assert_eq!(figures().text(), TEXT);
        assert_eq!(figures().get("size.a.flash"), Some("1,000"));
        assert_eq!((figures().get("size.b"), figures().get("other.b")), (None, None));
        for wrong in ["a = \"1\"", "[a]\nb = 1", "[a\n", "[a]\nb = \"1\"\nb = \"1\""] {
            assert!(Figures::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_figure_that_moved_beyond_its_tolerance_is_a_change() {
        let measured = |flash: &str| [Figure::new("a.flash", flash).within(1.0), Figure::new("a.ram", "7")];
        let figures = figures();
        let changes = |flash| changes(figures.section("size"), &measured(flash));
        for flash in ["990", "1,000", "1,010"] {
            assert_eq!(changes(flash), [""; 0]);
        }
        assert_eq!(changes("1,011"), ["a.flash: 1,000 -> 1,011"]);
        assert_eq!(changes("989"), ["a.flash: 1,000 -> 989"]);
    }

    #[test]
    fn figures_that_are_gone_are_changes_and_new_ones_are_not() {
        let new = [Figure::new("a.flash", "1,000"), Figure::new("b", "2")];
        assert_eq!(changes(figures().section("size"), &new), ["a.ram: gone"]);
        assert_eq!(changes(figures().section("none"), &[]), [""; 0]);
    }

    #[test]
    fn a_section_is_replaced_whole_and_the_others_stay() {
        let mut figures = figures();
        figures.replace("size", "1.96.0", "0123456789", &[Figure::new("a.ram", "8")]);
        assert_eq!((figures.get("size.a.ram"), figures.get("size.a.flash")), (Some("8"), None));
        assert_eq!((figures.get("size.rustc"), figures.get("size.commit")), (Some("1.96.0"), Some("0123456789")));
        assert_eq!(figures.get("by-hand.b"), Some("x"));
    }

    #[test]
    fn a_page_gets_the_figures_of_the_file() {
        let page = |shown: &str| format!("<!-- fig:ID --> a <!-- fig:size.a.flash -->{shown}<!-- /fig --> bytes\n");
        assert_eq!(figures().filled(&page("1,000")), Ok((page("1,000"), vec![])));
        let difference = vec!["size.a.flash is 1,000, not 999".to_owned()];
        assert_eq!(figures().filled(&page("999")), Ok((page("1,000"), difference)));
        for wrong in
            ["a <!-- fig:size.c -->1<!-- /fig -->", "a <!-- fig:size.a.ram -->0", "<!-- table:none --><!-- /table -->"]
        {
            assert!(figures().filled(wrong).is_err(), "{wrong}");
        }
        assert!(figures().filled("a\n<!-- fig:size.a.ram -->0<!-- /fig --> b").is_err(), "would not be Markdown");
        let two = "a <!-- fig:size.a.ram -->0 <!-- fig:size.a.flash -->1,000<!-- /fig -->";
        assert!(figures().filled(two).is_err_and(|error| error.contains("has no <!-- /fig -->")));
    }

    #[test]
    fn figures_are_read_as_people_write_them() {
        assert_eq!(
            [("1,234", 1_234.0), ("−0.5", -0.5), ("99.4", 99.4)].map(|(text, _)| number(text)),
            [Some(1_234.0), Some(-0.5), Some(99.4)]
        );
        assert_eq!((number("none"), grouped(1_234_567), grouped(12)), (None, "1,234,567".to_owned(), "12".to_owned()));
    }
}
