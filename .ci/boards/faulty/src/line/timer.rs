//! `timer`: a timer sends the heartbeats, with sequence numbers of their own.

use embedded_io::Write;
use mavstack::dialect::{Heartbeat, MavAutopilot, MavState};
use mavstack::frame::{Version, encode};
use mavstack::io::SerialQueues;
use mavstack::{Address, Duration, Instant, StackOf};
use mavstack_rover::{CONFIG, HOLD, Mavlink, Rover};
use rp2040_hal::pac::{DMA, RESETS};

use crate::TELEM;
use crate::board::Uart;

/// Long enough for whole frames: a heartbeat comes between two of them.
static QUEUES: SerialQueues<256, 1_024> = SerialQueues::new();

/// The link's UART, with its queues.
pub struct Line {
    uart: Uart,
    due: Instant,
    sequence: u8,
}

impl Line {
    pub fn new(uart: Uart, _: DMA, _: &mut RESETS) -> Self {
        Self { uart, due: Instant::ZERO, sequence: 0 }
    }

    pub fn poll(&mut self, now: Instant, stack: &mut StackOf<Mavlink>, rover: &mut Rover) {
        self.receive();
        let _ = stack.poll_link(now, TELEM, &mut QUEUES.loop_end(), rover);
        if now >= self.due {
            self.due = now + Duration::from_secs(1);
            self.queue_heartbeat();
        }
        self.send();
    }

    fn queue_heartbeat(&mut self) {
        let heartbeat = Heartbeat {
            r#type: CONFIG.r#type,
            autopilot: MavAutopilot::GENERIC,
            system_status: MavState::STANDBY,
            custom_mode: HOLD,
            mavlink_version: 3,
            ..Heartbeat::default()
        };
        let mut frame = [0; 64];
        let len = encode(&heartbeat, Version::V2, Address::new(1, 1), self.sequence, &mut frame).unwrap_or(0);
        let _ = QUEUES.loop_end().write(&frame[..len]);
        self.sequence = self.sequence.wrapping_add(1);
    }

    fn receive(&mut self) {
        let mut bytes = [0; 32];
        while let Ok(len) = self.uart.read_raw(&mut bytes) {
            QUEUES.interrupt_end().received_all(&bytes[..len]);
        }
    }

    fn send(&mut self) {
        while self.uart.uart_is_writable() {
            let Some(byte) = QUEUES.interrupt_end().next_to_send() else { return };
            let _ = self.uart.write_raw(&[byte]);
        }
    }
}
