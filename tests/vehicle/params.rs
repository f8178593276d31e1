//! Parameters over simulated links, through the whole stack: rules P-3, P-10 to P-32.

use crate::support::*;
use mavstack::config::{TxVersion, VehicleAddress};
use mavstack::dialect::{
    AutopilotVersion, CommandAck, Heartbeat, MavCmd, MavParamError, MavParamType, MavProtocolCapability, ParamError,
    ParamRequestList, ParamRequestRead, ParamSet, ParamValue,
};
use mavstack::param::ParamTable;
use mavstack::{Address, LinkConfig, LinkId, Text};
use std::collections::BTreeMap;

const COUNT: usize = Tuning::INFO.len();
const LIST: ParamRequestList = ParamRequestList { target_system: 1, target_component: 0 };

fn read(index: i16, name: &str) -> ParamRequestRead {
    ParamRequestRead { param_index: index, target_system: 1, target_component: 1, param_id: Text::new(name) }
}

fn set(name: &str, param_type: MavParamType, param_value: f32) -> ParamSet {
    ParamSet { param_value, target_system: 1, target_component: 1, param_id: Text::new(name), param_type }
}

fn radio() -> Setup<1> {
    let line = LineConfig::both(Wire { bytes_per_second: 5_760, latency: millis(5), tx_fifo: 32, ..Wire::default() });
    Setup { lines: [line], links: [LinkConfig::uart(57_600)], ..Setup::new() }
}

/// Returns what a client has received: the value of each index.
fn known<const N: usize>(world: &World<N>, link: usize) -> BTreeMap<u16, ParamValue> {
    world.gcs[link].all::<ParamValue>().into_iter().map(|(_, value)| (value.param_index, value)).collect()
}

/// P-20: the hash covers all persistent parameters, in the order of their names: here nine; the last one is volatile.
#[test]
fn hash_covers_all_persistent_parameters() {
    let mut crc = crc_any::CRCu32::create_crc(0xEDB8_8320, 32, 0, 0, true);
    for (name, value) in [
        ("BAT_LOW", &10.5f32.to_le_bytes()[..]),
        ("CRUISE", &5.0f32.to_le_bytes()),
        ("FENCE_ACT", &1i32.to_le_bytes()),
        ("LAND_SPEED", &0.7f32.to_le_bytes()),
        ("RTL_ALT", &30.0f32.to_le_bytes()),
        ("STAT_STARTS", &0u32.to_le_bytes()),
        ("SYS_ID", &1u8.to_le_bytes()),
        ("TRIM_ROLL", &(-3i8).to_le_bytes()),
    ] {
        crc.digest(name.as_bytes());
        crc.digest(value);
    }
    assert_eq!(COUNT, 9);
    let mut world = World::new(Setup::<1>::new());
    for _ in 0..2 {
        world.gcs[0].send(&read(-1, "_HASH_CHECK"));
        let hash: ParamValue = world.expect(0, millis(100));
        assert_eq!((hash.param_value.to_bits(), hash.param_id.as_str()), (crc.get_crc(), Some("_HASH_CHECK")));
    }
}

/// P-20: a stranger sets a wrong hash while a list is sent. It ended the list, of which 1 of 9 values came; now all come.
#[test]
fn a_wrong_hash_ends_no_list() {
    let mut world = World::new(radio());
    world.gcs[0].send(&LIST);
    while known(&world, 0).is_empty() {
        world.run_for(millis(1));
    }
    let wrong = set("_HASH_CHECK", MavParamType::UINT32, 1.0);
    let stranger = world.gcs[0].frame_from(OTHER_STATION, &wrong);
    world.stack.receive(world.clock.now(), LinkId(0), &stranger, &mut world.vehicle);
    world.run_for(secs(1));
    assert_eq!(known(&world, 0).len(), COUNT);
}

/// P-12: a client requests missing values over a line that loses a third of all frames in each direction.
#[test]
fn every_value_is_received_over_a_lossy_line() {
    for seed in 0..20 {
        let mut setup = Setup { seed, ..radio() };
        setup.lines[0].up.faults = Faults::frames(0.33, 0.05);
        setup.lines[0].down.faults = Faults::frames(0.33, 0.05);
        let mut world = World::new(setup);
        let mut rounds = 0;
        while known(&world, 0).len() < COUNT {
            rounds += 1;
            assert!(rounds < 60, "seed {seed}: {:?}", known(&world, 0).keys());
            let known = known(&world, 0);
            if known.is_empty() {
                world.gcs[0].send(&LIST);
            }
            for index in (0..COUNT as u16).filter(|index| !known.is_empty() && !known.contains_key(index)).take(10) {
                world.gcs[0].send(&read(index as i16, ""));
            }
            world.run_for(secs(1));
        }
        for (index, value) in known(&world, 0) {
            let info = &Tuning::INFO[usize::from(index)];
            assert_eq!(value.param_id.as_str(), Some(info.name()));
            assert_eq!((value.param_value.to_bits(), value.param_type), (info.default_bits(), info.param_type()));
            assert_eq!(usize::from(value.param_count), COUNT);
        }
    }
}

/// D-4: while a list is sent, heartbeats and acknowledgements wait for at most one frame.
#[test]
fn list_does_not_delay_heartbeats() {
    let mut world = World::new(radio());
    for round in 0..100 {
        world.gcs[0].send(&LIST);
        if round % 10 == 5 {
            world.gcs[0].command_long(MavCmd::COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        world.run_for(millis(100));
    }
    let times: Vec<_> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    assert_eq!(times.len(), 10);
    // The bytes in the line's buffer and a PARAM_VALUE of 37 bytes, at 5.76 bytes per ms.
    let late = |pair: &[mavstack::Instant]| (pair[1] - pair[0]).as_millis().abs_diff(1_000);
    assert!(times.windows(2).all(|pair| late(pair) <= 13), "{times:?}");
    assert_eq!(world.gcs[0].count_of::<CommandAck>(), 10);
    // P-11: 40 % of the link's rate.
    let listed = world.gcs[0].count_of::<ParamValue>() * 37;
    assert!((18_000..=24_000).contains(&listed), "{listed} bytes of 57,600");
}

/// P-3: a type that does not fit into PARAM_VALUE is refused, and never sent.
#[test]
fn values_of_64_bits_are_refused() {
    let mut world = World::new(Setup::<1>::new());
    for param_type in
        [MavParamType::UINT64, MavParamType::INT64, MavParamType::REAL64, MavParamType(0), MavParamType(11)]
    {
        for info in Tuning::INFO {
            world.gcs[0].send(&set(info.name(), param_type, 1.0));
            assert_eq!(world.expect::<ParamError>(0, millis(50)).error, MavParamError::TYPE_UNSUPPORTED);
        }
    }
    world.gcs[0].send(&LIST);
    world.run_for(secs(1));
    let types: Vec<_> = known(&world, 0).values().map(|value| value.param_type).collect();
    assert_eq!(types, Tuning::INFO.iter().map(|info| info.param_type()).collect::<Vec<_>>());
    assert!(types.iter().all(|r#type| (1..=6).contains(&r#type.0) || *r#type == MavParamType::REAL32));
    assert_eq!(world.vehicle.calls, [], "nothing was set");
}

/// P-18: a vehicle without parameters says so in AUTOPILOT_VERSION and answers no request; one parameter is enough.
#[test]
fn vehicle_without_parameters_has_no_parameter_protocol() {
    let mut world = pilot::world::<1, { pilot::PX4 }>();
    world.gcs[0].send(&LIST);
    world.gcs[0].send(&read(0, ""));
    world.gcs[0].send(&set("SYS_ID", MavParamType::UINT8, 1.0));
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let capabilities = world.expect::<AutopilotVersion>(0, millis(100)).capabilities;
    assert!(!capabilities.contains(MavProtocolCapability::PARAM_ENCODE_BYTEWISE));
    assert!(!capabilities.contains(MavProtocolCapability::PARAM_ENCODE_C_CAST));
    world.run_for(secs(3));
    assert_eq!((world.gcs[0].count_of::<ParamValue>(), world.gcs[0].count_of::<ParamError>()), (0, 0));
    assert_eq!(world.vehicle.messages, [21, 20, 23], "the vehicle may answer them itself");
}

/// D-3: a backpressured link with pending refusals does not delay answers on another link. After a restart of the link they are
/// gone, except for the frame in transmission.
#[test]
fn backpressured_link_does_not_delay_answers_on_others() {
    let mut world = World::new(Setup::<2>::new());
    world.run_for(secs(1));
    world.uarts[0].stall_writes_until(world.now() + secs(60));
    for _ in 0..10 {
        world.gcs[0].send(&read(-1, "NOTHING"));
        world.run_for(millis(20));
    }
    for _ in 0..10 {
        world.gcs[1].send(&read(-1, "NONE"));
        assert_eq!(world.expect::<ParamError>(1, millis(50)).param_id.as_str(), Some("NONE"));
    }
    world.stack.restart_link(LinkId(0));
    world.uarts[0].stall_writes_until(world.now());
    world.run_for(secs(5));
    assert_eq!(world.gcs[0].count_of::<ParamError>(), 0);
    world.gcs[0].send(&read(-1, "NOTHING"));
    world.expect::<ParamError>(0, millis(50));
}

/// P-14, P-16: a change is sent on all links; only the sender learns why a change was refused.
#[test]
fn change_is_sent_on_both_links() {
    let mut world = World::new(Setup::<2>::new());
    world.gcs[1].send(&set("CRUISE", MavParamType::REAL32, 7.5));
    world.run_for(millis(50));
    for link in 0..2 {
        assert_eq!(known(&world, link)[&1].param_value, 7.5);
    }
    assert_eq!(
        (world.stack.parameters().get(Tuning::CRUISE), &world.vehicle.calls[..]),
        (7.5, &[Call::ParameterChanged(1)][..])
    );
    world.gcs[0].send(&set("CRUISE", MavParamType::REAL32, 70.0));
    let error: ParamError = world.expect(0, millis(50));
    assert_eq!((error.error, error.param_index), (MavParamError::VALUE_OUT_OF_RANGE, -1));
    world.expect_no::<ParamError>(1, millis(50));
    assert!(world.stack.parameters_mut().set(Tuning::YAW_NOW, 90.0));
    world.run_for(millis(50));
    for link in 0..2 {
        assert_eq!((known(&world, link)[&1].param_value, known(&world, link)[&8].param_value), (7.5, 90.0));
    }
}

/// P-16: the change wakes a driver that sleeps until `next_deadline`, also for the other link.
#[test]
fn next_deadline_includes_pending_values() {
    let mut world = World::new(Setup::<2>::new());
    world.run_for(millis(100));
    world.gcs[0].send(&set("CRUISE", MavParamType::REAL32, 8.0));
    let woken = |world: &World<2>| world.stack.next_deadline(world.now()) <= world.now() + millis(1);
    world.run_for(millis(3));
    assert!(world.run_until(millis(20), |world| known(world, 1).contains_key(&1)));
    world.run_for(millis(20));
    assert!(!woken(&world), "nothing is pending any more");
    world.gcs[0].send(&LIST);
    world.run_for(millis(100));
    assert!(!woken(&world));
}

/// P-31: a link that sends MAVLink 1 sends values, and no PARAM_ERROR.
#[test]
fn mavlink_1_gets_values() {
    let links = [LinkConfig::uart(57_600).with_version(TxVersion::V1)];
    let mut world = World::new(Setup { links, ..Setup::<1>::new() });
    world.gcs[0].send(&LIST);
    world.gcs[0].send(&read(-1, "NOTHING"));
    world.run_for(secs(1));
    assert_eq!(known(&world, 0).len(), COUNT);
    assert_eq!(world.gcs[0].count_of::<ParamError>(), 0);
}

/// exactly one of the two encodings is announced.
#[test]
fn exactly_one_encoding_is_announced() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].command_long(MavCmd::REQUEST_MESSAGE, [148.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let version: AutopilotVersion = world.expect(0, millis(50));
    assert!(version.capabilities.contains(MavProtocolCapability::PARAM_ENCODE_BYTEWISE));
    assert!(!version.capabilities.contains(MavProtocolCapability::PARAM_ENCODE_C_CAST));
}

/// A system id that is a parameter: it applies after a restart, to sent and received frames.
#[test]
fn address_can_be_a_stored_parameter() {
    let mut world = World::new(Setup::<2>::new());
    let address = VehicleAddress::new(Address::new(77, 2)).expect("a vehicle can have it");
    world.stack.set_address(address);
    for (link, target_system) in [(0, 1), (1, 77)] {
        world.gcs[link].send(&ParamRequestList { target_system, ..LIST });
    }
    world.run_for(secs(3));
    assert!((3..=4).contains(&world.gcs[0].count_of::<Heartbeat>()));
    for gcs in &world.gcs {
        assert!(gcs.received.iter().all(|frame| frame.header.source == Address::new(77, 2)));
    }
    assert_eq!((known(&world, 0).len(), known(&world, 1).len()), (0, COUNT));
}

/// A broadcast sets no parameter, and requests to other vehicles are not handled.
#[test]
fn requests_for_others_are_counted() {
    let mut world = World::new(Setup::<1>::new());
    world.gcs[0].send(&ParamSet { target_system: 0, ..set("CRUISE", MavParamType::REAL32, 9.0) });
    world.gcs[0].send(&ParamSet { target_system: 2, ..set("CRUISE", MavParamType::REAL32, 9.0) });
    world.gcs[0].send(&ParamRequestList { target_component: 7, ..LIST });
    world.run_for(millis(200));
    assert_eq!(world.gcs[0].count_of::<ParamValue>(), 0);
    let counters = world.stack.link_counters(mavstack::LinkId(0)).expect("exists");
    assert_eq!((counters.out_of_place, counters.not_ours), (1, 2));
}

/// `Debug` shows a parameter by its name and its index.
#[test]
fn debug_output_of_parameters() {
    let at = Tuning::INFO.iter().position(|info| info.name() == "CRUISE").expect("declared");
    assert_eq!(format!("{:?}", Clone::clone(&Tuning::CRUISE)), format!("Param({at})"));
    assert!(format!("{:?}", Tuning::INFO[at]).contains("\"CRUISE\""));
}

#[cfg(feature = "storage")]
mod stored {
    use super::*;
    use crate::support::flash::{Fault, RamFlash};
    use mavstack::Duration;
    use mavstack::dialect::{MavResult, Statustext};
    use mavstack::storage::Store;

    type Flash = RamFlash<8, 512>;
    const REGION: u32 = Store::<Flash>::region_len::<Tested>();

    fn start(store: &mut Store<&mut Flash>) -> World<1> {
        let mut world = World::new(Setup::<1>::new());
        world.stack.restore(world.now(), store, &mut world.vehicle).expect("readable");
        world
    }

    /// Runs the world while storage runs. Returns the number of steps that did something.
    fn run(world: &mut World<1>, store: &mut Store<&mut Flash>, time: Duration) -> usize {
        let end = world.now() + time;
        let mut steps = 0;
        while world.now() < end {
            world.step();
            steps += usize::from(world.stack.persist(world.now(), store, &mut world.vehicle));
        }
        steps
    }

    /// P-17, C-15: what was set is restored after a restart. MAV_CMD_PREFLIGHT_STORAGE 0 is refused while a value is not stored yet: it
    /// was acknowledged. A reset is stored at once.
    #[test]
    fn parameters_survive_a_restart() {
        let mut flash = Flash::new(REGION);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store);
        world.gcs[0].send(&set("TRIM_ROLL", MavParamType::INT8, f32::from_bits(0xF0)));
        run(&mut world, &mut store, secs(2));
        let mut world = start(&mut store);
        assert_eq!(world.stack.parameters().get(Tuning::TRIM_ROLL), -16);
        assert_eq!(world.vehicle.calls, [Call::ParameterChanged(7)]);
        // Nothing may be written.
        world.vehicle.may_persist = false;
        world.gcs[0].send(&set("TRIM_ROLL", MavParamType::INT8, 5.0e-45));
        assert_eq!(run(&mut world, &mut store, secs(30)), 0);
        assert_eq!(start(&mut store).stack.parameters().get(Tuning::TRIM_ROLL), -16);
        world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        run(&mut world, &mut store, millis(100));
        assert_eq!(world.gcs[0].take::<CommandAck>().expect("sent").1.result, MavResult::TEMPORARILY_REJECTED);
        assert_eq!(world.stack.parameters().get(Tuning::TRIM_ROLL), 4);
        world.vehicle.may_persist = true;
        run(&mut world, &mut store, millis(500));
        assert_eq!(start(&mut store).stack.parameters().get(Tuning::TRIM_ROLL), 4);
        world.gcs[0].command_long(MavCmd::PREFLIGHT_STORAGE, [2.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        run(&mut world, &mut store, millis(100));
        assert_eq!(known(&world, 0)[&7].param_value.to_bits(), 0xFD);
        assert_eq!(start(&mut store).stack.parameters().get(Tuning::TRIM_ROLL), -3);
    }

    /// SEC-12: while nothing may be written, as in flight, a sleeping loop is not woken for it. Afterwards it is, and it is
    /// written.
    #[test]
    fn a_write_that_is_not_permitted_wakes_no_loop() {
        let mut flash = Flash::new(REGION);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store);
        world.vehicle.may_persist = false;
        world.gcs[0].send(&set("CRUISE", MavParamType::REAL32, 8.0));
        run(&mut world, &mut store, millis(5_300));
        let mut passes = 0;
        let end = world.now() + secs(10);
        while world.now() < end {
            world.skip_to(end);
            world.stack.persist(world.now(), &mut store, &mut world.vehicle);
            passes += 1;
        }
        assert!(passes < 200, "{passes} passes in 10 s");
        world.vehicle.may_persist = true;
        world.step();
        assert_eq!(world.stack.next_deadline(world.now()), world.now());
        assert!(run(&mut world, &mut store, secs(1)) > 0);
    }

    /// SEC-12: however often a value is set, it is written once in ten seconds, and never if nothing changes.
    #[test]
    fn changes_are_written_every_ten_seconds() {
        let mut flash = Flash::new(REGION);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store);
        run(&mut world, &mut store, secs(1));
        let (before, bytes) = (store.flash().writes, store.flash().bytes_written);
        for round in 0..600u16 {
            world.gcs[0].send(&set("CRUISE", MavParamType::REAL32, 1.0 + f32::from(round) / 100.0));
            run(&mut world, &mut store, millis(100));
        }
        // Nine rows are one page, whose end is written separately.
        assert_eq!((store.flash().writes - before, store.flash().bytes_written - bytes), (6 * 2, 6 * 256));
        run(&mut world, &mut store, secs(20));
        let settled = store.flash().writes;
        assert_eq!(run(&mut world, &mut store, secs(60)), 0);
        assert_eq!(store.flash().writes, settled);
        assert_eq!(start(&mut store).stack.parameters().get(Tuning::CRUISE), 6.99);
    }

    /// P-14, last row: failing flash is reported once, and the value stays as it was acknowledged.
    #[test]
    fn failing_flash_is_reported_once() {
        let mut flash = Flash::new(REGION);
        flash.fault = Fault::Write(0);
        let mut store = Store::new(&mut flash, 0..REGION);
        let mut world = start(&mut store);
        world.gcs[0].send(&set("CRUISE", MavParamType::REAL32, 7.0));
        run(&mut world, &mut store, secs(60));
        let texts = world.gcs[0].all::<Statustext>();
        assert_eq!(
            texts.iter().filter_map(|(_, text)| text.text.as_str()).collect::<Vec<_>>(),
            ["Parameters not saved"]
        );
        assert_eq!(world.stack.parameters().get(Tuning::CRUISE), 7.0);
        store.flash_mut().fault = Fault::None;
        run(&mut world, &mut store, secs(20));
        assert_eq!(start(&mut store).stack.parameters().get(Tuning::CRUISE), 7.0);
    }
}
