//! Storage in a task of its own, on an async driver: nothing waits for an erase, and any future may be dropped (D-5).

use crate::support::flash::RamFlash;
use crate::support::*;
use embedded_storage::nor_flash::{NorFlash as _, ReadNorFlash as _};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use mavstack::dialect::{Heartbeat, MavCmd, MavMissionResult, MavParamType, MissionItemInt, ParamSet};
use mavstack::plan::Durability;
use mavstack::storage::AsyncStore;
use mavstack::{Config, Duration, Instant, Item, LinkId, PlanType, Text};
use std::cell::RefCell;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

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

type Inner = RamFlash<8, 16_384>;
type AsyncWorld = World<1, Mavlink>;

const LEN: u32 = 2 * AsyncStore::<SlowFlash>::region_len::<Mavlink>();
const ERASE: Duration = secs(2);
const WRITE: Duration = millis(1);
const READ: Duration = Duration::from_micros(100);

/// Flash whose operations take time. Each is pending until then, and has its effect at its end; one that is dropped has
/// none, or half of it if it is a write.
struct SlowFlash {
    inner: Inner,
    clock: Clock,
    /// Shared with the test: the flash erases now, and how often an operation was pending.
    seen: Rc<RefCell<Seen>>,
}

#[derive(Default)]
struct Seen {
    erasing: bool,
    erases: u32,
    pending: u32,
    operations: u32,
}

impl SlowFlash {
    fn new(inner: Inner, clock: &Clock) -> (Self, Rc<RefCell<Seen>>) {
        let seen = Rc::new(RefCell::new(Seen::default()));
        (Self { inner, clock: clock.clone(), seen: Rc::clone(&seen) }, seen)
    }

    async fn wait(&self, time: Duration) {
        self.seen.borrow_mut().operations += 1;
        let end = self.clock.now() + time;
        core::future::poll_fn(|_| {
            if self.clock.now() >= end {
                return Poll::Ready(());
            }
            self.seen.borrow_mut().pending += 1;
            Poll::Pending
        })
        .await;
    }
}

impl ErrorType for SlowFlash {
    type Error = <Inner as embedded_storage::nor_flash::ErrorType>::Error;
}

impl ReadNorFlash for SlowFlash {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.wait(READ).await;
        self.inner.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.inner.capacity()
    }
}

impl NorFlash for SlowFlash {
    const WRITE_SIZE: usize = 8;
    const ERASE_SIZE: usize = 16_384;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.seen.borrow_mut().erasing = true;
        self.wait(ERASE).await;
        self.seen.borrow_mut().erasing = false;
        self.seen.borrow_mut().erases += 1;
        self.inner.erase(from, to)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let half = bytes.len() / 16 * 8;
        let (front, rest) = bytes.split_at(half);
        self.inner.write(offset, front)?;
        self.wait(WRITE).await;
        self.inner.write(offset + half as u32, rest)
    }
}

/// The task of the storage, as `AsyncStore` documents it. `borrow_mut` panics if the stack is held across an await.
async fn storage_task(store: &mut AsyncStore<SlowFlash>, world: &RefCell<AsyncWorld>) {
    loop {
        let has_job = {
            let world = &mut *world.borrow_mut();
            world.stack.exchange_job(world.clock.now(), store.slot(), &mut world.vehicle)
        };
        if has_job { store.run().await } else { yield_now().await }
    }
}

/// Is pending once.
async fn yield_now() {
    let mut is_first = true;
    core::future::poll_fn(|_| if std::mem::take(&mut is_first) { Poll::Pending } else { Poll::Ready(()) }).await;
}

fn poll<F: Future>(future: Pin<&mut F>) -> Poll<F::Output> {
    future.poll(&mut Context::from_waker(Waker::noop()))
}

/// Runs a future while time passes and nothing else happens.
fn block_on<F: Future>(clock: &Clock, future: F) -> F::Output {
    let mut future = pin!(future);
    loop {
        if let Poll::Ready(output) = poll(future.as_mut()) {
            return output;
        }
        clock.set(clock.now() + millis(1));
    }
}

fn start(world: &RefCell<AsyncWorld>, flash: Inner) -> (AsyncStore<SlowFlash>, Rc<RefCell<Seen>>) {
    let world = &mut *world.borrow_mut();
    let clock = world.clock.clone();
    let (flash, seen) = SlowFlash::new(flash, &clock);
    let mut store = AsyncStore::new(flash, 0..LEN);
    let restored = block_on(&clock, world.stack.restore_async(clock.now(), &mut store, &mut world.vehicle));
    assert_eq!(restored, Ok(()));
    (store, seen)
}

fn world_with(durability: Durability) -> RefCell<AsyncWorld> {
    let setup = Setup::new();
    RefCell::new(AsyncWorld::of(Setup { config: Config { durability, ..setup.config }, ..setup }))
}

fn new_world() -> RefCell<AsyncWorld> {
    world_with(Durability::Durable)
}

/// An upload by a client that waits for the answer for 20 s: the first plan in new flash needs an erase.
fn patient_upload(world: &RefCell<AsyncWorld>, items: &[MissionItemInt]) -> Upload {
    Upload::new(&world.borrow().gcs[0], items).with_patience(40)
}

/// One pass of the loop, of the storage task and of the client.
fn pass<T: Future>(world: &RefCell<AsyncWorld>, task: Pin<&mut T>, upload: &mut Upload) {
    world.borrow_mut().step();
    assert!(poll(task).is_pending());
    let world = &mut *world.borrow_mut();
    let now = world.now();
    upload.poll(now, &mut world.gcs[0]);
}

fn set_cruise(world: &mut AsyncWorld, param_value: f32) {
    let (param_id, param_type) = (Text::new("CRUISE"), MavParamType::REAL32);
    world.gcs[0].send(&ParamSet { param_value, target_system: 1, target_component: 1, param_id, param_type });
}

/// Returns the longest time between two heartbeats that a ground station received.
fn longest_silence(world: &AsyncWorld) -> Duration {
    let beats: Vec<Instant> = world.gcs[0].all::<Heartbeat>().into_iter().map(|(at, _)| at).collect();
    beats.windows(2).map(|pair| pair[1] - pair[0]).max().expect("it sends heartbeats")
}

/// D-5: heartbeats are in time, and a whole upload of 250 items is accepted, while a unit is erased for two seconds.
#[test]
fn nothing_waits_for_an_erase() {
    let world = world_with(Durability::Deferred);
    let (mut store, seen) = start(&world, Inner::new(LEN));
    let mut task = pin!(storage_task(&mut store, &world));
    set_cruise(&mut world.borrow_mut(), 7.0);
    while !seen.borrow().erasing {
        world.borrow_mut().step();
        assert!(poll(task.as_mut()).is_pending());
    }
    let mut upload = Upload::new(&world.borrow().gcs[0], &plan(250, 1)).like_qgroundcontrol();
    while upload.result().is_none() {
        pass(&world, task.as_mut(), &mut upload);
        assert!(seen.borrow().erasing && seen.borrow().erases == 0, "the upload ends before the erase");
    }
    assert_eq!(upload.result().unwrap().map(|ack| ack.r#type), Ok(MavMissionResult::ACCEPTED));
    for _ in 0..20_000 {
        pass(&world, task.as_mut(), &mut upload);
    }
    let longest = longest_silence(&world.borrow());
    assert!(longest <= millis(1_001), "{longest:?} between heartbeats");
    assert!(seen.borrow().erases >= 1 && seen.borrow().pending > 1_500);
}

/// D-5: a write that is due wakes the loop that runs storage, and no task that serves a link.
#[test]
fn a_write_that_is_due_wakes_no_link() {
    let world = new_world();
    let _store = start(&world, Inner::new(LEN));
    let world = &mut *world.borrow_mut();
    set_cruise(world, 7.0);
    // Nothing runs the storage.
    world.run_for(secs(3));
    let now = world.now();
    assert_eq!(world.stack.next_deadline(now), now);
    assert!(world.stack.link_deadline(now, LinkId(0)) > now);
}

/// M-44: a durable upload is answered once the plan is stored, which takes an erase in new flash. Heartbeats are in
/// time meanwhile, and all of it is restored by the next start.
#[test]
fn what_is_accepted_is_restored() {
    let world = new_world();
    let (mut store, seen) = start(&world, Inner::new(LEN));
    {
        let mut task = pin!(storage_task(&mut store, &world));
        set_cruise(&mut world.borrow_mut(), 7.0);
        let mut upload = patient_upload(&world, &plan(250, 1));
        while upload.result().is_none() {
            pass(&world, task.as_mut(), &mut upload);
        }
        assert_eq!(upload.result().unwrap().map(|ack| ack.r#type), Ok(MavMissionResult::ACCEPTED));
        assert!(seen.borrow().erases >= 1);
        for _ in 0..20_000 {
            pass(&world, task.as_mut(), &mut upload);
        }
    }
    assert!(longest_silence(&world.borrow()) <= millis(1_001));
    let again = new_world();
    start(&again, store.into_inner().inner);
    assert_eq!(again.borrow().stack.mission().items(), world.borrow().stack.mission().items());
    assert_eq!(again.borrow().stack.mission().items().len(), 250);
    assert_eq!(again.borrow().stack.parameters().get(Tuning::CRUISE), 7.0);
}

/// M-44: a task that is aborted in any operation, and continues with the same store: what is accepted is stored. No byte is
/// written twice, which the flash checks.
#[test]
fn a_dropped_future_counts_as_a_failure() {
    let (mut refused, mut cut) = (0, 0);
    loop {
        cut += 1;
        let world = new_world();
        let (mut store, seen) = start(&world, Inner::new(LEN));
        let restored = seen.borrow().operations;
        let items = plan(20, cut);
        let mut upload = patient_upload(&world, &items);
        {
            // The future is dropped in the middle of this operation.
            let mut task = pin!(storage_task(&mut store, &world));
            while upload.result().is_none() && seen.borrow().operations < restored + u32::from(cut) {
                pass(&world, task.as_mut(), &mut upload);
            }
        }
        let is_cut = upload.result().is_none();
        let mut task = Box::pin(storage_task(&mut store, &world));
        while upload.result().is_none() {
            pass(&world, task.as_mut(), &mut upload);
        }
        if let Err(error) = upload.result().unwrap() {
            assert_eq!(error, TransferError::Refused(MavMissionResult::ERROR), "cut in operation {cut}");
            refused += 1;
            upload = patient_upload(&world, &items);
            while upload.result().is_none() {
                pass(&world, task.as_mut(), &mut upload);
            }
        }
        assert!(upload.result().unwrap().is_ok());
        drop(task);
        let again = new_world();
        start(&again, store.into_inner().inner);
        assert_eq!(again.borrow().stack.mission().items().len(), 20, "cut in operation {cut}");
        if !is_cut {
            break;
        }
    }
    // A write that fails is repeated behind its unit, so the plan is accepted all the same. Some operation still ends the save.
    assert!(refused >= 1 && cut >= refused + 3, "{refused} of {cut}");
}

/// A restore that is dropped in any operation is repeated, and reads everything.
#[test]
fn a_dropped_restore_loses_nothing() {
    let world = new_world();
    let (mut store, _) = start(&world, Inner::new(LEN));
    {
        let mut task = pin!(storage_task(&mut store, &world));
        let mut upload = patient_upload(&world, &plan(20, 1));
        while upload.result().is_none() {
            pass(&world, task.as_mut(), &mut upload);
        }
    }
    let bytes = store.into_inner().inner.bytes;
    let reads = {
        let again = new_world();
        let (_, seen) = start(&again, Inner::of(bytes.clone()));
        seen.borrow().operations
    };
    for cut in (1..reads).step_by(7) {
        let again = new_world();
        let world = &mut *again.borrow_mut();
        let clock = world.clock.clone();
        let (flash, seen) = SlowFlash::new(Inner::of(bytes.clone()), &clock);
        let mut store = AsyncStore::new(flash, 0..LEN);
        {
            let mut restore = pin!(world.stack.restore_async(clock.now(), &mut store, &mut world.vehicle));
            while seen.borrow().operations < cut {
                assert!(poll(restore.as_mut()).is_pending());
                clock.set(clock.now() + READ);
            }
        }
        // The loop continues as if nothing had happened: a read that failed is repeated.
        for _ in 0..20_000 {
            let now = clock.now() + millis(1);
            clock.set(now);
            if world.stack.exchange_job(now, store.slot(), &mut world.vehicle) {
                block_on(&clock, store.run());
            } else if !world.stack.mission().items().is_empty() {
                break;
            }
        }
        assert_eq!(world.stack.mission().items().len(), 20, "cut in read {cut} of {reads}");
    }
}

/// A job runs once, however often `run` is called: a second write of the same place would damage flash with ECC.
#[test]
fn a_job_runs_once() {
    let world = new_world();
    let (mut store, seen) = start(&world, Inner::new(LEN));
    let world = &mut *world.borrow_mut();
    let clock = world.clock.clone();
    let item = |x| Item { command: MavCmd::NAV_WAYPOINT, autocontinue: 1, x, y: 1, ..Item::default() };
    world.stack.load_plan(clock.now(), PlanType::Mission, (0..9).map(item), &mut world.vehicle).unwrap();
    assert!(world.stack.exchange_job(clock.now(), store.slot(), &mut world.vehicle));
    let before = seen.borrow().operations;
    block_on(&clock, store.run());
    block_on(&clock, store.run());
    assert_eq!(seen.borrow().operations, before + 1);
    assert_eq!((format!("{store:?}"), store.flash().capacity()), ("AsyncStore".into(), LEN as usize));
    // Neither does one that was dropped. One call takes the result, and the next one puts a job.
    let mut exchange =
        |store: &mut AsyncStore<_>| world.stack.exchange_job(clock.now(), store.slot(), &mut world.vehicle);
    while exchange(&mut store) && exchange(&mut store) {
        let before = seen.borrow().operations;
        {
            let mut run = pin!(store.run());
            let _ = poll(run.as_mut());
        }
        block_on(&clock, store.run());
        assert_eq!(seen.borrow().operations, before + 1);
        clock.set(clock.now() + millis(1));
        if seen.borrow().operations > 20 {
            break;
        }
    }
}
