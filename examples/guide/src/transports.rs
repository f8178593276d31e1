//! UARTs and networks: `docs/transports.md`.

mod async_tasks;

use core::net::{Ipv4Addr, SocketAddrV4};

use mavstack::config::{LinkClass, PollBudget};
use mavstack::io::{SerialQueues, UdpLinks, queue_len};
use mavstack::prelude::*;

const LEN: usize = queue_len(57_600, Duration::from_millis(4));
static TELEM: SerialQueues<LEN, LEN> = SerialQueues::new();

/// The UART's interrupt.
fn usart1(uart: &mut impl Registers) {
    let mut queues = TELEM.interrupt_end();
    if uart.has_error() {
        queues.line_error(); // overrun, framing or noise
    }
    if let Some(byte) = uart.received() {
        queues.received(byte);
    }
    if uart.can_send() {
        match queues.next_to_send() {
            Some(byte) => uart.send(byte),
            None => uart.enable_transmit_interrupt(false), // otherwise it fires again at once
        }
    }
}

/// A UART, as a HAL or its registers have it.
trait Registers {
    fn has_error(&self) -> bool;
    fn received(&mut self) -> Option<u8>;
    fn can_send(&self) -> bool;
    fn send(&mut self, byte: u8);
    fn enable_transmit_interrupt(&mut self, enable: bool);
}

const LINKS: [LinkConfig; 3] = [
    LinkConfig::uart(57_600),                                    // telemetry radio
    LinkConfig::uart(921_600).with_own_system(true),             // companion computer
    LinkConfig::uart(19_200).with_class(LinkClass::HighLatency), // satellite modem
];

mod udp {
    use super::*;

    static PULSE: Pulse = Pulse::new();

    /// Up to 4 Mbit/s, if the loop takes a millisecond: nine short datagrams in each pass.
    const BUDGET: PollBudget = PollBudget::for_link(4_000_000, Duration::from_millis(1));
    const CONFIG: Config = Config { budget: BUDGET, ..Config::new(Address::new(1, 1), &PULSE) };
    /// A companion computer on a UART, and two stations with up to 100 kB/s each.
    const LINKS: [LinkConfig; 3] =
        [LinkConfig::uart(921_600), LinkConfig::limited(100_000), LinkConfig::limited(100_000)];

    fn stations() -> UdpLinks<SocketAddrV4, 2> {
        let mut udp = UdpLinks::new([LinkId(1), LinkId(2)]);
        // When the vehicle has an address: the broadcast address of its subnet.
        udp.set_broadcast(Some(SocketAddrV4::new(Ipv4Addr::new(192, 168, 1, 255), 14_550)));
        udp // in each pass, after `stack.poll`: `stack.poll_udp(now, &mut udp, &mut socket, &mut vehicle)`
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Uart {
        sent: std::vec::Vec<u8>,
        interrupts: bool,
    }

    impl Registers for Uart {
        fn has_error(&self) -> bool {
            false
        }
        fn received(&mut self) -> Option<u8> {
            None
        }
        fn can_send(&self) -> bool {
            true
        }
        fn send(&mut self, byte: u8) {
            self.sent.push(byte);
        }
        fn enable_transmit_interrupt(&mut self, enable: bool) {
            self.interrupts = enable;
        }
    }

    #[test]
    fn an_empty_queue_disables_the_transmit_interrupt() {
        let mut uart = Uart { sent: std::vec![], interrupts: true };
        usart1(&mut uart);
        assert!(uart.sent.is_empty() && !uart.interrupts);
    }
}
