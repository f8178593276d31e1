//! A firmware's own records: written when it asks for it, restored before the loop, through power cuts and damage.

use crate::pages::{self, COPY, LAST, PAGE};
use crate::support::flash::{Fault, RamFlash, Torn};
use crate::support::{VEHICLE, millis, secs, without_commands};
use mavstack::dialect::Statustext;
use mavstack::frame::Decoder;
use mavstack::message::Dialect;
use mavstack::storage::{MAX_RECORD_LEN, Records, RestoreError, RestoreErrors, Store, decode_record, encode_record};
use mavstack::{Config, Context, Instant, LinkConfig, LinkId, Pulse, StackOf, Vehicle, VehicleState};

#[derive(mavstack::Stack)]
#[stack(vehicle: Logger, links: 1, storage: { records: 3 })]
struct Mavlink;

type Flash = RamFlash<8, 512>;

const REGION: u32 = Store::<Flash>::region_len::<Mavlink>();

/// A vehicle with three records.
#[derive(Default)]
struct Logger {
    records: [Vec<u8>; 3],
    /// The calls of `load_record`.
    loaded: Vec<u8>,
    must_not_write: bool,
}

impl Vehicle for Logger {
    fn state(&self) -> Option<VehicleState> {
        Some(VehicleState::new(false))
    }

    fn may_persist(&self) -> bool {
        !self.must_not_write
    }
}

without_commands!(Logger);

impl Records for Logger {
    fn load_record(&mut self, _: &mut Context<'_>, number: u8, bytes: &[u8]) {
        self.loaded.push(number);
        self.records[usize::from(number)] = bytes.to_vec();
    }

    fn save_record(&mut self, _: &mut Context<'_>, number: u8, bytes: &mut [u8]) -> usize {
        assert_eq!(bytes.len(), MAX_RECORD_LEN);
        let record = &self.records[usize::from(number)];
        let len = record.len().min(bytes.len());
        bytes[..len].copy_from_slice(&record[..len]);
        record.len()
    }
}

/// A vehicle, its stack and its storage.
struct Rig<'a> {
    stack: Box<StackOf<Mavlink>>,
    vehicle: Logger,
    store: Store<&'a mut Flash>,
    now: Instant,
    restored: Result<(), RestoreErrors>,
}

impl<'a> Rig<'a> {
    fn start(flash: &'a mut Flash) -> Self {
        let config = Config::new(VEHICLE, Box::leak(Box::new(Pulse::new())));
        let mut stack = Box::new(StackOf::<Mavlink>::new(config, [LinkConfig::unlimited()]));
        let mut store = Store::new(flash, 0..REGION);
        let (mut vehicle, now) = (Logger::default(), Instant::from_millis(1_000));
        let restored = stack.restore(now, &mut store, &mut vehicle);
        Self { stack, vehicle, store, now, restored }
    }

    /// Changes a record and has it written.
    fn save(&mut self, number: u8, content: &[u8]) {
        self.vehicle.records[usize::from(number)] = content.to_vec();
        self.stack.save_record(number);
    }

    /// Runs storage for this time.
    fn run(&mut self, time: mavstack::Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now += millis(100);
            self.stack.poll(self.now, &mut self.vehicle);
            for _ in 0..100 {
                if !self.stack.persist(self.now, &mut self.store, &mut self.vehicle) || self.store.flash().is_off() {
                    break;
                }
            }
        }
    }

    /// Returns the texts that are sent now.
    fn texts(&mut self) -> Vec<String> {
        let mut texts = Vec::new();
        loop {
            let raw = self.stack.transmit(self.now, LinkId(0), &mut self.vehicle).to_vec();
            if raw.is_empty() {
                return texts;
            }
            self.stack.transmitted(LinkId(0), raw.len());
            let mut decoder = Decoder::default();
            assert_eq!(decoder.push(&raw, Instant::ZERO), raw.len());
            let messages = mavstack::dialect::Common::MESSAGES;
            let frame = decoder.next(Instant::ZERO, messages, &mut u32::MAX.clone(), |_| false).expect("a frame");
            if let Some(text) = frame.decode::<Statustext>() {
                texts.push(text.text.as_str().expect("a text").to_owned());
            }
        }
    }
}

/// Returns the records of a restarted vehicle.
fn restarted(flash: &Flash) -> [Vec<u8>; 3] {
    let mut flash = flash.clone();
    flash.power_on();
    let mut rig = Rig::start(&mut flash);
    // The write of a page was cut off, and its ECC is wrong: after four attempts it does not count.
    if rig.restored.is_err() {
        rig.run(secs(5));
    }
    assert_eq!(rig.stack.restore_errors(), RestoreErrors::default());
    rig.vehicle.records
}

/// Returns the flash of a vehicle that has saved these records.
fn with(records: [&[u8]; 3]) -> Flash {
    let mut flash = Flash::new(REGION);
    let mut rig = Rig::start(&mut flash);
    for (number, content) in (0..).zip(records) {
        rig.save(number, content);
    }
    rig.run(secs(1));
    flash
}

/// Records are restored as they were saved, whatever their length; one that was never saved is not loaded. There is no fourth one.
#[test]
fn records_are_restored() {
    let long = [7; MAX_RECORD_LEN];
    let mut flash = Flash::new(REGION);
    let mut rig = Rig::start(&mut flash);
    assert_eq!((rig.restored, &rig.vehicle.loaded[..]), (Ok(()), &[][..]));
    rig.save(2, &long);
    rig.save(0, &[]);
    rig.stack.save_record(3);
    rig.stack.save_record(255);
    rig.run(secs(1));
    assert_eq!(pages::pages(&rig.store.flash().bytes).len(), 2);
    let rig = Rig::start(&mut flash);
    assert_eq!((rig.restored, &rig.vehicle.loaded[..]), (Ok(()), &[0, 2][..]));
    assert_eq!(rig.vehicle.records, [vec![], vec![], long.to_vec()]);
}

/// A length beyond the maximum is cut off.
#[test]
fn a_record_that_is_too_long_is_cut_off() {
    let flash = with([&[3; 2 * MAX_RECORD_LEN], &[], &[]]);
    assert_eq!(restarted(&flash)[0], [3; MAX_RECORD_LEN]);
}

/// The stored bytes: the kinds of the records are 128 and the following ones.
#[test]
fn the_layout_is_as_documented() {
    let flash = with([b"zero", b"one", b"two"]);
    let pages: Vec<_> = pages::pages(&flash.bytes).into_iter().map(|(_, page)| page).collect();
    let found: Vec<_> = pages.iter().map(|page| (page.kind, page.schema, page.flags, &page.payload[..])).collect();
    assert_eq!(found, [(128, 0, LAST, &b"zero"[..]), (129, 0, LAST, b"one"), (130, 0, LAST, b"two")]);
}

/// D-5, SEC-12: nothing is written while the vehicle does not permit it. Then the content at that time is written, once.
#[test]
fn records_are_written_when_the_vehicle_permits_it() {
    let mut flash = with([b"old", b"", b""]);
    let mut rig = Rig::start(&mut flash);
    let written = rig.store.flash().bytes_written;
    rig.vehicle.must_not_write = true;
    for content in [b"1st", b"2nd", b"3rd"] {
        rig.save(0, content);
        rig.run(secs(20));
    }
    assert_eq!(rig.store.flash().bytes_written, written);
    rig.vehicle.must_not_write = false;
    rig.run(secs(20));
    let pages = pages::pages(&rig.store.flash().bytes);
    let saved: Vec<_> = pages.iter().filter(|(_, page)| (page.kind, page.flags & COPY) == (128, 0)).collect();
    let saved: Vec<_> = saved.iter().map(|(_, page)| &page.payload[..]).collect();
    assert_eq!(saved, [b"old", b"3rd"]);
    assert_eq!(restarted(&flash)[0], b"3rd");
}

/// SEC-11: the power is cut at every byte and in every erase of a change: the record is the old or the new one, and the others
/// do not change.
#[test]
fn a_change_of_a_record_is_cut() {
    for torn in [Torn::Prefix, Torn::Garbage, Torn::Unreadable] {
        // From every position of a segment.
        for before in 0..5 {
            let mut start = with([b"zero", b"old", b"two"]);
            start.torn = torn;
            let mut rig = Rig::start(&mut start);
            for _ in 0..before {
                rig.save(0, b"zero");
                rig.run(millis(500));
            }
            let change = |flash: &mut Flash| {
                let mut rig = Rig::start(flash);
                rig.save(1, b"new");
                rig.run(secs(1));
            };
            let mut whole = start.clone();
            change(&mut whole);
            let states = [b"old", b"new"].map(|content| [b"zero".to_vec(), content.to_vec(), b"two".to_vec()]);
            assert_eq!((restarted(&start), restarted(&whole)), (states[0].clone(), states[1].clone()));
            for fuel in 1..whole.cost() - start.cost() {
                let mut flash = start.clone();
                flash.fuel = Some(fuel);
                change(&mut flash);
                let found = restarted(&flash);
                assert!(states.contains(&found), "{torn:?}, cut after {fuel}: {found:?}");
            }
        }
    }
}

/// G-18: the newest record is damaged. An older one is restored, a text reports it, and the others are restored, too.
#[test]
fn a_damaged_record_is_reported() {
    let mut whole = with([b"zero", b"old", b"two"]);
    let mut rig = Rig::start(&mut whole);
    rig.save(1, b"new");
    rig.run(secs(1));
    let (at, _) = pages::newest(&whole.bytes, 129);
    let is_only = pages::pages(&whole.bytes).iter().filter(|(_, page)| page.kind == 129).count() == 1;
    for bit in at * 8..(at + PAGE) * 8 {
        let mut flash = whole.clone();
        flash.bytes[bit / 8] ^= 1 << (bit % 8);
        let mut rig = Rig::start(&mut flash);
        assert_eq!(rig.stack.restore_errors().records, Some(RestoreError::Damaged), "bit {bit}");
        let old = if is_only { &b""[..] } else { b"old" };
        assert_eq!(rig.vehicle.records, [b"zero".to_vec(), old.to_vec(), b"two".to_vec()], "bit {bit}");
        assert_eq!(rig.texts(), ["A stored record is damaged"], "bit {bit}");
    }
}

/// G-18: a read fails at the start. The records are restored late, except one that is waiting to be written: it is newer.
#[test]
fn records_are_restored_late() {
    let whole = with([b"zero", b"old", b"two"]);
    let mut late = 0;
    for read in 0..20 {
        let mut flash = whole.clone();
        (flash.reads, flash.fault) = (0, Fault::Reads(read..read + 1));
        let mut rig = Rig::start(&mut flash);
        if let Err(errors) = rig.restored {
            late += 1;
            assert_eq!(errors.records, Some(RestoreError::Unreadable));
            assert_eq!(rig.texts(), ["Stored records cannot be read"], "read {read}");
        }
        rig.save(1, b"new");
        rig.run(secs(3));
        assert_eq!(rig.stack.restore_errors(), RestoreErrors::default(), "read {read}");
        let expected = [b"zero".to_vec(), b"new".to_vec(), b"two".to_vec()];
        assert_eq!(rig.vehicle.records, expected, "read {read}");
        assert_eq!(restarted(&flash), expected, "read {read}");
    }
    assert!(late > 8, "{late}");
}

/// SEC-12: failing storage is tried again every ten seconds.
#[test]
fn a_failed_write_is_repeated() {
    for fault in [Fault::Write(0), Fault::HalfWrite(0), Fault::WrongWrite(0)] {
        let mut flash = with([b"old", b"", b""]);
        (flash.writes, flash.fault) = (0, fault.clone());
        let mut rig = Rig::start(&mut flash);
        rig.save(0, b"new");
        rig.run(secs(60));
        let writes = rig.store.flash().writes;
        assert!((5..=14).contains(&writes), "{fault:?}: {writes} writes in a minute");
        rig.store.flash_mut().fault = Fault::None;
        rig.run(secs(11));
        assert_eq!(restarted(&flash)[0], b"new", "{fault:?}");
    }
}

/// Records may be any values that serde knows; what is no such value is not decoded.
#[test]
fn records_are_encoded_values() {
    #[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
    struct Odometer {
        starts: u32,
        metres: f32,
        name: String,
    }
    let odometer = Odometer { starts: 300, metres: 12.5, name: "Rover".into() };
    let mut bytes = [0; MAX_RECORD_LEN];
    let len = encode_record(&odometer, &mut bytes).expect("it fits");
    assert_eq!(len, 2 + 4 + 1 + 5, "as postcard encodes it");
    assert_eq!(decode_record(&bytes[..len]), Some(odometer));
    assert_eq!(decode_record::<Odometer>(&bytes[..len - 1]), None);
    assert_eq!(decode_record::<Odometer>(&[]), None);
    assert_eq!(encode_record(&[1u8; MAX_RECORD_LEN + 1][..], &mut bytes), None);
}
