//! The rooms of `src/`: a room is a file or a folder, and uses only rooms above it in [`ROOMS`]. `docs/architecture.md` shows
//! the same list. The tests read the imports and the paths of all code outside of tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use quote::ToTokens;

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
    /// Its tokens, without child modules, comments and tests.
    code: Vec<String>,
    /// The names that it defines or imports, each with its path.
    imports: BTreeMap<String, Vec<String>>,
    /// The paths that it imports with `*`.
    globs: Vec<Vec<String>>,
    /// The paths in its code, `use` included.
    paths: Vec<Vec<String>>,
    /// Whether it is a part of its parent's file.
    is_inline: bool,
}

impl Module {
    /// Returns whether it defines or imports a name.
    fn has(&self, name: &str) -> bool {
        self.imports.contains_key(name) || self.code.iter().any(|token| token == name)
    }

    /// Reads a `use` tree below `prefix`.
    fn read_use(&mut self, tree: &syn::UseTree, prefix: &[String]) {
        let path = |name: &syn::Ident| match name.to_string() {
            // `self` at the end of a path is the path itself.
            name if name == "self" && !prefix.is_empty() => prefix.to_vec(),
            name => [prefix, &[name]].concat(),
        };
        match tree {
            syn::UseTree::Path(part) => self.read_use(&part.tree, &path(&part.ident)),
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.read_use(tree, prefix)),
            syn::UseTree::Glob(_) => {
                self.globs.push(prefix.to_vec());
                self.paths.push(prefix.to_vec());
            }
            syn::UseTree::Name(name) => self.import(path(&name.ident), None),
            syn::UseTree::Rename(name) => self.import(path(&name.ident), Some(name.rename.to_string())),
        }
    }

    fn import(&mut self, path: Vec<String>, name: Option<String>) {
        let name = name.unwrap_or_else(|| path[path.len() - 1].clone());
        self.paths.push(path.clone());
        self.imports.insert(name, path);
    }

    /// Reads an item: its names, its paths, those in macros too, and the `use` of its functions.
    fn read_item(&mut self, item: &syn::Item) {
        struct Uses(Vec<syn::UseTree>);
        impl syn::visit::Visit<'_> for Uses {
            fn visit_item_use(&mut self, item: &syn::ItemUse) {
                self.0.push(item.tree.clone());
            }
        }
        let mut uses = Uses(Vec::new());
        syn::visit::visit_item(&mut uses, item);
        uses.0.iter().for_each(|tree| self.read_use(tree, &[]));
        self.read_tokens(item.to_token_stream());
    }

    /// Reads code: its names, and its paths, those in macros too.
    fn read_tokens(&mut self, tokens: proc_macro2::TokenStream) {
        let from = self.code.len();
        flatten(tokens, &mut self.code);
        let code = &self.code[from..];
        let mut i = 0;
        while i < code.len() {
            if code.get(i + 1).is_some_and(|token| token == "::") {
                let mut path = vec![code[i].clone()];
                while let [colons, name, ..] = &code[i + 1..]
                    && colons == "::"
                    && name.starts_with(char::is_alphabetic)
                {
                    path.push(name.clone());
                    i += 2;
                }
                self.paths.push(path);
            }
            i += 1;
        }
    }
}

/// Appends the names and signs of code; `::` is one of them. Literals are left out.
fn flatten(tokens: proc_macro2::TokenStream, code: &mut Vec<String>) {
    use proc_macro2::{Delimiter, TokenTree};
    let mut tokens = tokens.into_iter().peekable();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Group(group) => {
                let (open, close) = match group.delimiter() {
                    Delimiter::Parenthesis => ("(", ")"),
                    Delimiter::Brace => ("{", "}"),
                    Delimiter::Bracket => ("[", "]"),
                    Delimiter::None => ("", ""),
                };
                code.push(open.to_owned());
                flatten(group.stream(), code);
                code.push(close.to_owned());
            }
            TokenTree::Ident(name) => code.push(name.to_string()),
            TokenTree::Punct(sign) if sign.as_char() == ':' && sign.spacing() == proc_macro2::Spacing::Joint => {
                tokens.next();
                code.push("::".to_owned());
            }
            // A lifetime's name is none of ours.
            TokenTree::Punct(sign) if sign.as_char() == '\'' => drop(tokens.next()),
            TokenTree::Punct(sign) => code.push(sign.to_string()),
            TokenTree::Literal(_) => {}
        }
    }
}

/// All modules of the crate.
#[derive(Default)]
struct Modules {
    modules: BTreeMap<ModulePath, Module>,
    /// The macros, each with the module that defines it.
    macros: BTreeMap<String, ModulePath>,
}

/// Arrows between rooms or files: the user, what it uses, and one module that shows it.
type Arrows = BTreeMap<(String, String), String>;

/// Returns whether an attribute is `cfg(test)` or `cfg(all(test, …))`.
fn is_for_tests(attribute: &syn::Attribute) -> bool {
    let mut tokens = Vec::new();
    flatten(attribute.meta.to_token_stream(), &mut tokens);
    let has = |name: &str| tokens.iter().any(|token| token == name);
    attribute.path().is_ident("cfg") && has("test") && !has("not") && !has("any")
}

/// Returns the attributes of an item.
fn attributes(item: &syn::Item) -> &[syn::Attribute] {
    use syn::Item::{Const, Enum, Fn, Impl, Macro, Mod, Static, Struct, Trait, Type, Use};
    match item {
        Const(item) => &item.attrs,
        Enum(item) => &item.attrs,
        Fn(item) => &item.attrs,
        Impl(item) => &item.attrs,
        Macro(item) => &item.attrs,
        Mod(item) => &item.attrs,
        Static(item) => &item.attrs,
        Struct(item) => &item.attrs,
        Trait(item) => &item.attrs,
        Type(item) => &item.attrs,
        Use(item) => &item.attrs,
        _ => &[],
    }
}

/// Returns the items of a file.
fn items_of(text: &str) -> Vec<syn::Item> {
    syn::parse_file(text).unwrap_or_else(|error| panic!("{error} in:\n{text}")).items
}

impl Modules {
    /// Reads the module at `path` and its children.
    fn read(&mut self, path: &[String], items: Vec<syn::Item>, file: &dyn Fn(&[String]) -> String) {
        let mut module = Module::default();
        for mut item in items {
            if attributes(&item).iter().any(is_for_tests) {
                continue;
            }
            match &mut item {
                syn::Item::Mod(child) => {
                    let name = [path, &[child.ident.to_string()]].concat();
                    let is_inline = child.content.is_some();
                    let items = match child.content.take() {
                        Some((_, items)) => items,
                        None => items_of(&file(&name)),
                    };
                    self.read(&name, items, file);
                    self.modules.entry(name).and_modify(|module| module.is_inline = is_inline);
                }
                syn::Item::Macro(item) => {
                    if let Some(name) = &item.ident {
                        self.macros.insert(name.to_string(), path.to_vec());
                    }
                    module.read_tokens(item.to_token_stream());
                }
                syn::Item::Impl(block) => {
                    block
                        .items
                        .retain(|item| !matches!(item, syn::ImplItem::Fn(item) if item.attrs.iter().any(is_for_tests)));
                    module.read_item(&item);
                }
                item => module.read_item(item),
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

    /// Returns the arrows between modules, by what `name` makes of their paths.
    fn arrows(&self, name: impl Fn(&[String]) -> String) -> Arrows {
        let mut arrows = Arrows::new();
        for (path, module) in self.modules.iter().filter(|(path, _)| self.is_in_a_room(path)) {
            for target in module.paths.iter().filter_map(|target| self.resolve(path, target)) {
                let (from, to) = (name(path), name(&target));
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
    let arrows = &modules.arrows(room);
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
    let mut left: BTreeSet<(&str, &str)> = arrows.keys().map(|(from, to)| (&**from, &**to)).collect();
    left.retain(|(from, to)| row(from) == row(to));
    retain_rings(&mut left);
    faults.extend(left.into_iter().map(|(from, to)| {
        let module = &arrows[&(from.to_owned(), to.to_owned())];
        format!("`{from}` uses `{to}` in a ring: see {module}")
    }));
    faults
}

/// Removes the arrows to what uses nothing, and from what nothing uses, until none is left: rings remain, and the arrows between
/// rings.
fn retain_rings(arrows: &mut BTreeSet<(&str, &str)>) {
    loop {
        let users: BTreeSet<&str> = arrows.iter().map(|(from, _)| *from).collect();
        let used: BTreeSet<&str> = arrows.iter().map(|(_, to)| *to).collect();
        let len = arrows.len();
        arrows.retain(|(from, to)| users.contains(to) && used.contains(from));
        if arrows.len() == len {
            return;
        }
    }
}

/// Returns the rings of files inside rooms, as sentences. A folder's `mod.rs` and its files may use each other: `mod.rs` has the type
/// that all of them are about.
fn rings_of_files(modules: &Modules) -> Vec<String> {
    let file = |path: &[String]| {
        let is_inline = |path: &[String]| modules.modules.get(path).is_some_and(|module| module.is_inline);
        let mut path = path.to_vec();
        while is_inline(&path) {
            path.pop();
        }
        path.join("::")
    };
    let arrows = modules.arrows(file);
    let is_above = |above: &str, below: &str| below.strip_prefix(above).is_some_and(|rest| rest.starts_with("::"));
    let mut left: BTreeSet<(&str, &str)> = arrows.keys().map(|(from, to)| (&**from, &**to)).collect();
    left.retain(|(from, to)| !is_above(from, to) && !is_above(to, from));
    retain_rings(&mut left);
    left.into_iter().map(|(from, to)| format!("the file of `{from}` uses that of `{to}` in a ring")).collect()
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
    modules.read(&[], items_of(&file(&["lib".to_owned()])), file);
    modules
}

/// Each room uses only rooms above it, and no two services use each other.
#[test]
fn rooms_use_only_those_above_them() {
    let modules = crate_of(&source);
    assert!(modules.modules.len() > 80, "{} modules were found", modules.modules.len());
    let arrows = modules.arrows(room).len();
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

/// No file of a room uses another one that uses it, directly or by others.
#[test]
fn files_of_a_room_form_no_ring() {
    let rings = rings_of_files(&crate_of(&source));
    assert!(rings.is_empty(), "{} arrows are in rings:\n{}", rings.len(), rings.join("\n"));
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
        "/// See [`Stack`](crate::Stack).\n// use crate::Stack;\n/* crate::Stack */\nfn f() {}",
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

/// A ring of files in a room is found, also over a third one; `mod.rs` and its files are none.
#[test]
fn ring_of_files_is_found() {
    let rings = |a: &str, b: &str, c: &str| {
        let files = [
            ("lib", "mod link;"),
            ("link", "mod a; mod b; mod c; pub struct Link(a::A);"),
            ("link::a", a),
            ("link::b", b),
            ("link::c", c),
        ];
        let file =
            |path: &[String]| files.iter().find(|(name, _)| *name == path.join("::")).expect("a module").1.to_owned();
        rings_of_files(&crate_of(&file)).len()
    };
    assert_eq!(rings("use super::Link;", "use super::{Link, a::A};", "use super::{a, b};"), 0);
    assert_eq!(rings("use super::b::B;", "use crate::link::a::A;", ""), 2);
    assert_eq!(
        rings("use super::b;", "fn f() { super::c::f() }", "mod inner { fn f() { use super::super::{a::A}; } }"),
        3
    );
}

/// A ring of services is found, and the room `service` must not use any of them.
#[test]
fn ring_of_services_is_found() {
    let service = |a: &str, b: &str, root: &str, turn: &str| {
        let root = format!("{root} mod turn; mod param; mod mission;");
        let files = [
            ("lib", if turn == "// stray" { "mod service; mod stray;" } else { "mod service;" }),
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
    let stray = service("", "", "", "// stray");
    assert_eq!(stray, ["`stray` is not in the list of rooms"]);
}
