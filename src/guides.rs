//! The guides, as pages of this documentation. These modules are empty, and exist here only.
//!
//! | guide | |
//! |---|---|
//! | [`porting`] | from a bare board to a vehicle that ground stations detect: UARTs, clock, pulse, flight in a task of its own, flash |
//! | [`storage`](mod@storage) | choosing a region, where the erases run, wear, recipes for families of flash |
//! | [`testing`] | tests of your vehicle on your machine: a ground station, faulty lines, power cuts |
//! | [`ground_stations`] | connecting to the demo vehicle; quirks of each client |
//! | [`qgroundcontrol`] | what it shows of a GENERIC vehicle and of one that reports PX4; which to choose |
//! | [`rc_over_mavlink`] | ExpressLRS and mLRS: wiring, settings, arbitration of the sticks, loss of the transmitter |
//! | [`features`] | supported features, service by service |
//! | [`sizing`] | flash and RAM, option by option |
//! | [`figures`] | targets and results: speed, work, stack, bad lines, coverage |
//! | [`architecture`] | on one page |
//! | [`safety`] | claims and evidence, duties of your firmware, limits |
//! | [`conformance`] | each rule of behaviour: where it is implemented, which tests prove it |
//! | [`coming_from`] | rust-mavlink, mavio, the C library: what you wrote there, what you write here |

/// Where a guide's links lead in this documentation. The files define the same labels, at their end, as relative paths. Of two
/// definitions Markdown takes the first, so these come before the file.
macro_rules! labels {
    () => {
        "\
[architecture]: crate::guides::architecture
[coming-from]: crate::guides::coming_from
[conformance]: crate::guides::conformance
[features]: crate::guides::features
[figures]: crate::guides::figures
[ground-stations]: crate::guides::ground_stations
[porting]: crate::guides::porting
[qgroundcontrol]: crate::guides::qgroundcontrol
[rc-over-mavlink]: crate::guides::rc_over_mavlink
[safety]: crate::guides::safety
[sizing]: crate::guides::sizing
[storage]: crate::guides::storage
[testing]: crate::guides::testing
"
    };
}

#[doc = labels!()]
#[doc = include_str!("../docs/architecture.md")]
pub mod architecture {}

#[doc = labels!()]
#[doc = include_str!("../docs/coming-from.md")]
pub mod coming_from {}

#[doc = labels!()]
#[doc = include_str!("../docs/conformance.md")]
pub mod conformance {}

#[doc = labels!()]
#[doc = include_str!("../docs/features.md")]
pub mod features {}

#[doc = labels!()]
#[doc = include_str!("../docs/figures.md")]
pub mod figures {}

#[doc = labels!()]
#[doc = include_str!("../docs/ground-stations.md")]
pub mod ground_stations {}

#[doc = labels!()]
#[doc = include_str!("../docs/porting.md")]
pub mod porting {}

#[doc = labels!()]
#[doc = include_str!("../docs/qgroundcontrol.md")]
pub mod qgroundcontrol {}

#[doc = labels!()]
#[doc = include_str!("../docs/rc-over-mavlink.md")]
pub mod rc_over_mavlink {}

#[doc = labels!()]
#[doc = include_str!("../docs/safety.md")]
pub mod safety {}

#[doc = labels!()]
#[doc = include_str!("../docs/sizing.md")]
pub mod sizing {}

#[doc = labels!()]
#[cfg_attr(feature = "storage", doc = include_str!("../docs/storage.md"))]
#[cfg_attr(not(feature = "storage"), doc = "This guide needs the feature `storage`.")]
pub mod storage {}

#[doc = labels!()]
#[doc = include_str!("../docs/testing.md")]
pub mod testing {}
