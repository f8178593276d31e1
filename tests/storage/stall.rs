//! How long the vehicle is silent while flash erases for two seconds (D-5): with jobs, which run beside the loop, and with
//! `persist`, which blocks it. `cargo test --features storage --test storage stall:: -- --nocapture` prints the figures.

use crate::support::flash::{FlashError, RamFlash};
use crate::support::*;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavstack::dialect::{Heartbeat, MavMissionResult, MavParamType, ParamSet};
use mavstack::plan::Durability;
use mavstack::storage::{Job, JobSlot, Region, Store};
use mavstack::{Config, Duration, Instant, Text};

#[derive(mavstack::Stack)]
#[stack(
    vehicle: TestVehicle,
    links: 1,
    plans: { mission: 250, fence: 4, rally: 2 },
    parameters: Tuning,
    commands: { slots: 1 },
    storage,
)]
struct Mavlink;

type StallWorld = World<1, Mavlink>;

const ERASE: Duration = secs(2);
const WRITE: Duration = millis(1);
const READ: Duration = Duration::from_micros(100);
/// The period in which the loop polls the stack.
const POLL: Duration = millis(1);
/// The period of heartbeats.
const BEAT: Duration = secs(1);
const RUN: Duration = secs(60);

fn time_of(job: &Job) -> Duration {
    match job {
        Job::Read { .. } => READ,
        Job::Write { .. } => WRITE,
        Job::Erase { .. } => ERASE,
    }
}

/// A flash in a task of its own: an operation ends after its time, and the loop runs on.
struct Task<const ERASE_SIZE: usize> {
    flash: RamFlash<8, ERASE_SIZE>,
    slot: JobSlot,
    running: Option<(Instant, Job)>,
}

impl<const ERASE_SIZE: usize> Task<ERASE_SIZE> {
    fn is_erasing(&self) -> bool {
        matches!(self.running, Some((_, Job::Erase { .. })))
    }

    fn poll(&mut self, world: &mut StallWorld) {
        let now = world.now();
        if let Some((end, job)) = &self.running {
            if now < *end {
                return;
            }
            let page = self.slot.page_mut();
            let result = match job.clone() {
                Job::Read { offset, range } => self.flash.read(offset, &mut page.bytes_mut()[range]),
                Job::Write { offset, range } => self.flash.write(offset, &page.bytes()[range]),
                Job::Erase { offset, len } => self.flash.erase(offset, offset + len),
            };
            self.slot.finish(result.is_ok());
            self.running = None;
        }
        while world.stack.exchange_job(now, &mut self.slot, &mut world.vehicle) {
            self.running = self.slot.take().map(|(job, _)| (now + time_of(&job), job));
            if self.running.is_some() {
                break;
            }
        }
    }
}

/// A flash whose driver blocks: time passes while it works, and nothing else runs.
struct Blocking<const ERASE_SIZE: usize> {
    flash: RamFlash<8, ERASE_SIZE>,
    clock: Clock,
}

impl<const ERASE_SIZE: usize> Blocking<ERASE_SIZE> {
    fn wait(&self, time: Duration) {
        self.clock.set(self.clock.now() + time);
    }
}

impl<const ERASE_SIZE: usize> ErrorType for Blocking<ERASE_SIZE> {
    type Error = FlashError;
}

impl<const ERASE_SIZE: usize> ReadNorFlash for Blocking<ERASE_SIZE> {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.wait(READ);
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<const ERASE_SIZE: usize> NorFlash for Blocking<ERASE_SIZE> {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.wait(ERASE);
        self.flash.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.wait(WRITE);
        self.flash.write(offset, bytes)
    }
}

/// What a ground station sees in [`RUN`].
#[derive(Debug, Default)]
struct Figures {
    /// The longest delay of a heartbeat.
    late: Duration,
    /// Uploads of 250 items: accepted, failed, and the longest time of one.
    accepted: u32,
    failed: u32,
    longest: Duration,
    /// Erases, and the uploads that ended while one ran.
    erases: u32,
    meanwhile: u32,
}

impl Figures {
    fn print(&self, name: &str) {
        println!(
            "| {name} | {} | {} ms | {} of {} | {} ms | {} |",
            self.erases,
            self.late.as_millis(),
            self.accepted,
            self.accepted + self.failed,
            self.longest.as_millis(),
            self.meanwhile,
        );
    }
}

/// A ground station sets a parameter every five seconds. It uploads 250 items at least every six, and sooner while an erase
/// runs. `storage` is called in each pass, and says whether an erase is running.
fn run(durability: Durability, mut storage: impl FnMut(&mut StallWorld) -> bool) -> Figures {
    let setup = Setup::new();
    let mut world = StallWorld::of(Setup {
        config: Config { durability, storage_refill: Duration::ZERO, ..setup.config },
        step: POLL,
        ..setup
    });
    let mut figures = Figures::default();
    let mut upload: Option<(Instant, Upload)> = None;
    let (mut variant, mut set_at, mut upload_at) = (0, Instant::ZERO, Instant::from_millis(2_000));
    let end = world.now() + RUN;
    // The first pass attaches the storage.
    storage(&mut world);
    while world.now() < end {
        world.step();
        let was_erasing = storage(&mut world);
        let now = world.now();
        if now >= set_at {
            set_at = now + secs(5);
            variant += 1;
            let (param_id, param_type) = (Text::new("CRUISE"), MavParamType::REAL32);
            let param_value = 5.0 + f32::from(variant % 100) / 10.0;
            world.gcs[0].send(&ParamSet { param_value, target_system: 1, target_component: 1, param_id, param_type });
        }
        // An upload begins while an erase runs, if one does within five seconds.
        if upload.is_none() && now >= upload_at + (if was_erasing { Duration::ZERO } else { secs(5) }) {
            upload_at = now + secs(1);
            variant += 1;
            upload = Some((now, Upload::new(&world.gcs[0], &plan(250, variant)).like_qgroundcontrol()));
        }
        let Some((began, client)) = &mut upload else { continue };
        if let Some(result) = client.poll(now, &mut world.gcs[0]) {
            let is_accepted = result.is_ok_and(|ack| ack.r#type == MavMissionResult::ACCEPTED);
            figures.accepted += u32::from(is_accepted);
            figures.failed += u32::from(!is_accepted);
            figures.meanwhile += u32::from(is_accepted && was_erasing);
            figures.longest = figures.longest.max(now - *began);
            upload = None;
        }
    }
    let beats: Vec<Instant> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    let silence = beats.windows(2).map(|pair| pair[1] - pair[0]).max().expect("it sends heartbeats");
    figures.late = Duration::from_micros(silence.as_micros().saturating_sub(BEAT.as_micros()));
    figures
}

fn with_jobs<const ERASE_SIZE: usize>(durability: Durability, len: u32) -> Figures {
    let flash = RamFlash::<8, ERASE_SIZE>::new(len);
    let mut task = Task { flash, slot: JobSlot::new(), running: None };
    let mut is_attached = false;
    let figures = run(durability, |world| {
        if !std::mem::replace(&mut is_attached, true) {
            let region = Region::new(0..len, 8, ERASE_SIZE as u32);
            world.stack.attach_storage(world.clock.now(), region, &mut world.vehicle);
        }
        let was_erasing = task.is_erasing();
        task.poll(world);
        was_erasing
    });
    Figures { erases: task.flash.erases, ..figures }
}

fn with_persist<const ERASE_SIZE: usize>(durability: Durability, len: u32) -> Figures {
    let mut store: Option<Store<Blocking<ERASE_SIZE>>> = None;
    let figures = run(durability, |world| {
        if let Some(store) = &mut store {
            world.stack.persist(world.clock.now(), store, &mut world.vehicle);
        } else {
            let (flash, clock) = (RamFlash::new(len), world.clock.clone());
            let store = store.insert(Store::new(Blocking { flash, clock }, 0..len));
            world.stack.restore(world.clock.now(), store, &mut world.vehicle).unwrap();
        }
        false
    });
    Figures { erases: store.unwrap().flash().flash.erases, ..figures }
}

/// D-5, M-44: an erase of two seconds delays no heartbeat by more than one poll, and uploads are accepted meanwhile. The
/// blocking end is printed beside it.
#[test]
fn no_heartbeat_waits_for_an_erase() {
    println!("| | erases | heartbeat late by | uploads accepted | longest upload | accepted during an erase |");
    println!("|---|---|---|---|---|---|");
    for (name, durability) in [("answered at once", Durability::Deferred), ("stored first", Durability::Durable)] {
        let jobs = with_jobs::<16_384>(durability, 0x1_0000);
        let blocking = with_persist::<16_384>(durability, 0x1_0000);
        jobs.print(&format!("jobs, 16 KiB × 4, {name}"));
        blocking.print(&format!("`persist`, 16 KiB × 4, {name}"));
        assert!(jobs.late <= POLL, "{jobs:?}");
        assert!(jobs.erases > 2 && jobs.accepted > 0, "{jobs:?}");
        if durability == Durability::Deferred {
            assert!(jobs.meanwhile >= 5 && jobs.failed == 0, "{jobs:?}");
        }
        // The comparison says something only if the blocking end does stall.
        assert!(blocking.late >= secs(1), "{blocking:?}");
    }
}

/// The same with the two last sectors of an STM32F405, in which a segment holds many plans: uploads are stored before
/// they are accepted.
#[test]
fn uploads_are_accepted_in_large_sectors() {
    let jobs = with_jobs::<131_072>(Durability::Durable, 0x4_0000);
    jobs.print("jobs, 128 KiB × 2, stored first");
    with_persist::<131_072>(Durability::Durable, 0x4_0000).print("`persist`, 128 KiB × 2, stored first");
    assert!(jobs.late <= POLL, "{jobs:?}");
    // A client that waits for 1.5 s gives up the first one: the sector is erased before its first use.
    assert!(jobs.accepted >= 8 && jobs.failed <= 1, "{jobs:?}");
}

/// A blocking store in a task of its own, which is stopped with a job and starts again: the job counts as failed, and the
/// plan is stored by the next upload.
#[test]
fn a_task_may_be_restarted() {
    const LEN: u32 = 0x1_0000;
    let items = |variant| plan(20, variant);
    let upload = |world: &mut StallWorld, store: &mut Store<RamFlash<8, 4096>>, variant, stop_at: Option<u32>| {
        let mut client = Upload::new(&world.gcs[0], &items(variant)).with_patience(40);
        let mut jobs = 0;
        while client.result().is_none() {
            world.step();
            let now = world.now();
            client.poll(now, &mut world.gcs[0]);
            if world.stack.exchange_job(now, store.slot(), &mut world.vehicle) {
                jobs += 1;
                if stop_at != Some(jobs) {
                    store.run();
                    store.run(); // it does nothing
                }
            }
        }
        client.result().unwrap().is_ok()
    };
    for stop_at in 1..16 {
        let mut world = StallWorld::of(Setup::new());
        let mut store = Store::new(RamFlash::<8, 4096>::new(LEN), 0..LEN);
        store.run(); // there is no job yet
        world.stack.restore(world.clock.now(), &mut store, &mut world.vehicle).unwrap();
        let variant = if upload(&mut world, &mut store, 1, Some(stop_at)) { 1 } else { 2 };
        assert!(variant == 1 || upload(&mut world, &mut store, 2, None), "stopped at job {stop_at}");
        let mut again = StallWorld::of(Setup::new());
        again.stack.attach_storage(again.clock.now(), store.region(), &mut again.vehicle);
        while again.stack.is_restoring() && again.stack.exchange_job(Instant::ZERO, store.slot(), &mut again.vehicle) {
            store.run();
        }
        assert_eq!(again.stack.restore_errors(), Default::default());
        assert_eq!(again.stack.mission().items(), world.stack.mission().items());
        assert_eq!(again.stack.mission().items().len(), 20);
    }
}

/// A slot gives a job away once, and takes a result only for a job that it gave. Its page, which may have the key, is not
/// shown (SEC-15).
#[test]
fn a_slot_gives_a_job_away_once() {
    let mut world = StallWorld::of(Setup::new());
    let mut slot = JobSlot::default();
    assert!(slot.take().is_none());
    slot.finish(true);
    world.stack.attach_storage(Instant::ZERO, Region::new(0..0x4000, 8, 4096), &mut world.vehicle);
    assert!(world.stack.exchange_job(Instant::ZERO, &mut slot, &mut world.vehicle));
    let (job, page) = slot.take().unwrap();
    page.bytes_mut().fill(0xFF);
    let Job::Read { offset, .. } = job else { panic!("{job:?}") };
    assert!(slot.take().is_none());
    slot.finish(true);
    slot.finish(false);
    assert!(slot.take().is_none());
    // One call takes the result, and the next one gives another job.
    assert!(world.stack.exchange_job(Instant::ZERO, &mut slot, &mut world.vehicle));
    assert!(slot.take().is_none());
    assert!(world.stack.exchange_job(Instant::ZERO, &mut slot, &mut world.vehicle));
    assert!(matches!(slot.take(), Some((Job::Read { offset: next, .. }, _)) if next != offset));
    assert_eq!(format!("{slot:?}"), "JobSlot");
}

/// A parameter is written while a loop sleeps until the deadline. While an erase runs in another task, the loop is not woken for
/// the write, and the write is done within two seconds of the end of the erase.
#[test]
fn an_erase_does_not_keep_a_sleeping_loop_awake() {
    const LEN: u32 = 0x1_0000;
    let mut task = Task { flash: RamFlash::<8, 16_384>::new(LEN), slot: JobSlot::new(), running: None };
    let mut world = StallWorld::of(Setup::new());
    world.stack.attach_storage(world.now(), Region::new(0..LEN, 8, 16_384), &mut world.vehicle);
    while world.stack.is_restoring() {
        world.step();
        task.poll(&mut world);
    }
    let (param_id, param_type) = (Text::new("CRUISE"), MavParamType::REAL32);
    world.gcs[0].send(&ParamSet { param_value: 8.0, target_system: 1, target_component: 1, param_id, param_type });
    let mut passes = 0;
    let began = world.now();
    while task.flash.bytes_written < 256 {
        let next = world.now() + millis(200);
        // The task wakes by itself.
        world.skip_to(task.running.as_ref().map_or(next, |(end, _)| next.min(*end)));
        passes += u32::from(task.is_erasing());
        task.poll(&mut world);
        assert!(world.now() - began < secs(5), "it is not written");
    }
    assert!(passes > 5 && passes < 100, "{passes} passes during an erase of two seconds");
}
