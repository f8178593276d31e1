//! `cargo xtask cross`: the library, the snapshot and the drivers for each kind of microcontroller, and the code of the guides for one.

use crate::system::{Result, run};
use crate::toolchain::{self, Choice, TARGETS};

/// Builds the library for each microcontroller, with no feature and with all features, the snapshot and the
/// drivers of FRAM and EEPROM. Two of them have no
/// compare-and-swap.
pub fn build_all(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice, &TARGETS)?;
    for target in TARGETS {
        for features in ["--no-default-features", "--all-features"] {
            println!("mavstack for {target} with {features}");
            run(toolchain::cargo_build(choice, target).args(["--package", "mavstack", "--lib", features]))?;
        }
        for package in ["mavstack-snapshot", "mavstack-fram"] {
            println!("{package} for {target}");
            run(toolchain::cargo_build(choice, target).args(["--package", package, "--lib"]))?;
        }
    }
    // The recipes with registers are for Cortex-M3 and later.
    for target in TARGETS.iter().filter(|target| target.starts_with("thumbv7em")) {
        println!("mavstack-guide for {target}");
        run(toolchain::cargo_build(choice, target).args(["--package", "mavstack-guide", "--lib"]))?;
    }
    Ok(())
}
