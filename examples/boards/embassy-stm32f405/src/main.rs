//! A rover on an STM32F405 with Embassy. Telemetry is on USART1, PA9 (TX) and PA10 (RX), at 57,600 bit/s.
//!
//! Three futures share the stack in one task: the driving loop, and an end of the link in each direction. A `RefCell` suffices,
//! because none of them holds a borrow over an `await`.
//!
//! The mission and the parameters are stored in the last two sectors of the flash, while the rover is disarmed. An erase stops the
//! processor for 1 s typically, and 2 s at most.
//!
//! When the receive buffer is full, `BufferedUart` of embassy-stm32 0.6 drops bytes without an error; checksums detect that.
#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::cell::RefCell;

use embassy_executor::Spawner;
use embassy_futures::join::join3;
use embassy_futures::select::select;
use embassy_stm32::flash::{Blocking, Flash};
use embassy_stm32::usart::{
    BufferedInterruptHandler, BufferedUart, BufferedUartRx, BufferedUartTx, Config as UartConfig,
};
use embassy_stm32::{bind_interrupts, peripherals};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Ticker, Timer, with_timeout};
use mavstack::io::{AsyncReceiver, AsyncTransmitter, queue_len};
use mavstack::storage::Store;
use mavstack::{Instant, LinkConfig, LinkId};
use mavstack_rover::{CONFIG, Mavlink, Rover};
// Halts on a panic. The stack does not panic. A real vehicle would stop its motors and let the watchdog reset it.
use panic_halt as _;
use static_cell::ConstStaticCell;

bind_interrupts!(struct Interrupts {
    USART1 => BufferedInterruptHandler<peripherals::USART1>;
});

const BAUD: u32 = 57_600;
const TELEM: LinkId = LinkId(0);

/// Sectors 10 and 11, as offsets in the flash. `memory.x` keeps the firmware out of them.
const REGION: core::ops::Range<u32> = 0xC_0000..0x10_0000;
const _: () = assert!(Store::<Flash<'_, Blocking>>::region_len::<Mavlink>() <= REGION.end - REGION.start);

/// Period of the driving loop. Received bytes wait no longer than that.
const PERIOD: Duration = Duration::from_millis(4);
const BUFFER: usize = queue_len(BAUD, mavstack::Duration::from_micros(PERIOD.as_micros()));

/// Several times as long as the buffer takes on the line.
const TIMEOUT: Duration = Duration::from_millis(100);

/// Static because it is too large for the task. It is all zero bits until it is begun, so it takes no flash.
static STACK: ConstStaticCell<Mavlink> = ConstStaticCell::new(Mavlink::VACANT);
static RECEIVED: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);
static TO_SEND: ConstStaticCell<[u8; BUFFER]> = ConstStaticCell::new([0; BUFFER]);

/// What the futures share.
struct Shared {
    vehicle: RefCell<(&'static mut Mavlink, Rover)>,
    /// Signals that there may be something to send.
    wake: Signal<NoopRawMutex, ()>,
}

fn now() -> Instant {
    Instant::from_micros(embassy_time::Instant::now().as_micros())
}

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let chip = embassy_stm32::init(Default::default());
    let mut config = UartConfig::default();
    config.baudrate = BAUD;
    let (received, to_send) = (RECEIVED.take(), TO_SEND.take());
    let uart = BufferedUart::new(chip.USART1, chip.PA10, chip.PA9, to_send, received, Interrupts, config)
        .expect("the baud rate is supported");
    let (tx, rx) = uart.split();

    let stack = STACK.take();
    stack.begin(CONFIG, [LinkConfig::uart(BAUD)]);
    let mut store = Store::new(Flash::new_blocking(chip.FLASH), REGION);
    let mut rover = Rover::default();
    rover.is_restored = stack.restore(now(), &mut store, &mut rover).is_ok();
    let shared = Shared { vehicle: RefCell::new((stack, rover)), wake: Signal::new() };
    join3(drive(&shared, store), receive(&shared, rx), transmit(&shared, tx)).await;
}

async fn drive(shared: &Shared, mut store: Store<Flash<'_, Blocking>>) {
    let mut pass = Ticker::every(PERIOD);
    loop {
        {
            let (stack, rover) = &mut *shared.vehicle.borrow_mut();
            rover.drive(now(), stack);
            stack.persist(now(), &mut store, rover);
        }
        // The rover's state may have changed.
        shared.wake.signal(());
        pass.next().await;
    }
}

async fn receive(shared: &Shared, rx: BufferedUartRx<'_>) {
    let mut buffer = [0; 32];
    let mut receiver = AsyncReceiver::new(rx, &mut buffer);
    loop {
        receiver.wait().await;
        {
            let (stack, rover) = &mut *shared.vehicle.borrow_mut();
            // Errors are counted in `stack.link_counters(TELEM)`. The link continues.
            let _ = stack.receive_from(now(), TELEM, &mut receiver, rover);
        }
        shared.wake.signal(());
    }
}

async fn transmit(shared: &Shared, tx: BufferedUartTx<'_>) {
    // Not longer than the UART's own: it refuses a longer write.
    let mut buffer = [0; BUFFER];
    let mut transmitter = AsyncTransmitter::new(tx, &mut buffer);
    loop {
        let (has_bytes, deadline) = {
            let (stack, rover) = &mut *shared.vehicle.borrow_mut();
            let now = now();
            stack.poll(now, rover);
            let has_bytes = stack.transmit_to(now, TELEM, &mut transmitter, rover);
            (has_bytes, stack.link_deadline(now, TELEM))
        };
        if has_bytes == Ok(true) {
            // The HAL may miss a wake-up. After a timeout nothing is lost: the transmitter continues where it was.
            let _ = with_timeout(TIMEOUT, transmitter.send()).await;
        } else {
            let next = Timer::at(embassy_time::Instant::from_micros(deadline.as_micros()));
            select(shared.wake.wait(), next).await;
        }
    }
}
