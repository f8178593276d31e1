//! The UART with DMA in both directions, as in `examples/boards/rp2040-dma`: a long ring holds all that arrives between two polls.
//!
//! `dma-cut`: the bytes are handed over when the line is idle, from a short buffer. What does not fit until then is cut.

use mavstack::{Instant, StackOf};
use mavstack_rover::{Mavlink, Rover};
use rp2040_hal::dma::DMAExt;
use rp2040_hal::gpio::bank0::{Gpio0, Gpio1};
use rp2040_hal::gpio::{FunctionUart, Pin, PullDown};
use rp2040_hal::pac::{DMA, RESETS, UART0};
use rp2040_hal::uart::{Reader, Writer};

use crate::TELEM;
use crate::board::Uart;
use crate::dma::{Receiver, Transmitter};

type Pins = (Pin<Gpio0, FunctionUart, PullDown>, Pin<Gpio1, FunctionUart, PullDown>);

/// The link's UART, with its DMA.
pub struct Line {
    receiver: Receiver<Reader<UART0, Pins>>,
    transmitter: Transmitter<Writer<UART0, Pins>>,
    cut: Buffer,
}

/// The buffer that is too short.
struct Buffer {
    bytes: [u8; 64],
    len: usize,
}

impl Buffer {
    /// Appends what fits.
    fn append(&mut self, bytes: &[u8]) {
        let room = &mut self.bytes[self.len..];
        let fits = bytes.len().min(room.len());
        room[..fits].copy_from_slice(&bytes[..fits]);
        self.len += fits;
    }
}

impl Line {
    pub fn new(uart: Uart, dma: DMA, resets: &mut RESETS) -> Self {
        let (reader, writer) = uart.split();
        let channels = dma.split(resets);
        Self {
            receiver: Receiver::new(reader, channels.ch0, channels.ch1),
            transmitter: Transmitter::new(writer, channels.ch2),
            cut: Buffer { bytes: [0; 64], len: 0 },
        }
    }

    pub fn poll(&mut self, now: Instant, stack: &mut StackOf<Mavlink>, rover: &mut Rover) {
        if cfg!(feature = "dma-cut") {
            self.receive_cut(now, stack, rover);
        } else {
            let _ = self.receiver.poll(stack.receiver(now, TELEM, rover));
        }
        while self.transmitter.is_idle() {
            let len = self.transmitter.append(stack.transmit(now, TELEM, rover));
            if len == 0 {
                break;
            }
            stack.transmitted(TELEM, len);
        }
        self.transmitter.start();
    }

    fn receive_cut(&mut self, now: Instant, stack: &mut StackOf<Mavlink>, rover: &mut Rover) {
        let mut is_idle = true;
        let _ = self.receiver.poll(|bytes| {
            is_idle &= bytes.is_empty();
            self.cut.append(bytes);
            bytes.len()
        });
        if is_idle {
            let _ = stack.receive(now, TELEM, &self.cut.bytes[..self.cut.len], rover);
            self.cut.len = 0;
        }
    }
}
