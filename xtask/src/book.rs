//! `cargo xtask book`: the guides as a book, with search.

use std::process::Command;

use crate::system::{Result, cargo, output, root, run, target_dir};

/// The version of mdBook, and what it is built with. Its other features are a server and a watcher.
const VERSION: &str = "0.5.4";
const FEATURES: [&str; 3] = ["--no-default-features", "--features", "search"];

/// Builds the pages that `docs/SUMMARY.md` lists into `target/book`. Installs mdBook into `target/mdbook` if this version is
/// missing there, which takes two minutes.
pub fn build() -> Result {
    let home = target_dir().join("mdbook");
    let program = home.join("bin").join("mdbook");
    let found = output(&program.to_string_lossy(), &["--version"]);
    if found.as_deref() != Some(&format!("mdbook v{VERSION}")) {
        println!("Installing mdBook {VERSION}: cargo install mdbook --locked");
        let install = ["install", "mdbook", "--locked", "--quiet", "--force", "--version", VERSION];
        run(Command::new(cargo()).args(install).args(FEATURES).arg("--root").arg(&home))?;
    }
    let book = target_dir().join("book");
    run(Command::new(program).arg("build").arg("--dest-dir").arg(&book).arg("docs").current_dir(root()))?;
    println!("The book: {}", book.join("index.html").display());
    Ok(())
}
