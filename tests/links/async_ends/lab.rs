//! A laboratory for async tasks: a UART with awkward futures, an executor that polls only tasks that were woken, and the tasks
//! of a firmware. `borrow_mut` panics if a task holds the stack over an `await`.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use crate::support::*;
use embedded_io_async::{ErrorType, Read, Write};
use mavstack::__private::NoPlans;
use mavstack::config::PollBudget;
use mavstack::io::{AsyncReceiver, AsyncTransmitter};
use mavstack::network::LinkError;
use mavstack::{Config, Instant, LinkConfig, LinkId, Pulse, Stack};

/// A UART: its buffers, and how awkward its futures are. Clones are the same UART.
#[derive(Clone)]
pub struct Uart(Rc<RefCell<State>>);

pub struct State {
    pub rng: Rng,
    /// Bytes that were received and not read.
    pub received: VecDeque<u8>,
    /// Bytes that have left the UART.
    pub sent: Vec<u8>,
    /// Bytes that were written and have not left the UART, and the most that it holds.
    pub fifo: VecDeque<u8>,
    pub capacity: usize,
    /// The most bytes of a read or write.
    pub piece: u64,
    /// Whether futures are pending now and then for no reason.
    pub stumbles: bool,
    /// Whether a write has sent some of its bytes when it is dropped, as with DMA.
    pub is_sloppy: bool,
    pub closed: bool,
    pub read_error: Option<LineError>,
    pub write_error: Option<LineError>,
    pub flush_error: Option<LineError>,
    wakers: [Option<Waker>; 2],
}

impl Uart {
    pub fn new(seed: u64) -> Self {
        Self(Rc::new(RefCell::new(State {
            rng: Rng::new(seed),
            received: VecDeque::new(),
            sent: Vec::new(),
            fifo: VecDeque::new(),
            capacity: 64,
            piece: 1_000,
            stumbles: false,
            is_sloppy: false,
            closed: false,
            read_error: None,
            write_error: None,
            flush_error: None,
            wakers: [None, None],
        })))
    }

    /// Changes or reads the state, as an interrupt does: it wakes both futures.
    pub fn with<T>(&self, work: impl FnOnce(&mut State) -> T) -> T {
        let mut state = self.0.borrow_mut();
        let result = work(&mut state);
        state.wakers.iter_mut().filter_map(Option::take).for_each(Waker::wake);
        result
    }

    /// Sends at most `most` bytes of the FIFO.
    pub fn drain(&self, most: usize) {
        if !self.0.borrow().fifo.is_empty() {
            self.with(|state| {
                let len = most.min(state.fifo.len());
                state.sent.extend(state.fifo.drain(..len));
            });
        }
    }

    async fn stumble(&self) {
        while self.0.borrow().stumbles && self.with(|state| state.rng.chance(0.5)) {
            pending_once().await;
        }
    }

    /// Awaits a result of `work`, which has no effect when it returns `None`.
    async fn until<T>(&self, half: usize, mut work: impl FnMut(&mut State) -> Option<T>) -> T {
        self.stumble().await;
        core::future::poll_fn(|context| {
            let mut state = self.0.borrow_mut();
            match work(&mut state) {
                Some(result) => Poll::Ready(result),
                None => {
                    state.wakers[half] = Some(context.waker().clone());
                    Poll::Pending
                }
            }
        })
        .await
    }
}

impl ErrorType for Uart {
    type Error = LineError;
}

impl Read for Uart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, LineError> {
        assert!(!buffer.is_empty());
        self.until(0, |state| {
            if let Some(error) = state.read_error.take() {
                return Some(Err(error));
            }
            if state.received.is_empty() {
                return state.closed.then_some(Ok(0));
            }
            let len = 1 + state.rng.below(state.piece) as usize;
            let len = len.min(buffer.len()).min(state.received.len());
            buffer.iter_mut().zip(state.received.drain(..len)).for_each(|(to, from)| *to = from);
            Some(Ok(len))
        })
        .await
    }
}

impl Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, LineError> {
        assert!(!bytes.is_empty());
        let is_sloppy = self.0.borrow().is_sloppy;
        let mut written = 0;
        loop {
            let piece = self.until(1, |state| {
                if let Some(error) = state.write_error.take() {
                    return Some(Err(error));
                }
                if state.closed {
                    return Some(Ok(0));
                }
                let room = state.capacity - state.fifo.len();
                let len = 1 + state.rng.below(state.piece) as usize;
                let len = len.min(room).min(bytes.len() - written);
                state.fifo.extend(&bytes[written..written + len]);
                (len > 0).then_some(Ok(len))
            });
            written += piece.await?;
            if !is_sloppy || written == bytes.len() {
                return Ok(written);
            }
        }
    }

    async fn flush(&mut self) -> Result<(), LineError> {
        self.until(1, |state| match state.flush_error.take() {
            Some(error) => Some(Err(error)),
            None => state.fifo.is_empty().then_some(Ok(())),
        })
        .await
    }
}

/// Is pending once.
pub async fn pending_once() {
    let mut is_first = true;
    core::future::poll_fn(|context| {
        context.waker().wake_by_ref();
        if std::mem::take(&mut is_first) { Poll::Pending } else { Poll::Ready(()) }
    })
    .await;
}

/// Drops a future at any of its `await`s.
pub struct Scissors {
    rng: RefCell<Rng>,
    chance: f64,
    pub cuts: Cell<u32>,
}

impl Scissors {
    pub fn new(seed: u64, chance: f64) -> Rc<Self> {
        Rc::new(Self { rng: RefCell::new(Rng::new(seed)), chance, cuts: Cell::new(0) })
    }

    pub async fn cut(&self, future: impl Future<Output = ()>) {
        let mut future = pin!(future);
        core::future::poll_fn(|context| match future.as_mut().poll(context) {
            Poll::Pending if self.rng.borrow_mut().chance(self.chance) => {
                self.cuts.set(self.cuts.get() + 1);
                Poll::Ready(())
            }
            poll => poll,
        })
        .await;
    }
}

/// Returns when the first of two futures is ready, and drops the other.
pub async fn select(first: impl Future<Output = ()>, second: impl Future<Output = ()>) {
    let (mut first, mut second) = (pin!(first), pin!(second));
    core::future::poll_fn(|context| {
        let is_ready = first.as_mut().poll(context).is_ready() || second.as_mut().poll(context).is_ready();
        if is_ready { Poll::Ready(()) } else { Poll::Pending }
    })
    .await;
}

/// A signal to a task.
#[derive(Default)]
struct Signal {
    is_set: Cell<bool>,
    waker: RefCell<Option<Waker>>,
}

impl Signal {
    fn set(&self) {
        self.is_set.set(true);
        self.waker.take().into_iter().for_each(Waker::wake);
    }

    async fn wait(&self) {
        core::future::poll_fn(|context| {
            self.waker.replace(Some(context.waker().clone()));
            if self.is_set.replace(false) { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }
}

struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

struct Task {
    future: Pin<Box<dyn Future<Output = ()>>>,
    woken: Arc<Flag>,
    /// How often it was polled.
    polls: u32,
    is_done: bool,
}

/// Polls only tasks that were woken, so a lost wake-up stops a task for ever.
#[derive(Default)]
pub struct Executor(Vec<Task>);

impl Executor {
    pub fn spawn(&mut self, future: impl Future<Output = ()> + 'static) {
        let woken = Arc::new(Flag(AtomicBool::new(true)));
        self.0.push(Task { future: Box::pin(future), woken, polls: 0, is_done: false });
    }

    /// Runs until no task is woken. Panics if tasks keep each other, or themselves, awake.
    pub fn run(&mut self) {
        for _ in 0..20_000 {
            let mut is_idle = true;
            for task in self.0.iter_mut().filter(|task| !task.is_done) {
                if task.woken.0.swap(false, Ordering::Relaxed) {
                    is_idle = false;
                    task.polls += 1;
                    let waker = Waker::from(Arc::clone(&task.woken));
                    task.is_done = task.future.as_mut().poll(&mut Context::from_waker(&waker)).is_ready();
                }
            }
            if is_idle {
                return;
            }
        }
        panic!("the tasks never sleep");
    }

    pub fn polls(&self) -> u32 {
        self.0.iter().map(|task| task.polls).sum()
    }
}

type TestedStack<const N: usize> = Stack<Tested<NoPlans, 8, Timed>, N>;

/// The firmware: a stack that its tasks share, its UARTs and its timers.
pub struct Firmware<const N: usize> {
    pub stack: RefCell<(Box<TestedStack<N>>, TestVehicle)>,
    pub uarts: [Uart; N],
    pub pulse: &'static Pulse,
    pub errors: RefCell<Vec<(LinkId, LinkError<LineError>)>>,
    clock: Clock,
    signals: [Signal; N],
    timers: RefCell<Vec<(Instant, Waker)>>,
}

impl<const N: usize> Firmware<N> {
    pub fn new(seed: u64) -> Rc<Self> {
        Self::with_budget(seed, PollBudget::DEFAULT)
    }

    pub fn with_budget(seed: u64, budget: PollBudget) -> Rc<Self> {
        let setup = Setup::<N>::new();
        let config = Config { budget, ..setup.config };
        let links = [LinkConfig::uart(115_200); N];
        Rc::new(Self {
            stack: RefCell::new((begun(config, links), TestVehicle::new())),
            uarts: std::array::from_fn(|link| Uart::new(seed + link as u64)),
            pulse: config.pulse.expect("a setup has a pulse"),
            errors: RefCell::default(),
            clock: Clock::default(),
            signals: std::array::from_fn(|_| Signal::default()),
            timers: RefCell::default(),
        })
    }

    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Lets time pass, and wakes the tasks whose timers have elapsed.
    pub fn set_time(&self, now: Instant) {
        self.clock.set(now);
        let mut timers = self.timers.borrow_mut();
        timers.extract_if(.., |(at, _)| *at <= now).for_each(|(_, waker)| waker.wake());
    }

    async fn sleep_until(&self, deadline: Instant) {
        core::future::poll_fn(|context| {
            if self.now() >= deadline {
                return Poll::Ready(());
            }
            self.timers.borrow_mut().push((deadline, context.waker().clone()));
            Poll::Pending
        })
        .await;
    }

    pub fn wake_transmitters(&self) {
        self.signals.iter().for_each(Signal::set);
    }

    /// Waits for a wake-up, or for the link's deadline.
    pub async fn sleep(&self, link: LinkId, deadline: Instant) {
        select(self.signals[usize::from(link.0)].wait(), self.sleep_until(deadline)).await;
    }

    fn report(&self, link: LinkId, error: LinkError<LineError>) {
        self.errors.borrow_mut().push((link, error));
    }

    pub fn take_from(
        &self,
        link: LinkId,
        receiver: &mut AsyncReceiver<'_, Uart>,
    ) -> Result<bool, LinkError<LineError>> {
        let (stack, vehicle) = &mut *self.stack.borrow_mut();
        let result = stack.receive_from(self.now(), link, receiver, vehicle);
        result.inspect_err(|error| self.report(link, *error))
    }

    /// Returns whether there are bytes to send, and when to call it again.
    pub fn give_to(&self, link: LinkId, transmitter: &mut AsyncTransmitter<'_, Uart>) -> (bool, Instant) {
        let (stack, vehicle) = &mut *self.stack.borrow_mut();
        let now = self.now();
        stack.poll(now, vehicle);
        let result = stack.transmit_to(now, link, transmitter, vehicle);
        let result = result.inspect_err(|error| self.report(link, *error));
        (result.unwrap_or(false), stack.link_deadline(now, link))
    }

    /// The receive task, until the transport is closed.
    pub async fn receive<const LEN: usize>(self: Rc<Self>, link: LinkId, scissors: Rc<Scissors>) {
        let mut buffer = [0; LEN];
        let mut receiver = AsyncReceiver::new(self.uarts[usize::from(link.0)].clone(), &mut buffer);
        while self.take_from(link, &mut receiver) != Err(LinkError::Closed) {
            self.wake_transmitters();
            scissors.cut(receiver.wait()).await;
        }
    }

    /// The transmit task.
    pub async fn transmit<const LEN: usize>(self: Rc<Self>, link: LinkId, scissors: Rc<Scissors>) {
        let mut buffer = [0; LEN];
        let mut transmitter = AsyncTransmitter::new(self.uarts[usize::from(link.0)].clone(), &mut buffer);
        loop {
            let (has_bytes, deadline) = self.give_to(link, &mut transmitter);
            if has_bytes {
                scissors.cut(transmitter.send()).await;
            } else {
                scissors.cut(self.sleep(link, deadline)).await;
            }
        }
    }

    /// A transmit task that drops each `send` as soon as it is pending, and tries again a millisecond later.
    pub async fn transmit_impatiently(self: Rc<Self>, link: LinkId) {
        let mut buffer = [0; 300];
        let mut transmitter = AsyncTransmitter::new(self.uarts[usize::from(link.0)].clone(), &mut buffer);
        loop {
            self.give_to(link, &mut transmitter);
            select(transmitter.send(), async {}).await;
            self.sleep_until(self.now() + millis(1)).await;
        }
    }

    /// Runs for a time in steps of a millisecond. Each step sends `rate` bytes, and flight ticks its pulse.
    pub fn run_for(&self, executor: &mut Executor, millis: u64, rate: usize) {
        for _ in 0..millis {
            self.pulse.tick();
            self.step(executor, rate);
        }
    }

    /// Runs a millisecond without flight.
    pub fn step(&self, executor: &mut Executor, rate: usize) {
        self.uarts.iter().for_each(|uart| uart.drain(rate));
        self.set_time(self.now() + millis(1));
        executor.run();
    }
}
