//! The rooms of `src/`: a room is a file or a folder, and uses only rooms above it in [`ROOMS`]. `docs/architecture.md` shows
//! the same list. The tests read the imports and the paths of all code outside of tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The rooms, from the ground up. `message` and `dialect` are one room. Each service is a room of its own: services may use
/// each other, but not in a ring.
const ROOMS: [&[&str]; 21] = [
    &["num"],
    &["list"],
    &["crc"],
    &["crc32"],
    &["pulse"],
    &["time"],
    &["log"],
    &["message", "dialect"],
    &["frame"],
    &["types"],
    &["link"],
    &["network"],
    &["service"],
    &["service/*"],
    &["storage"],
    &["stack"],
    &["io"],
    &["telemetry"],
    &["wpl"],
    &["metadata"],
    &["guides"],
];

/// The files of `service/` that belong to the room `service`: what services share.
const SERVICE_ROOT: [&str; 7] = ["context", "gate", "list", "rate_limit", "request", "turn", "write_schedule"];

/// The path of a module, relative to the crate's root.
type ModulePath = Vec<String>;

/// A module outside of tests.
#[derive(Default)]
struct Module {
    /// Its tokens, without child modules, comments, strings and tests.
    code: Vec<String>,
    /// The names that it imports, each with its path.
    imports: BTreeMap<String, Vec<String>>,
    /// The paths that it imports with `*`.
    globs: Vec<Vec<String>>,
    /// Whether it is a part of its parent's file.
    is_inline: bool,
}

impl Module {
    /// Returns whether it defines or imports a name.
    fn has(&self, name: &str) -> bool {
        self.imports.contains_key(name) || self.code.iter().any(|token| token == name)
    }
}

/// All modules of the crate.
#[derive(Default)]
struct Modules {
    modules: BTreeMap<ModulePath, Module>,
    /// The macros, each with the module that defines it.
    macros: BTreeMap<String, ModulePath>,
}

/// Arrows between rooms: the user, the room that it uses, and one module that shows it.
type Arrows = BTreeMap<(String, String), String>;

/// Splits code into names, `::` and single characters, without comments, strings and lifetimes.
fn tokens(source: &str) -> Vec<String> {
    let chars: Vec<char> = source.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let (mut tokens, mut i) = (Vec::new(), 0);
    while i < chars.len() {
        match (at(i), at(i + 1)) {
            ('/', '/') => {
                while i < chars.len() && at(i) != '\n' {
                    i += 1;
                }
            }
            ('/', '*') => {
                while i < chars.len() && (at(i), at(i + 1)) != ('*', '/') {
                    i += 1;
                }
                i += 2;
            }
            (':', ':') => {
                tokens.push("::".to_owned());
                i += 2;
            }
            ('"', _) => {
                i += 1;
                while i < chars.len() && at(i) != '"' {
                    i += if at(i) == '\\' { 2 } else { 1 };
                }
                i += 1;
            }
            // A character literal, or a lifetime.
            ('\'', next) => {
                i += if next == '\\' { 3 } else { 2 };
                while next == '\\' && i < chars.len() && at(i) != '\'' {
                    i += 1;
                }
                i += usize::from(at(i) == '\'');
            }
            (c, _) if is_name(c) => {
                let start = i;
                while is_name(at(i)) {
                    i += 1;
                }
                let name: String = chars[start..i].iter().collect();
                if ["r", "br"].contains(&&*name) && ['"', '#'].contains(&at(i)) {
                    let hashes = chars[i..].iter().take_while(|c| **c == '#').count();
                    let end = ['"'].into_iter().chain(std::iter::repeat_n('#', hashes)).collect::<Vec<_>>();
                    i += hashes + 1;
                    while i < chars.len() && !chars[i..].starts_with(&end) {
                        i += 1;
                    }
                    i += end.len();
                } else {
                    tokens.push(name);
                }
            }
            (c, _) => {
                if !c.is_whitespace() {
                    tokens.push(c.to_string());
                }
                i += 1;
            }
        }
    }
    tokens
}

/// Returns the index after the group of brackets that starts at `start`.
fn behind_group(code: &[String], start: usize) -> usize {
    let mut depth = 0;
    for (i, token) in code.iter().enumerate().skip(start) {
        depth += i32::from(["(", "[", "{"].contains(&&**token));
        depth -= i32::from([")", "]", "}"].contains(&&**token));
        if depth == 0 {
            return i + 1;
        }
    }
    code.len()
}

/// Returns the index after the item that starts at `start` with its attributes.
fn behind_item(code: &[String], start: usize) -> usize {
    let mut i = start;
    while code.get(i).is_some_and(|token| token == "#") {
        i = behind_group(code, i + 1);
    }
    let ends_with_braces = !["use", "const", "static", "let"].contains(&&**code.get(i).unwrap_or(&String::new()));
    while let Some(token) = code.get(i) {
        match &**token {
            ";" => return i + 1,
            "{" if ends_with_braces => return behind_group(code, i),
            "(" | "[" | "{" => i = behind_group(code, i),
            _ => i += 1,
        }
    }
    i
}

/// Returns whether an attribute is `cfg(test)` or `cfg(all(test, …))`.
fn is_for_tests(attribute: &[String]) -> bool {
    let has = |name: &str| attribute.iter().any(|token| token == name);
    attribute.get(1).is_some_and(|token| token == "cfg") && has("test") && !has("not") && !has("any")
}

/// Reads a `use` tree from `at` on: its paths, each with the imported name; `*` for all names. Returns the index after it.
fn use_tree(code: &[String], mut at: usize, prefix: &[String], found: &mut Vec<(Vec<String>, String)>) -> usize {
    let mut path = prefix.to_vec();
    loop {
        match code.get(at).map(String::as_str) {
            Some("{") => {
                at += 1;
                while code.get(at).is_some_and(|token| token != "}") {
                    at = use_tree(code, at, &path, found);
                    at += usize::from(code.get(at).is_some_and(|token| token == ","));
                }
                return at + 1;
            }
            Some("*") => {
                found.push((path, "*".to_owned()));
                return at + 1;
            }
            Some("::") => at += 1,
            Some("as") => {
                found.push((path, code[at + 1].clone()));
                return at + 2;
            }
            Some(token) if ![",", "}", ";"].contains(&token) => {
                // `self` at the end of a path is the path itself.
                if token != "self" || path.is_empty() {
                    path.push(token.to_owned());
                }
                at += 1;
            }
            _ => {
                let name = path.last().cloned().unwrap_or_default();
                found.push((path, name));
                return at;
            }
        }
    }
}

impl Modules {
    /// Reads the module at `path`, whose code is `code`, and its children.
    fn read(&mut self, path: &[String], code: &[String], file: &dyn Fn(&[String]) -> String) {
        let mut module = Module::default();
        let mut i = 0;
        while let Some(token) = code.get(i) {
            let next = |n: usize| code.get(i + n).map(String::as_str).unwrap_or_default();
            match &**token {
                "#" if next(1) == "[" => {
                    let end = behind_group(code, i + 1);
                    if is_for_tests(&code[i + 1..end]) {
                        i = behind_item(code, end);
                    } else {
                        module.code.extend_from_slice(&code[i..end]);
                        i = end;
                    }
                }
                "mod" if [";", "{"].contains(&next(2)) => {
                    let child = [path, &[next(1).to_owned()]].concat();
                    if next(2) == "{" {
                        let end = behind_group(code, i + 2);
                        self.read(&child, &code[i + 3..end - 1], file);
                        self.modules.entry(child).and_modify(|module| module.is_inline = true);
                        i = end;
                    } else {
                        self.read(&child, &tokens(&file(&child)), file);
                        i += 3;
                    }
                }
                "macro_rules" if next(1) == "!" => {
                    self.macros.insert(next(2).to_owned(), path.to_vec());
                    module.code.push(token.clone());
                    i += 1;
                }
                "use" if next(1) != "<" => {
                    let mut found = Vec::new();
                    use_tree(code, i + 1, &[], &mut found);
                    for (from, name) in found {
                        if name == "*" {
                            module.globs.push(from);
                        } else {
                            module.imports.insert(name, from);
                        }
                    }
                    module.code.push(token.clone());
                    i += 1;
                }
                _ => {
                    module.code.push(token.clone());
                    i += 1;
                }
            }
        }
        self.modules.insert(path.to_vec(), module);
    }

    /// Whether a module is in `lib.rs` itself. Such a module only groups names for users.
    fn is_facade(&self, path: &[String]) -> bool {
        path.len() == 1 && self.modules.get(path).is_some_and(|module| module.is_inline)
    }

    /// Whether a module is in a room: all but those in `lib.rs`.
    fn is_in_a_room(&self, path: &[String]) -> bool {
        !path.is_empty() && !self.is_facade(path)
    }

    /// Returns the module that a path in `module` leads to; `None` for a path to another crate. A name that `lib.rs` exports
    /// leads to the module that defines it.
    fn resolve(&self, module: &[String], path: &[String]) -> Option<ModulePath> {
        let (mut at, mut rest): (ModulePath, _) = match path.first()?.as_str() {
            "crate" => (Vec::new(), &path[1..]),
            "self" | "super" => (module.to_vec(), path),
            first if self.modules.contains_key(&[module, &[first.to_owned()]].concat()) => (module.to_vec(), path),
            _ => return None,
        };
        while let Some((name, behind)) = rest.split_first() {
            let child = [&at[..], std::slice::from_ref(name)].concat();
            match name.as_str() {
                "self" => {}
                "super" => drop(at.pop()),
                _ if self.modules.contains_key(&child) => at = child,
                _ if !self.is_in_a_room(&at) => return self.exported(&at, name),
                _ => break,
            }
            rest = behind;
        }
        Some(at)
    }

    /// Returns the module that defines a name which the crate's root, or a module in `lib.rs`, exports.
    fn exported(&self, at: &[String], name: &str) -> Option<ModulePath> {
        let module = &self.modules[at];
        match (module.imports.get(name), self.macros.get(name), &module.globs) {
            (Some(path), ..) => self.resolve(at, path),
            (None, Some(home), _) => Some(home.clone()),
            (None, None, globs) => {
                let homes = globs.iter().filter_map(|glob| self.resolve(at, glob));
                homes.into_iter().find(|home| self.modules[home].has(name))
            }
        }
    }

    /// Returns the arrows between rooms.
    fn arrows(&self) -> Arrows {
        let mut arrows = Arrows::new();
        for (path, module) in self.modules.iter().filter(|(path, _)| self.is_in_a_room(path)) {
            let mut paths = Vec::new();
            let code = &module.code;
            let mut i = 0;
            while i < code.len() {
                let has = |at: usize, token: &str| code.get(at).is_some_and(|found| found == token);
                if code[i] == "use" && !has(i + 1, "<") {
                    let mut found = Vec::new();
                    i = use_tree(code, i + 1, &[], &mut found);
                    paths.extend(found.into_iter().map(|(path, _)| path));
                } else if has(i + 1, "::") {
                    let mut found = vec![code[i].clone()];
                    i += 1;
                    while has(i, "::") && code.get(i + 1).is_some_and(|name| name.starts_with(char::is_alphabetic)) {
                        found.push(code[i + 1].clone());
                        i += 2;
                    }
                    paths.push(found);
                    i += usize::from(has(i, "::"));
                } else {
                    i += 1;
                }
            }
            for target in paths.iter().filter_map(|target| self.resolve(path, target)) {
                let (from, to) = (room(path), room(&target));
                if !target.is_empty() && from != to {
                    arrows.entry((from, to)).or_insert_with(|| path.join("::"));
                }
            }
        }
        arrows
    }
}

/// Returns the room of a module.
fn room(path: &[String]) -> String {
    match path {
        [service, name, ..] if service == "service" && !SERVICE_ROOT.contains(&&**name) => format!("service/{name}"),
        [first, ..] => ROOMS.iter().find(|row| row.contains(&&**first)).map_or(&**first, |row| row[0]).to_owned(),
        [] => String::new(),
    }
}

/// Returns the row of a room in the list.
fn row(room: &str) -> Option<usize> {
    let entry = if room.starts_with("service/") { "service/*" } else { room };
    ROOMS.iter().position(|row| row.contains(&entry))
}

/// Returns the defects of the rooms and their arrows, as sentences.
fn faults(modules: &Modules) -> Vec<String> {
    let arrows = &modules.arrows();
    let paths = modules.modules.keys().filter(|path| modules.is_in_a_room(path));
    let rooms: BTreeSet<_> = paths.map(|path| room(path)).collect();
    let strays = rooms.iter().filter(|room| row(room).is_none());
    let mut faults: Vec<_> = strays.map(|room| format!("`{room}` is not in the list of rooms")).collect();
    for ((from, to), module) in arrows {
        match (row(from), row(to)) {
            (Some(above), Some(below)) if above < below => {
                faults.push(format!("`{from}` uses `{to}`, which is further down the list: see {module}"));
            }
            _ => {}
        }
    }
    // The arrows between services. Those to a service that uses none, or from one that none uses, are removed until no such
    // service is left: what remains are rings, and the arrows between rings.
    let mut left: BTreeSet<(&str, &str)> = arrows.keys().map(|(from, to)| (&**from, &**to)).collect();
    left.retain(|(from, to)| row(from) == row(to));
    loop {
        let users: BTreeSet<&str> = left.iter().map(|(from, _)| *from).collect();
        let used: BTreeSet<&str> = left.iter().map(|(_, to)| *to).collect();
        let len = left.len();
        left.retain(|(from, to)| users.contains(to) && used.contains(from));
        if left.len() == len {
            break;
        }
    }
    faults.extend(left.into_iter().map(|(from, to)| {
        let module = &arrows[&(from.to_owned(), to.to_owned())];
        format!("`{from}` uses `{to}` in a ring: see {module}")
    }));
    faults
}

/// Returns the text of a module's file under `src/`.
fn source(path: &[String]) -> String {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let file = path.iter().fold(src, |folder, name| folder.join(name));
    let found = [file.with_extension("rs"), file.join("mod.rs")].into_iter().find(|file| file.exists());
    let found = found.unwrap_or_else(|| panic!("no file for the module {}", path.join("::")));
    std::fs::read_to_string(found).expect("a file of src/ is readable")
}

fn crate_of(file: &dyn Fn(&[String]) -> String) -> Modules {
    let mut modules = Modules::default();
    modules.read(&[], &tokens(&file(&["lib".to_owned()])), file);
    modules
}

/// Each room uses only rooms above it, and no two services use each other.
#[test]
fn rooms_use_only_those_above_them() {
    let modules = crate_of(&source);
    assert!(modules.modules.len() > 80, "{} modules were found", modules.modules.len());
    let arrows = modules.arrows().len();
    assert!(arrows > 80, "{arrows} arrows were found");
    let faults = faults(&modules);
    assert!(faults.is_empty(), "the rooms of src/ have {} faults:\n{}", faults.len(), faults.join("\n"));
    for name in ROOMS.concat().into_iter().filter(|name| *name != "service/*") {
        assert!(modules.modules.contains_key(&vec![name.to_owned()]), "the list has `{name}`, which is not in src/");
    }
    for name in SERVICE_ROOT {
        let path = vec!["service".to_owned(), name.to_owned()];
        assert!(modules.modules.contains_key(&path), "`{name}` is not in src/service/");
    }
}

/// Returns the modules with `pattern` in their code, of those for which `is_in` is true; `*` is any token.
fn places<'a>(modules: &'a Modules, is_in: impl Fn(&[String]) -> bool, pattern: &[&str]) -> Vec<&'a ModulePath> {
    let has = |module: &Module| {
        let mut windows = module.code.windows(pattern.len());
        windows.any(|tokens| tokens.iter().zip(pattern).all(|(token, wanted)| *wanted == "*" || token == wanted))
    };
    modules.modules.iter().filter(|(path, module)| is_in(path) && has(module)).map(|(path, _)| path).collect()
}

/// A message, and the state of a service on a link, are known to the service only: `stack` names no message by its id or type, and
/// nothing of such a state. A frame has one way into a service, the method `on_frame` of the trait.
#[test]
fn only_a_service_knows_its_messages_and_its_links() {
    let modules = crate_of(&source);
    let in_stack = |path: &[String]| room(path) == "stack";
    for pattern in [&["state", ".", "*", "."][..], &["::", "ID"], &["decode", "::"], &["decode", "("]] {
        assert!(places(&modules, in_stack, pattern).is_empty(), "{pattern:?} in src/stack/");
    }
    let dialect = modules.modules.iter().filter(|(path, _)| in_stack(path)).flat_map(|(_, module)| &module.imports);
    for (name, _) in dialect.filter(|(_, path)| path.iter().any(|part| part == "dialect")) {
        assert!(name.starts_with("Mav"), "src/stack/ imports the message {name}");
    }
    let takes_self = places(&modules, |_| true, &["fn", "on_frame", "(", "&", "mut", "self"]);
    assert!(takes_self.len() > 5, "{takes_self:?}");
    let all = places(&modules, |_| true, &["fn", "on_frame"]);
    assert_eq!(all, takes_self, "an `on_frame` that is none of a service");
    for path in all {
        let is_list = path.last().is_some_and(|name| name == "fanout");
        assert!(is_list || path[0] == "service", "{path:?} has an `on_frame`");
    }
}

/// `docs/architecture.md` shows the list.
#[test]
fn page_shows_the_same_rooms() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/architecture.md");
    let page = std::fs::read_to_string(page).expect("the page is readable");
    let rows =
        page.lines().skip_while(|line| !line.starts_with("| room |")).skip(2).take_while(|line| line.starts_with('|'));
    let shown: Vec<Vec<&str>> = rows
        .map(|row| {
            let cell = row.split('|').nth(1).expect("a row has cells");
            cell.split('`').skip(1).step_by(2).collect()
        })
        .collect();
    assert_eq!(shown, ROOMS, "docs/architecture.md shows other rooms than tests/api/rooms.rs");
}

/// Returns the defects of a crate with these modules.
fn faults_of(files: &[(&str, &str)]) -> Vec<String> {
    let file = |path: &[String]| {
        let found = files.iter().find(|(name, _)| *name == path.join("::"));
        found.unwrap_or_else(|| panic!("no module {path:?}")).1.to_owned()
    };
    faults(&crate_of(&file))
}

/// Forbidden arrows are found in every notation.
#[test]
fn forbidden_arrow_is_found() {
    let root = "pub use stack::{Stack, Other as Renamed}; pub use message::*; use stack::Quiet; mod types; mod message; mod stack; mod num;
        pub mod facade { pub use crate::stack::Behind; }";
    for wrong in [
        "use crate::stack::Stack;",
        "use crate::{num, stack};",
        "use crate::{num::{self, One}, stack::{self, Stack}};",
        "use super::stack::*;",
        "use crate::Stack;",
        "use crate::Renamed as Mine;",
        "use crate::Quiet;",
        "use crate::facade::Behind;",
        "fn f(_: crate::facade::Behind) {}",
        "use crate::declare;",
        "fn f() -> Option<crate::stack::Stack> { None }",
        "fn f() { super::stack::f::<u8>(); }",
        "macro_rules! m { () => { $crate::Stack::new() } }",
        "mod inner { use super::super::stack::Stack; }",
        "#[cfg(not(test))] use crate::Stack;",
        "const TEXT: &str = r#\"\"\"#; const C: [char; 2] = ['\"', '\\'']; use crate::Stack;",
        "fn f<'a>(_: &'a str) { crate::Stack::new() }",
    ] {
        let stack = "#[macro_export] macro_rules! declare { () => {} }";
        let files = [("lib", root), ("types", wrong), ("message", ""), ("stack", stack), ("num", "")];
        let faults = faults_of(&files);
        assert!(faults.len() == 1 && faults[0].starts_with("`types` uses `stack`"), "{wrong}: {faults:?}");
    }
    for right in [
        "use crate::num::One; use crate::Message; use heapless::Vec;",
        "/// See [`Stack`](crate::Stack).\n// use crate::Stack;\n/* crate::Stack */",
        "const TEXT: &str = \"crate::Stack\";",
        "#[cfg(test)] mod tests { use crate::Stack; }",
        "#[cfg(test)] mod tests;",
        "#[cfg(test)] use crate::{num, Stack};",
        "#[cfg(all(test, feature = \"storage\"))] #[rustfmt::skip] fn f() -> [u8; 3] { crate::Stack::new() }",
    ] {
        let files = [
            ("lib", root),
            ("types", right),
            ("message", "pub struct Message;"),
            ("stack", "use crate::types;"),
            ("num", ""),
        ];
        assert_eq!(faults_of(&files), [""; 0], "{right}");
    }
}

/// A ring of services is found, and the room `service` must not use any of them.
#[test]
fn ring_of_services_is_found() {
    let service = |a: &str, b: &str, root: &str, turn: &str| {
        let root = format!("{root} mod turn; mod param; mod mission;");
        let files = [
            ("lib", if turn == "stray" { "mod service; mod stray;" } else { "mod service;" }),
            ("stray", ""),
            ("service", &*root),
            ("service::turn", turn),
            ("service::param", a),
            ("service::mission", b),
        ];
        faults_of(&files)
    };
    assert_eq!(service("use super::mission::M;", "use super::Turn;", "pub use turn::Turn;", ""), [""; 0]);
    let ring = service("use super::mission::M;", "fn f() { crate::service::param::f() }", "", "");
    assert_eq!(ring.len(), 2, "{ring:?}");
    let down = service("", "", "pub use param::Table;", "");
    assert!(down.len() == 1 && down[0].starts_with("`service` uses `service/param`"), "{down:?}");
    let down = service("", "", "", "use super::mission::M;");
    assert!(down.len() == 1 && down[0].starts_with("`service` uses `service/mission`"), "{down:?}");
    let stray = service("", "", "", "stray");
    assert_eq!(stray, ["`stray` is not in the list of rooms"]);
}
