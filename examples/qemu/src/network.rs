//! The vehicle on a network: UDP over smoltcp, on the Ethernet controller of the board.
//!
//! The address is assigned by DHCP. Without an answer the vehicle takes a fixed one, and repeats the request. When a lease expires, it
//! gives up the address at once, as another host may have it now.

use mavstack::Instant;
use mavstack::frame::MAX_FRAME_LEN;
use mavstack::io::{DatagramSocket, MAX_DATAGRAM_LEN, UdpLinks};
use mavstack_demo::{App, STATIONS};
use smoltcp::iface::{Config, Interface, PollIngressSingleResult, SocketHandle, SocketSet, SocketStorage};
use smoltcp::socket::{dhcpv4, udp};
use smoltcp::wire::{EthernetAddress, IpCidr, IpEndpoint, Ipv4Address, Ipv4Cidr};
use static_cell::{ConstStaticCell, StaticCell};

use crate::board;
use crate::lan9118::Lan9118;

/// The vehicle's own UDP port.
pub const PORT: u16 = 14_550;
/// The address without DHCP, and its router: those of QEMU's network. A product takes a configured address, or a link-local one
/// (169.254.0.0/16) that no other host answers for.
pub const FIXED: (Ipv4Cidr, Ipv4Address) =
    (Ipv4Cidr::new(Ipv4Address::new(10, 0, 2, 15), 24), Ipv4Address::new(10, 0, 2, 2));
/// Where heartbeats are sent as long as no station is known. Not the broadcast address of the subnet: QEMU passes only this one on to
/// the host.
pub const BROADCAST: Ipv4Address = Ipv4Address::BROADCAST;
/// How long to wait for DHCP. QEMU's link is up at once. A PHY needs up to this long to negotiate: wait for its link first.
pub const PATIENCE: mavstack::Duration = mavstack::Duration::from_secs(3);
/// How long the send queue may stay full before it is discarded. smoltcp never drops a datagram to a host that does not answer ARP, and
/// sends nothing behind it.
pub const STALL: mavstack::Duration = mavstack::Duration::from_secs(3);

/// The most Ethernet frames that one call takes from the controller.
const FRAMES: usize = 32;

/// Memory of the UDP socket. It is small: received frames stay in the controller until the stack takes them, and frames to send are
/// sent at once. Only while the Ethernet address of a station has to be found, datagrams wait here.
static RX: ConstStaticCell<[u8; 2 * MAX_DATAGRAM_LEN]> = ConstStaticCell::new([0; 2 * MAX_DATAGRAM_LEN]);
static TX: ConstStaticCell<[u8; 4 * MAX_FRAME_LEN]> = ConstStaticCell::new([0; 4 * MAX_FRAME_LEN]);
static QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues {
    rx: [udp::PacketMetadata::EMPTY; 16],
    tx: [udp::PacketMetadata::EMPTY; 4],
    sockets: [SocketStorage::EMPTY; 2],
});

struct Queues {
    rx: [udp::PacketMetadata; 16],
    tx: [udp::PacketMetadata; 4],
    sockets: [SocketStorage<'static>; 2],
}

/// The network, and the links of the stations on it.
pub struct Network {
    net: Net,
    links: UdpLinks<IpEndpoint, { STATIONS.len() }>,
    /// When to take the fixed address.
    fixed_due: Option<Instant>,
}

/// The part that the socket needs.
struct Net {
    now: smoltcp::time::Instant,
    device: Lan9118,
    interface: Interface,
    sockets: SocketSet<'static>,
    udp: SocketHandle,
    dhcp: SocketHandle,
    /// How many Ethernet frames this call may still take.
    frames: usize,
    /// When the send queue becomes stalled, if it stays full.
    stalled_at: Option<smoltcp::time::Instant>,
}

impl Network {
    /// Starts the network. Returns `None` on every call but the first.
    pub fn start(mut device: Lan9118, now: Instant) -> Option<&'static mut Self> {
        static NETWORK: StaticCell<Network> = StaticCell::new();

        let Queues { rx, tx, sockets } = QUEUES.try_take()?;
        let mut config = Config::new(EthernetAddress(device.address()).into());
        // Predictable. A product takes it from a random number generator, because it determines the ids of DHCP's requests.
        config.random_seed = board::ticks().into();
        let now = time(now);
        let interface = Interface::new(config, &mut device, now);
        let buffer = |meta: &'static mut [_], bytes: &'static mut [u8]| udp::PacketBuffer::new(meta, bytes);
        let mut socket = udp::Socket::new(buffer(rx, RX.try_take()?), buffer(tx, TX.try_take()?));
        socket.bind(PORT).ok()?;
        let mut sockets = SocketSet::new(&mut sockets[..]);
        let (udp, dhcp) = (sockets.add(socket), sockets.add(dhcpv4::Socket::new()));
        device.listen();
        let net = Net { now, device, interface, sockets, udp, dhcp, frames: 0, stalled_at: None };
        NETWORK.try_init(Self { net, links: UdpLinks::new(STATIONS), fixed_due: None })
    }

    /// Moves datagrams between the stations and the vehicle. Never blocks. Returns whether frames were received: more may
    /// follow soon.
    pub fn serve(&mut self, app: &mut App, now: Instant) -> bool {
        self.net.now = time(now);
        self.net.frames = FRAMES;
        self.net.device.acknowledge();
        let (stack, vehicle) = app.parts();
        stack.poll_udp(now, &mut self.links, &mut self.net, vehicle);
        self.configure(now);
        self.net.send_pending();
        self.net.frames < FRAMES
    }

    /// Takes the address that DHCP assigns, or the fixed one.
    fn configure(&mut self, now: Instant) {
        let net = &mut self.net;
        let (address, router, origin) = match net.sockets.get_mut::<dhcpv4::Socket>(net.dhcp).poll() {
            Some(dhcpv4::Event::Configured(config)) => (config.address, config.router, "DHCP"),
            // The lease has expired. It is also the first event.
            Some(dhcpv4::Event::Deconfigured) => {
                self.fixed_due = Some(now + PATIENCE);
                net.interface.update_ip_addrs(|addresses| addresses.clear());
                net.interface.routes_mut().remove_default_ipv4_route();
                self.links.set_broadcast(None);
                return;
            }
            None if self.fixed_due.is_some_and(|due| now >= due) => (FIXED.0, Some(FIXED.1), "no DHCP"),
            None => return,
        };
        self.fixed_due = None;
        net.interface.update_ip_addrs(|addresses| {
            addresses.clear();
            // It has room for one.
            let _ = addresses.push(IpCidr::Ipv4(address));
        });
        let routes = net.interface.routes_mut();
        routes.remove_default_ipv4_route();
        if let Some(router) = router {
            // It has room for one.
            let _ = routes.add_default_ipv4_route(router);
        }
        let port = board::station_port();
        self.links.set_broadcast(Some((BROADCAST, port).into()));
        log_address(address, origin);
    }
}

impl Net {
    /// Takes the next Ethernet frame from the controller. Returns false if there is none, or this call has taken enough.
    fn take_frame(&mut self) -> bool {
        let Self { now, device, interface, sockets, frames, .. } = self;
        let Some(left) = frames.checked_sub(1) else { return false };
        let is_taken = !matches!(interface.poll_ingress_single(*now, device, sockets), PollIngressSingleResult::None);
        if is_taken {
            *frames = left;
        }
        is_taken
    }

    /// Sends what is pending in the sockets.
    fn send_pending(&mut self) {
        let Self { now, device, interface, sockets, .. } = self;
        interface.poll_egress(*now, device, sockets);
    }

    /// Empties the socket, which is full, if that has lasted for [`STALL`]. Returns whether it is empty now.
    fn discard_stalled(&mut self) -> bool {
        let now = self.now;
        if now < *self.stalled_at.get_or_insert(now + smoltcp::time::Duration::from_micros(STALL.as_micros())) {
            return false;
        }
        self.stalled_at = None;
        let socket = self.sockets.get_mut::<udp::Socket>(self.udp);
        socket.close();
        socket.bind(PORT).is_ok()
    }

    fn has_room(&self) -> bool {
        let socket = self.sockets.get::<udp::Socket>(self.udp);
        socket.can_send() && socket.payload_send_capacity() - socket.send_queue() >= 2 * MAX_FRAME_LEN
    }
}

impl DatagramSocket for Net {
    type Endpoint = IpEndpoint;

    fn receive(&mut self, buffer: &mut [u8]) -> Option<(usize, IpEndpoint)> {
        loop {
            // With an MTU of 1,500 bytes, no datagram exceeds the buffer.
            if let Ok((len, from)) = self.sockets.get_mut::<udp::Socket>(self.udp).recv_slice(buffer) {
                return Some((len, from.endpoint));
            }
            if !self.take_frame() {
                return None;
            }
        }
    }

    fn is_ready(&mut self) -> bool {
        // The answer with a station's Ethernet address may be among the received frames.
        while !self.has_room() {
            if !self.take_frame() {
                return self.discard_stalled();
            }
            self.send_pending();
        }
        self.stalled_at = None;
        true
    }

    fn send(&mut self, datagram: &[u8], to: IpEndpoint) -> bool {
        let is_queued = self.sockets.get_mut::<udp::Socket>(self.udp).send_slice(datagram, to).is_ok();
        // At once: a heartbeat must not wait here while flight stops (H-5).
        self.send_pending();
        is_queued
    }
}

fn time(now: Instant) -> smoltcp::time::Instant {
    smoltcp::time::Instant::from_micros(now.as_micros() as i64)
}

/// Logs the vehicle's address.
pub fn log_address(address: Ipv4Cidr, origin: &str) {
    #[cfg(feature = "defmt")]
    {
        let ([a, b, c, d], prefix) = (address.address().octets(), address.prefix_len());
        defmt::info!(
            "address {=u8}.{=u8}.{=u8}.{=u8}/{=u8} ({=str}), UDP port {=u16}",
            a,
            b,
            c,
            d,
            prefix,
            origin,
            PORT
        );
    }
    #[cfg(not(feature = "defmt"))]
    let _ = (address, origin);
}
