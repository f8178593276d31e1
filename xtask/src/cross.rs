//! `cargo xtask cross`: the library and the snapshot for each kind of microcontroller.

use crate::system::{Result, run};
use crate::toolchain::{self, Choice, TARGETS};

/// Builds the library for each microcontroller, with no feature and with all features, and the snapshot. Two of them have no
/// compare-and-swap.
pub fn build_all(choice: Option<Choice>) -> Result {
    let choice = toolchain::prepare(choice, &TARGETS)?;
    for target in TARGETS {
        for features in ["--no-default-features", "--all-features"] {
            println!("mavstack for {target} with {features}");
            run(toolchain::cargo_build(choice, target).args(["--package", "mavstack", "--lib", features]))?;
        }
        println!("mavstack-snapshot for {target}");
        run(toolchain::cargo_build(choice, target).args(["--package", "mavstack-snapshot", "--lib"]))?;
    }
    Ok(())
}
