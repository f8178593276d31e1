//! A UART with DMA: received bytes go to a ring, and bytes to send come from a buffer. No interrupt is used.
//!
//! `rp2040-hal` has no DMA ring, so this file uses the registers of the channels (RP2040 datasheet, section 2.5).

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use mavstack::io::{CircularReader, SerialError, queue_len};
use rp2040_hal::dma::{CH0, CH1, CH2, Channel, ReadTarget, SingleChannel, WriteTarget};

use crate::{BAUD, ERASE, PERIOD};

/// A power of two, at most 32,768. The ring holds the bytes received during the longest erase, rounded up: half as many as a queue,
/// which has room for two periods.
const RING: usize = 8192;
const _: () =
    assert!(RING >= queue_len(BAUD, ERASE) / 2, "the ring overflows during the longest erase: make it longer");
const _: () = assert!(align_of::<Ring>() == RING, "the ring's alignment is not its length");

/// The DMA keeps the upper bits of the address, so the ring begins at a multiple of its length.
#[repr(align(8192))]
struct Ring([AtomicU8; RING]);

/// Written by the DMA only. `memory.x` reserves its place: elsewhere, its alignment would leave up to 8 KiB of RAM unused.
#[allow(unsafe_code, reason = "a section that contains nothing else")]
#[unsafe(link_section = ".ring")]
static RECEIVED: Ring = Ring([const { AtomicU8::new(0) }; RING]);

/// The number of bytes in a run. The channel cannot transfer forever: after a run, another channel restarts it. Any multiple of the
/// ring's length works, if the loop runs before this many bytes are received: within 2.8 s. A short run ends often, so tests cover it.
const RUN: u32 = 4 * RING as u32;
/// The value that the other channel writes to the counter. It is in RAM, because the flash cannot be read during an erase.
static RESTART: AtomicU32 = AtomicU32::new(RUN);

/// The request signal of unpaced transfers.
const UNPACED: u8 = 0x3F;

/// Room for two periods, like a queue, so that the line stays busy. A longer buffer only adds latency.
const TO_SEND: usize = queue_len(BAUD, PERIOD);
/// Read by the DMA while it sends, written by the loop while the DMA is idle.
static SENDING: [AtomicU8; TO_SEND] = [const { AtomicU8::new(0) }; TO_SEND];

/// The receiving half of a UART, whose bytes a DMA channel writes to the ring.
pub struct Receiver<R> {
    _uart: R,
    channel: Channel<CH0>,
    _restart: Channel<CH1>,
    reader: CircularReader,
    /// The counter at the last read, and the laps of the previous runs.
    left: u32,
    laps: u32,
}

impl<R: ReadTarget<ReceivedWord = u8>> Receiver<R> {
    /// Starts receiving.
    pub fn new(uart: R, channel: Channel<CH0>, restart: Channel<CH1>) -> Self {
        let (from, _) = uart.rx_address_count();
        let registers = channel.ch();
        // SAFETY: the DMA writes to `RECEIVED` only, and keeps doing so.
        #[allow(unsafe_code, reason = "addresses for the DMA")]
        unsafe {
            // Its transfer writes the counter, which starts the channel again. The write address has wrapped to the ring's start.
            let other = restart.ch();
            other.ch_al1_ctrl().write(|w| {
                let w = w.data_size().size_word().treq_sel().bits(UNPACED);
                w.chain_to().bits(restart.id()).irq_quiet().set_bit().en().set_bit()
            });
            other.ch_read_addr().write(|w| w.bits(RESTART.as_ptr() as u32));
            other.ch_write_addr().write(|w| w.bits(registers.ch_al1_trans_count_trig().as_ptr() as u32));
            other.ch_trans_count().write(|w| w.bits(1));

            registers.ch_al1_ctrl().write(|w| {
                let w = w.data_size().size_byte().incr_write().set_bit();
                let w = w.ring_sel().set_bit().ring_size().bits(RING.trailing_zeros() as u8);
                let w = w.treq_sel().bits(R::rx_treq().unwrap_or(UNPACED));
                w.chain_to().bits(restart.id()).irq_quiet().set_bit().en().set_bit()
            });
            registers.ch_read_addr().write(|w| w.bits(from));
            registers.ch_write_addr().write(|w| w.bits(RECEIVED.0.as_ptr() as u32));
            registers.ch_al1_trans_count_trig().write(|w| w.bits(RUN));
        }
        Self { _uart: uart, channel, _restart: restart, reader: CircularReader::new(), left: RUN, laps: 0 }
    }

    /// Passes the received bytes to `receive`, which returns the number of bytes that it took.
    pub fn poll(&mut self, receive: impl FnMut(&[u8]) -> usize) -> Result<(), SerialError> {
        // Laps and position come from one counter, so neither can be older than the other.
        let left = self.channel.ch().ch_trans_count().read().bits();
        // The bytes were written before they were counted.
        cortex_m::asm::dmb();
        if left > self.left {
            self.laps = self.laps.wrapping_add(RUN / RING as u32);
        }
        self.left = left;
        let written = RUN - left;
        let laps = self.laps.wrapping_add(written / RING as u32);
        self.reader.poll(&RECEIVED.0, laps, written as usize % RING, receive)
    }
}

/// The sending half of a UART, to which a DMA channel copies the bytes of a buffer.
pub struct Transmitter<W> {
    _uart: W,
    channel: Channel<CH2>,
    /// The bytes in the buffer.
    len: usize,
}

impl<W: WriteTarget<TransmittedWord = u8>> Transmitter<W> {
    /// Prepares the channel. Nothing is sent yet.
    pub fn new(mut uart: W, channel: Channel<CH2>) -> Self {
        let (to, _) = uart.tx_address_count();
        let registers = channel.ch();
        // SAFETY: the DMA writes to the UART only, and reads `SENDING` only.
        #[allow(unsafe_code, reason = "addresses for the DMA")]
        unsafe {
            registers.ch_al1_ctrl().write(|w| {
                let w = w.data_size().size_byte().incr_read().set_bit();
                let w = w.treq_sel().bits(W::tx_treq().unwrap_or(UNPACED));
                w.chain_to().bits(channel.id()).irq_quiet().set_bit().en().set_bit()
            });
            registers.ch_write_addr().write(|w| w.bits(to));
        }
        Self { _uart: uart, channel, len: 0 }
    }

    /// Returns whether the DMA has copied all bytes, so that the buffer can be filled. The UART's FIFO then holds up to 32 bytes, so the
    /// line stays busy while the loop fills it.
    pub fn is_idle(&self) -> bool {
        !self.channel.ch().ch_al1_ctrl().read().busy().bit()
    }

    /// Appends bytes to the buffer while it is idle. Returns how many fit.
    pub fn append(&mut self, bytes: &[u8]) -> usize {
        let room = SENDING.get(self.len..).unwrap_or_default();
        for (to, byte) in room.iter().zip(bytes) {
            to.store(*byte, Ordering::Relaxed);
        }
        let taken = room.len().min(bytes.len());
        self.len += taken;
        taken
    }

    /// Sends the appended bytes.
    pub fn start(&mut self) {
        if self.len == 0 {
            return;
        }
        // The bytes are written before the DMA reads them.
        cortex_m::asm::dmb();
        let registers = self.channel.ch();
        // SAFETY: `len` bytes of `SENDING` are filled.
        #[allow(unsafe_code, reason = "addresses for the DMA")]
        unsafe {
            registers.ch_trans_count().write(|w| w.bits(self.len as u32));
            registers.ch_al3_read_addr_trig().write(|w| w.bits(SENDING.as_ptr() as u32));
        }
        self.len = 0;
    }
}
