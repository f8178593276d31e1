//! A driver for the LAN9118 and LAN9220, the board's Ethernet controller, and the drivers of smoltcp and embassy-net on it.
//!
//! Source: the data sheet "LAN9118", SMSC, chapters 3.12 (FIFOs) and 5 (registers). It leaves out what the emulator does not need: the
//! start of the PHY's auto-negotiation, endianness, power management, and the count of frames for which the FIFO had no room.
#![allow(unsafe_code, reason = "registers of the controller")]

use cortex_m::peripheral::NVIC;
use embassy_sync::waitqueue::AtomicWaker;

use crate::device::Interrupt;

/// The longest frame without its checksum, in bytes: an Ethernet header and 1,500 bytes of IP.
pub const MAX_FRAME_LEN: usize = 1_514;
/// In whole words.
const BUFFER_LEN: usize = MAX_FRAME_LEN.next_multiple_of(4);
/// Length of the checksum that the controller appends to a received frame, in bytes.
const FCS_LEN: usize = 4;

/// The offsets of the registers, in bytes.
#[derive(Clone, Copy)]
enum Register {
    RxData = 0x00,
    TxData = 0x20,
    RxStatus = 0x40,
    IrqConfig = 0x54,
    IntStatus = 0x58,
    IntEnable = 0x5C,
    FifoLevels = 0x68,
    TxConfig = 0x70,
    HwConfig = 0x74,
    RxDatapath = 0x78,
    RxFifo = 0x7C,
    TxFifo = 0x80,
    MacCommand = 0xA4,
    MacData = 0xA8,
}

/// Pushes the interrupt line, active high.
const IRQ_ENABLED: u32 = 1 << 8 | 1 << 4 | 1 << 0;
/// Interrupt: the FIFO of received frames exceeds its level.
const RX_LEVEL: u32 = 1 << 3;
const SOFT_RESET: u32 = 1 << 0;
/// Sends, also if the status of earlier frames was not read.
const TX_ON: u32 = 1 << 2 | 1 << 1;
/// Fast-forwards over the rest of a received frame.
const RX_FAST_FORWARD: u32 = 1 << 31;
const RX_ERROR: u32 = 1 << 15;
const TX_FIRST_AND_LAST: u32 = 0b11 << 12;

/// Indices of the registers of the MAC.
const MAC_CONTROL: u32 = 1;
const MAC_ADDRESS_HIGH: u32 = 2;
const MAC_ADDRESS_LOW: u32 = 3;
/// Receives and sends, full duplex, and pads short frames.
const MAC_ON: u32 = 1 << 20 | 1 << 8 | 1 << 3 | 1 << 2;
const MAC_BUSY: u32 = 1 << 31;
const MAC_READ: u32 = 1 << 30;

/// The registers.
struct Port(usize);

impl Port {
    fn word(&self, register: Register) -> *mut u32 {
        core::ptr::with_exposed_provenance_mut::<u32>(self.0 + register as usize)
    }

    fn read(&self, register: Register) -> u32 {
        // SAFETY: `Lan9118::at` guarantees a controller there, which has each `Register`.
        unsafe { self.word(register).read_volatile() }
    }

    fn write(&mut self, register: Register, value: u32) {
        // SAFETY: as in `read`; `&mut self` is the only user.
        unsafe { self.word(register).write_volatile(value) }
    }

    fn wait_for_mac(&mut self) {
        while self.read(Register::MacCommand) & MAC_BUSY != 0 {}
    }

    fn read_mac(&mut self, index: u32) -> u32 {
        self.write(Register::MacCommand, MAC_BUSY | MAC_READ | index);
        self.wait_for_mac();
        self.read(Register::MacData)
    }

    fn write_mac(&mut self, index: u32, value: u32) {
        self.write(Register::MacData, value);
        self.write(Register::MacCommand, MAC_BUSY | index);
        self.wait_for_mac();
    }

    /// Whether the transmit FIFO has room for the longest frame and its two command words.
    fn has_room(&self) -> bool {
        self.read(Register::TxFifo) as u16 as usize >= BUFFER_LEN + 8
    }

    /// Sends a frame of at most [`MAX_FRAME_LEN`] bytes.
    fn send(&mut self, frame: &[u8]) {
        let len = frame.len() as u32;
        self.write(Register::TxData, TX_FIRST_AND_LAST | len);
        self.write(Register::TxData, len);
        for word in frame.chunks(4) {
            let mut bytes = [0; 4];
            bytes[..word.len()].copy_from_slice(word);
            self.write(Register::TxData, u32::from_le_bytes(bytes));
        }
    }
}

/// The controller, with a buffer for one frame in each direction. The others are in its FIFOs.
pub struct Lan9118 {
    port: Port,
    rx: [u8; BUFFER_LEN],
    tx: [u8; BUFFER_LEN],
    /// Its MAC address.
    address: [u8; 6],
}

impl Lan9118 {
    /// Resets the controller and starts to receive.
    ///
    /// # Safety
    ///
    /// `base` must be the address of a LAN9118, and nothing else may use it.
    pub(crate) unsafe fn at(base: usize) -> Self {
        let mut port = Port(base);
        port.write(Register::HwConfig, SOFT_RESET);
        while port.read(Register::HwConfig) & SOFT_RESET != 0 {}
        port.write(Register::FifoLevels, 0);
        port.write(Register::TxConfig, TX_ON);
        let low = port.read_mac(MAC_ADDRESS_LOW).to_le_bytes();
        let high = port.read_mac(MAC_ADDRESS_HIGH).to_le_bytes();
        port.write_mac(MAC_CONTROL, MAC_ON);
        let address = [low[0], low[1], low[2], low[3], high[0], high[1]];
        Self { port, rx: [0; BUFFER_LEN], tx: [0; BUFFER_LEN], address }
    }

    /// Enables the interrupt [`Interrupt::ETHERNET`], which is raised while received frames are in the FIFO.
    pub fn listen(&mut self) {
        self.port.write(Register::IrqConfig, IRQ_ENABLED);
        self.port.write(Register::IntEnable, RX_LEVEL);
        self.unmask();
    }

    fn unmask(&mut self) {
        // SAFETY: no critical section here relies on masking a single interrupt.
        unsafe { NVIC::unmask(Interrupt::ETHERNET) };
    }

    /// Clears the interrupt while it is masked, or handlers are. Frames that arrive later raise it again, so receive after this call.
    pub fn acknowledge(&mut self) {
        // In this order: the interrupt of a frame that arrives in between must not be cleared in the processor only.
        NVIC::unpend(Interrupt::ETHERNET);
        self.port.write(Register::IntStatus, RX_LEVEL);
    }

    /// Returns the MAC address.
    pub fn address(&self) -> [u8; 6] {
        self.address
    }

    /// Moves the next received frame from the FIFO into the buffer, and returns its length. Frames with errors, and longer ones,
    /// are dropped.
    fn receive(&mut self) -> Option<usize> {
        let Self { port, rx, .. } = self;
        while (port.read(Register::RxFifo) >> 16) as u8 > 0 {
            let status = port.read(Register::RxStatus);
            let len = (status >> 16 & 0x3FFF) as usize;
            let is_good = status & RX_ERROR == 0 && (FCS_LEN..=MAX_FRAME_LEN + FCS_LEN).contains(&len);
            if !is_good {
                port.write(Register::RxDatapath, RX_FAST_FORWARD);
                while port.read(Register::RxDatapath) & RX_FAST_FORWARD != 0 {}
                continue;
            }
            for at in (0..len).step_by(4) {
                let bytes = port.read(Register::RxData).to_le_bytes();
                // The last word may be only the checksum.
                if let Some(cell) = rx.get_mut(at..at + 4) {
                    cell.copy_from_slice(&bytes);
                }
            }
            return Some(len - FCS_LEN);
        }
        None
    }
}

/// A frame that was received: a token of the network stack.
pub struct RxToken<'a>(&'a mut [u8]);

impl RxToken<'_> {
    fn read<R>(self, read: impl FnOnce(&mut [u8]) -> R) -> R {
        read(self.0)
    }
}

/// The permission to send a frame: a token of the network stack.
pub struct TxToken<'a> {
    port: &'a mut Port,
    buffer: &'a mut [u8; BUFFER_LEN],
}

impl TxToken<'_> {
    fn fill<R>(self, len: usize, fill: impl FnOnce(&mut [u8]) -> R) -> R {
        // The network stack keeps to the MTU.
        let frame = &mut self.buffer[..len];
        let result = fill(frame);
        self.port.send(frame);
        result
    }
}

impl Lan9118 {
    fn tokens(&mut self) -> Option<(RxToken<'_>, TxToken<'_>)> {
        // The answer to a frame needs room, too.
        let len = if self.port.has_room() { self.receive()? } else { return None };
        let Self { port, rx, tx, .. } = self;
        Some((RxToken(&mut rx[..len]), TxToken { port, buffer: tx }))
    }

    fn tx_token(&mut self) -> Option<TxToken<'_>> {
        let Self { port, tx, .. } = self;
        port.has_room().then_some(TxToken { port, buffer: tx })
    }
}

/// For smoltcp.
mod plain {

    use smoltcp::phy::{Device, DeviceCapabilities, Medium};
    use smoltcp::time::Instant;

    use super::{Lan9118, MAX_FRAME_LEN, RxToken, TxToken};

    impl smoltcp::phy::RxToken for RxToken<'_> {
        fn consume<R, F: FnOnce(&[u8]) -> R>(self, read: F) -> R {
            self.read(|frame| read(frame))
        }
    }

    impl smoltcp::phy::TxToken for TxToken<'_> {
        fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
            self.fill(len, fill)
        }
    }

    impl Device for Lan9118 {
        type RxToken<'a> = RxToken<'a>;
        type TxToken<'a> = TxToken<'a>;

        fn receive(&mut self, _: Instant) -> Option<(RxToken<'_>, TxToken<'_>)> {
            self.tokens()
        }

        fn transmit(&mut self, _: Instant) -> Option<TxToken<'_>> {
            self.tx_token()
        }

        fn capabilities(&self) -> DeviceCapabilities {
            let mut capabilities = DeviceCapabilities::default();
            capabilities.medium = Medium::Ethernet;
            capabilities.max_transmission_unit = MAX_FRAME_LEN;
            capabilities
        }
    }
}

/// Wakes the task of embassy-net.
static RECEIVED: AtomicWaker = AtomicWaker::new();

/// Handles the interrupt for embassy-net: wakes its task, which takes the frames and unmasks the interrupt again.
pub fn on_interrupt() {
    NVIC::mask(Interrupt::ETHERNET);
    RECEIVED.wake();
}

/// The most frames that embassy-net gets in a row. It receives until there are none: without a limit, other tasks would starve under
/// a flood.
const IN_A_ROW: u8 = 8;

/// The controller as a driver of embassy-net.
pub struct EmbassyDriver {
    controller: Lan9118,
    /// Frames that embassy-net got in a row.
    frames: u8,
}

impl EmbassyDriver {
    /// Wraps a controller whose interrupt calls [`on_interrupt`].
    pub fn new(mut controller: Lan9118) -> Self {
        controller.listen();
        Self { controller, frames: 0 }
    }
}

/// For embassy-net.
mod embassy {
    use core::task::Context;

    use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};

    use super::{EmbassyDriver, IN_A_ROW, MAX_FRAME_LEN, RECEIVED, RxToken, TxToken};

    impl embassy_net_driver::RxToken for RxToken<'_> {
        fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, read: F) -> R {
            self.read(read)
        }
    }

    impl embassy_net_driver::TxToken for TxToken<'_> {
        fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
            self.fill(len, fill)
        }
    }

    impl Driver for EmbassyDriver {
        type RxToken<'a> = RxToken<'a>;
        type TxToken<'a> = TxToken<'a>;

        fn receive(&mut self, context: &mut Context<'_>) -> Option<(RxToken<'_>, TxToken<'_>)> {
            let Self { controller, frames } = self;
            if *frames == IN_A_ROW {
                *frames = 0;
                context.waker().wake_by_ref();
                return None;
            }
            RECEIVED.register(context.waker());
            controller.acknowledge();
            // Frames that arrive from here on raise the interrupt again.
            controller.unmask();
            let tokens = controller.tokens();
            *frames = if tokens.is_some() { *frames + 1 } else { 0 };
            tokens
        }

        fn transmit(&mut self, context: &mut Context<'_>) -> Option<TxToken<'_>> {
            RECEIVED.register(context.waker());
            self.controller.tx_token()
        }

        fn link_state(&mut self, _: &mut Context<'_>) -> LinkState {
            // The emulated cable is always plugged in.
            LinkState::Up
        }

        fn capabilities(&self) -> Capabilities {
            let mut capabilities = Capabilities::default();
            capabilities.max_transmission_unit = MAX_FRAME_LEN;
            capabilities
        }

        fn hardware_address(&self) -> HardwareAddress {
            HardwareAddress::Ethernet(self.controller.address())
        }
    }
}
