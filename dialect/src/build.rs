//! The generator for build scripts: a definition in, a module to `include!` out.

use crate::{Error, Options, builtin, emit, load, names, output};
use std::{
    env, fs,
    path::{Path, PathBuf},
    process,
};

/// Generates a module from a definition, in a build script.
///
/// ```no_run
/// // `main` of build.rs:
/// mavstack_dialect::Build::new("my_vehicle.xml").beside_common().run();
/// ```
///
/// ```ignore
/// // src/main.rs: adds the module `my_vehicle` with the dialect `MyVehicle`
/// include!(concat!(env!("OUT_DIR"), "/my_vehicle.rs"));
/// ```
///
/// Cargo runs the script again when the definition, or one that it includes, has changed.
#[derive(Clone, Debug)]
pub struct Build {
    input: PathBuf,
    include_dirs: Vec<PathBuf>,
    options: Options,
}

impl Build {
    /// Generates all of `input`, a path from the package's root.
    pub fn new(input: impl Into<PathBuf>) -> Self {
        let input = input.into();
        Self { options: Options::for_file(&input), input, include_dirs: Vec::new() }
    }

    /// Leaves out what `mavstack::dialect` has already: see [`Options::beside_common`].
    #[must_use]
    pub fn beside_common(mut self) -> Self {
        self.options.beside_common = true;
        self
    }

    /// Generates only the messages, enumerations and typed commands with these names, which are MAVLink's. Further
    /// calls add names.
    #[must_use]
    pub fn only<N: Into<String>>(mut self, names: impl IntoIterator<Item = N>) -> Self {
        self.options.only.get_or_insert_default().extend(names.into_iter().map(N::into));
        self
    }

    /// Adds a directory to be searched for included files.
    #[must_use]
    pub fn include_dir(mut self, dir: impl Into<PathBuf>) -> Self {
        self.include_dirs.push(dir.into());
        self
    }

    /// Sets the name of the struct that lists the messages. The module has the name of the file.
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.options.name = name.into();
        self
    }

    /// Sets the path of the crate `mavstack`, if it has another name.
    #[must_use]
    pub fn crate_path(mut self, path: impl Into<String>) -> Self {
        self.options.crate_path = path.into();
        self
    }

    /// Writes the module into `OUT_DIR`. An error in the definition is reported as a build error with file and line,
    /// and ends the script.
    pub fn run(self) {
        println!("cargo::rerun-if-changed={}", self.input.display());
        let Some(out_dir) = env::var_os("OUT_DIR") else {
            eprintln!("OUT_DIR is not set: call mavstack_dialect::Build::run only in a build script");
            process::exit(1);
        };
        match self.write_to(out_dir.as_ref()) {
            Ok(inputs) => inputs.iter().for_each(|input| println!("cargo::rerun-if-changed={}", input.display())),
            Err(error) => {
                println!("cargo::error={error}");
                process::exit(1);
            }
        }
    }

    /// Writes the module into a directory, and returns the files from which it was generated.
    ///
    /// # Errors
    ///
    /// The definition or the options are invalid, or the file cannot be written.
    pub fn write_to(&self, directory: &Path) -> Result<Vec<PathBuf>, Error> {
        let dialect = load(&self.input, &self.include_dirs)?;
        let module = names::module(&self.input);
        let text = emit::generate(&dialect, &self.options)?;
        let dead = "#[allow(dead_code, reason = \"a firmware uses only some of the items\")]";
        let text = format!("{dead}\npub mod {module} {{\n{text}}}\n");
        let stem = self.input.file_stem().unwrap_or_default().to_string_lossy();
        fs::create_dir_all(directory)
            .map_err(|error| Error::whole(directory, "the output", format!("cannot be created: {error}")))?;
        output::write(&directory.join(format!("{stem}.rs")), &text)?;
        let files = dialect.files.iter().filter(|file| builtin::text(file).is_none());
        Ok(files.map(|file| file.to_path_buf()).collect())
    }
}
