//! The demo vehicle as Embassy tasks on a network: telemetry over UDP by embassy-net, the other two links on UARTs.
//!
//! It is the firmware `embassy` with two tasks in place of those of UART0: `network` runs embassy-net, and `stations` moves the
//! datagrams of all ground stations. The latter sleeps until a datagram arrives, another task has something to send, or the link of a
//! station is due. They are two tasks: each use of a socket wakes embassy-net, and one task would wake itself forever.
#![no_std]
#![no_main]

#[path = "embassy/executors.rs"]
mod executors;
#[path = "embassy/shared.rs"]
mod shared;
#[path = "embassy/tasks.rs"]
mod tasks;
#[path = "embassy/time.rs"]
mod time;
#[path = "embassy/uart.rs"]
mod uart;

use core::task::{Context, Poll, Waker};

use cortex_m_rt::entry;
use embassy_executor::Spawner;
use embassy_futures::select::{Either, select, select3};
use embassy_futures::yield_now;
use embassy_net::udp::{PacketMetadata, UdpSocket};
use embassy_net::{ConfigV4, IpEndpoint, Stack, StackResources, StaticConfigV4};
use embassy_sync::mutex::Mutex;
use embassy_time::Timer;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{DatagramSocket, MAX_DATAGRAM_LEN, UdpLinks};
use mavstack_demo::{COMPANION, SATELLITE, STATIONS, TELEMETRY};
use mavstack_qemu::board::{self, Board};
use mavstack_qemu::device::interrupt;
use mavstack_qemu::lan9118::{self, EmbassyDriver};
use mavstack_qemu::memory::{self, FlashStore};
use mavstack_qemu::network::{BROADCAST, FIXED, PATIENCE, PORT, STALL, log_address};
use shared::{SharedApp, WAKE};
use static_cell::{ConstStaticCell, StaticCell};
use tasks::{SharedStore, exchange, flight, receive, run, transmit};
use uart::Uart;

/// Queues for the bytes that arrive while flight runs, for some milliseconds.
static COMPANION_UART: Uart<1024> = Uart::new();
static SATELLITE_UART: Uart<32> = Uart::new();

#[entry]
fn main() -> ! {
    static APP: StaticCell<SharedApp> = StaticCell::new();
    static STORE: StaticCell<SharedStore> = StaticCell::new();

    let app = memory::start();
    let (Some(mut core), Some(board)) = (cortex_m::Peripherals::take(), Board::take()) else {
        unreachable!("the firmware starts once")
    };
    let mut store = FlashStore::new(board.flash);
    store.restore(app, board::now());
    let app = &*APP.init(Mutex::new(app));
    let store = &*STORE.init(Mutex::new(store));
    time::start(board.alarm);

    let [flights, comms, storage] = executors::start(&mut core.NVIC);
    // No spawn fails, because each pool has enough slots.
    flights.spawn(flight(app).unwrap());
    comms.spawn(network(app, EmbassyDriver::new(board.ethernet)).unwrap());
    let [_, companion, satellite] = board.uarts;
    for (link, (rx, tx)) in [(COMPANION, COMPANION_UART.start(companion)), (SATELLITE, SATELLITE_UART.start(satellite))]
    {
        comms.spawn(receive(app, link, rx).unwrap());
        comms.spawn(transmit(app, link, tx).unwrap());
    }
    comms.spawn(exchange(app, store).unwrap());
    storage.spawn(run(store).unwrap());
    loop {
        cortex_m::asm::wfi();
    }
}

/// Starts `stations`, which shares embassy-net and so must be on the same executor, and runs embassy-net.
#[embassy_executor::task]
async fn network(app: &'static SharedApp, driver: EmbassyDriver) -> ! {
    static RESOURCES: StaticCell<StackResources<2>> = StaticCell::new();

    let config = embassy_net::Config::dhcpv4(embassy_net::DhcpConfig::default());
    let resources = RESOURCES.init(StackResources::new());
    // The seed is predictable. A product takes it from a random number generator.
    let (net, mut runner) = embassy_net::new(driver, config, resources, board::ticks().into());
    spawner().await.spawn(stations(app, net).unwrap());
    runner.run().await
}

/// Returns a spawner for tasks that stay on the executor of this one.
#[allow(unsafe_code, reason = "the only spawner of an interrupt executor for tasks that are not `Send`")]
async fn spawner() -> Spawner {
    // SAFETY: only tasks of Embassy's executor await it.
    unsafe { Spawner::for_current_executor() }.await
}

/// A socket whose calls do not wait.
struct Socket(UdpSocket<'static>);

/// Polls a future once; `None` if it would wait.
fn ready<T>(poll: impl FnOnce(&mut Context<'_>) -> Poll<T>) -> Option<T> {
    match poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(result) => Some(result),
        Poll::Pending => None,
    }
}

impl DatagramSocket for Socket {
    type Endpoint = IpEndpoint;

    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, IpEndpoint)> {
        loop {
            // An error means that a datagram exceeds the buffer. It is discarded, and the next one is returned.
            if let Ok((len, from)) = ready(|context| self.0.poll_recv_from(buffer, context))? {
                return Some((len, from.endpoint));
            }
        }
    }

    fn is_ready(&mut self) -> bool {
        ready(|context| self.0.poll_send_ready(context)).is_some()
    }

    fn send(&mut self, datagram: &[u8], to: IpEndpoint) -> bool {
        matches!(ready(|context| self.0.poll_send_to(datagram, to, context)), Some(Ok(())))
    }
}

/// Moves the datagrams of the ground stations. It locks the vehicle for one call at a time.
#[embassy_executor::task]
async fn stations(app: &'static SharedApp, net: Stack<'static>) {
    // embassy-net moves several received frames into the socket at once.
    static RX_META: ConstStaticCell<[PacketMetadata; 32]> = ConstStaticCell::new([PacketMetadata::EMPTY; 32]);
    static TX_META: ConstStaticCell<[PacketMetadata; 16]> = ConstStaticCell::new([PacketMetadata::EMPTY; 16]);
    static RX: ConstStaticCell<[u8; 2 * MAX_DATAGRAM_LEN]> = ConstStaticCell::new([0; 2 * MAX_DATAGRAM_LEN]);
    static TX: ConstStaticCell<[u8; 16 * MAX_FRAME_LEN]> = ConstStaticCell::new([0; 16 * MAX_FRAME_LEN]);

    let mut socket = UdpSocket::new(net, RX_META.take(), RX.take(), TX_META.take(), TX.take());
    // Port and socket are new.
    socket.bind(PORT).unwrap();
    let mut socket = Socket(socket);
    let mut links = UdpLinks::new(STATIONS);
    wait_for_address(net).await;
    links.set_broadcast(Some((BROADCAST, board::station_port()).into()));
    loop {
        app.lock().await.poll(board::now());
        let deadline = {
            let mut app = app.lock().await;
            let now = board::now();
            let (stack, vehicle) = app.parts();
            stack.poll_udp(now, &mut links, &mut socket, vehicle);
            STATIONS.iter().map(|link| stack.link_deadline(now, *link)).fold(mavstack::Instant::NEVER, Ord::min)
        };
        // A received frame may be forwarded.
        [COMPANION, SATELLITE].iter().for_each(|link| WAKE[usize::from(link.0)].signal(()));
        // embassy-net needs a turn, even if datagrams are pending.
        yield_now().await;
        if socket.is_ready() {
            let next = Timer::at(deadline.into());
            select3(socket.0.wait_recv_ready(), WAKE[usize::from(TELEMETRY.0)].wait(), next).await;
        } else {
            // Nothing is received meanwhile.
            let stall = Timer::after(STALL.into());
            if let Either::Second(()) = select(socket.0.wait_send_ready(), stall).await {
                // This empties it.
                socket.0.close();
                socket.0.bind(PORT).unwrap();
            }
        }
    }
}

/// Waits until DHCP has assigned an address. Without an answer the vehicle takes the fixed one and keeps it: embassy-net does not run
/// DHCP beside a static address.
async fn wait_for_address(net: Stack<'static>) {
    net.wait_link_up().await;
    let patience = Timer::after(PATIENCE.into());
    select(net.wait_config_up(), patience).await;
    if let Some(config) = net.config_v4() {
        log_address(config.address, "DHCP");
        return;
    }
    let (address, gateway) = FIXED;
    net.set_config_v4(ConfigV4::Static(StaticConfigV4 {
        address,
        gateway: Some(gateway),
        dns_servers: Default::default(),
    }));
    log_address(address, "no DHCP");
}

#[interrupt]
fn ETHERNET() {
    lan9118::on_interrupt();
}

#[interrupt]
fn UART1() {
    COMPANION_UART.on_interrupt();
}

#[interrupt]
fn UART2() {
    SATELLITE_UART.on_interrupt();
}
