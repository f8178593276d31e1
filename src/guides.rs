//! The guides, as pages of this documentation. These modules are empty, and exist here only.
//!
//! | guide | |
//! |---|---|
//! | [`start`] | a vehicle on a board in an hour |
//! | [`transports`] | UART interrupts, DMA, USB, UDP, async tasks: what each HAL needs |
//! | [`vehicle`] | all hooks, by task: modes, plans, parameters, events, logs, a camera |
//! | [`parameters`] | their three places, attributes, and names for ground stations |
//! | [`tasks`] | flight in a task of its own, and the watchdog |
//! | [`storage`](mod@storage) | choosing a region, where the erases run, wear; a recipe for each family of flash |
//! | [`testing`] | tests of your vehicle on your machine: a ground station, faulty lines, power cuts |
//! | [`troubleshooting`] | symptoms and their causes |
//! | [`boards`] | the firmwares for real boards: sizes, load, how they were run |
//! | [`ground_stations`] | connecting to the demo vehicle; quirks of each client |
//! | [`qgroundcontrol`] | what it shows of a GENERIC vehicle and of one that reports PX4; which to choose |
//! | [`rc_over_mavlink`] | ExpressLRS and mLRS: wiring, settings, arbitration of the sticks, loss of the transmitter |
//! | [`features`] | supported features, service by service |
//! | [`sizing`] | flash and RAM, option by option |
//! | [`figures`] | targets and results: speed, work, stack, bad lines, coverage |
//! | [`architecture`] | on one page |
//! | [`safety`] | claims and evidence, duties of your firmware, limits |
//! | [`conformance`] | each rule of behaviour |
//! | [`coming_from`] | rust-mavlink, mavio, the C library: what you wrote there, what you write here |

/// Where a guide's links lead in this documentation. The files define the same labels, at their end, as relative paths. Of two
/// definitions Markdown takes the first, so these come before the file.
macro_rules! labels {
    () => {
        "\
[architecture]: crate::guides::architecture
[boards]: crate::guides::boards
[coming-from]: crate::guides::coming_from
[conformance]: crate::guides::conformance
[esp32]: crate::guides::storage::esp32
[features]: crate::guides::features
[figures]: crate::guides::figures
[fram]: crate::guides::storage::fram
[ground-stations]: crate::guides::ground_stations
[nrf]: crate::guides::storage::nrf
[parameters]: crate::guides::parameters
[qgroundcontrol]: crate::guides::qgroundcontrol
[rc-over-mavlink]: crate::guides::rc_over_mavlink
[rp2040]: crate::guides::storage::rp2040
[safety]: crate::guides::safety
[sizing]: crate::guides::sizing
[start]: crate::guides::start
[stm32f4]: crate::guides::storage::stm32f4
[stm32h7]: crate::guides::storage::stm32h7
[stm32l4]: crate::guides::storage::stm32l4
[storage]: crate::guides::storage
[tasks]: crate::guides::tasks
[testing]: crate::guides::testing
[transports]: crate::guides::transports
[troubleshooting]: crate::guides::troubleshooting
[vehicle]: crate::guides::vehicle
[w25q]: crate::guides::storage::w25q
"
    };
}

#[doc = labels!()]
#[doc = include_str!("../docs/architecture.md")]
pub mod architecture {}

#[doc = labels!()]
#[doc = include_str!("../docs/boards.md")]
pub mod boards {}

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
#[doc = include_str!("../docs/parameters.md")]
pub mod parameters {}

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
#[doc = include_str!("../docs/start.md")]
pub mod start {}

#[doc = labels!()]
#[doc = include_str!("../docs/storage.md")]
pub mod storage {
    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/esp32.md")]
    pub mod esp32 {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/fram.md")]
    pub mod fram {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/nrf.md")]
    pub mod nrf {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/rp2040.md")]
    pub mod rp2040 {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/stm32f4.md")]
    pub mod stm32f4 {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/stm32h7.md")]
    pub mod stm32h7 {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/stm32l4.md")]
    pub mod stm32l4 {}

    #[doc = labels!()]
    #[doc = include_str!("../docs/storage/w25q.md")]
    pub mod w25q {}
}

#[doc = labels!()]
#[doc = include_str!("../docs/tasks.md")]
pub mod tasks {}

#[doc = labels!()]
#[doc = include_str!("../docs/testing.md")]
pub mod testing {}

#[doc = labels!()]
#[doc = include_str!("../docs/transports.md")]
pub mod transports {}

#[doc = labels!()]
#[doc = include_str!("../docs/troubleshooting.md")]
pub mod troubleshooting {}

#[doc = labels!()]
#[doc = include_str!("../docs/vehicle.md")]
pub mod vehicle {}
