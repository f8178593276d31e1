// Runs a firmware for the RP2040 in rp2040js. UART0 and the port of its USB are TCP servers. A third one takes commands, with the
// syntax of QEMU's QMP:
//
// | command | |
// |---|---|
// | `stop`, `cont`, `system_reset` | as in QEMU; a reset keeps the flash, and drops what the lines carry |
// | `cut-in-flash` | resets in the middle of a write of a page or an erase of a sector, after `after` more of them, and stops; `null` revokes it |
// | `query-counters` | in ns: `awake`, how long the processor did not sleep; `passed`, the time; `longest`, between two sleeps since the last query |
// | | `writes`: of pages and sectors since the last reset; `resets`: how many |
//
// Time passes as on the hardware, or slower if this machine is too slow. With `--catch-up` it is not slower on average: an emulator that
// was late, because of other programs, runs faster afterwards. An instruction takes as long as on a Cortex-M0+ whose code hits the cache.
//
// `--baud` is the rate of the far end of UART0, by default the same as the firmware's.
//
// It prints "ready" after the first second of the firmware, when it is no longer late.

import { readFileSync } from 'node:fs';
import { createServer } from 'node:net';
import { parseArgs } from 'node:util';

import { RP2040 } from 'rp2040js';

import { PowerCut, Rom, XipControl } from './rom.mjs';
import { Uart } from './uart.mjs';
import { UsbHost } from './usb.mjs';

// Upper bits of addresses.
const UART0 = 0x40034;
const XIP_CTRL = 0x14000;
// The code runs in slices of this emulated time, and the sockets between them.
const SLICE_NANOS = 2e6;
// An emulator that is later than this does not catch up. The second value is that of `--catch-up`.
const LATE_NANOS = [20e6, 2e9];
// The shortest sleep of this program.
const NAP_NANOS = 1e6;
// In its first second, this program is compiled, and late.
const START_NANOS = 1e9;
// Bytes that a line holds before TCP holds the rest.
const LINE_LEN = 2048;

const { values: options } = parseArgs({
  options: {
    firmware: { type: 'string' },
    uart: { type: 'string' },
    usb: { type: 'string' },
    control: { type: 'string' },
    baud: { type: 'string' },
    'catch-up': { type: 'boolean', default: false },
  },
});

/** Writes the segments of an ELF file into the flash. */
function load(elf, flash) {
  const file = new DataView(elf.buffer, elf.byteOffset, elf.byteLength);
  const [start, size, count] = [file.getUint32(28, true), file.getUint16(42, true), file.getUint16(44, true)];
  for (let header = start; header < start + size * count; header += size) {
    const [kind, offset, , address, len] = [0, 4, 8, 12, 16].map((field) => file.getUint32(header + field, true));
    if (kind === 1 && len > 0) flash.set(elf.subarray(offset, offset + len), address & 0xffffff);
  }
}

/** A TCP server with one client at a time. */
class Port {
  constructor(port, onData, onOpen = () => {}) {
    this.server = createServer((socket) => {
      this.socket?.destroy();
      this.socket = socket.setNoDelay(true);
      onOpen(true);
      socket.on('data', (data) => socket === this.socket && onData(data));
      socket.on('error', () => {});
      socket.on('close', () => {
        if (socket !== this.socket) return;
        this.socket = undefined;
        onOpen(false);
      });
    });
    this.isListening = new Promise((listens) => this.server.listen(Number(port), '127.0.0.1', listens));
  }

  write(data) {
    this.socket?.write(data);
  }

  /** Takes no more from the client while a line is full. */
  limit(isFull) {
    if (isFull) this.socket?.pause();
    else this.socket?.resume();
  }
}

class Board {
  constructor() {
    const flash = new Uint8Array(2 * 1024 * 1024).fill(0xff);
    load(readFileSync(options.firmware), flash);
    this.isStopped = false;
    this.cutAfter = null;
    this.resets = 0;
    this.uartPort = new Port(options.uart, (data) => this.uart.feed(data));
    this.usbPort = new Port(options.usb, (data) => this.usb.feed(data), (isOpen) => this.usb.setOpen(isOpen));
    this.control = new Port(
      options.control,
      (data) => this.commands(data),
      (isOpen) => isOpen && this.say({ QMP: {} }),
    );
    this.reset(flash);
  }

  reset(flash) {
    const chip = new RP2040();
    const refuse = (name, message) => {
      throw new Error(`${name}: ${message}`);
    };
    const warn = (name, message) => {
      if (name === 'RP2040' || name === 'CortexM0Core') refuse(name, message);
    };
    chip.logger = { debug() {}, info() {}, warn, error: refuse };
    chip.flash.set(flash);
    const { core } = chip;
    // A masked interrupt ends WFI too, and is not taken: `run` wakes the processor.
    core.setInterrupt = (irq, isSet) => {
      if (isSet) {
        core.pendingInterrupts |= 1 << irq;
        core.interruptsUpdated = true;
      } else {
        core.pendingInterrupts &= ~(1 << irq);
      }
    };
    this.uart = new Uart(chip, Number(options.baud ?? 0), (byte) => this.uartPort.write(Uint8Array.of(byte)));
    chip.peripherals[UART0] = this.uart;
    chip.peripherals[XIP_CTRL] = new XipControl();
    this.usb = new UsbHost(chip, (data) => this.usbPort.write(data));
    this.usb.setOpen(this.usbPort.socket !== undefined);
    new Rom(chip, () => this.cutPower()).boot();
    this.chip = chip;
    this.asleep = this.writes = this.longest = this.passBegan = 0;
    this.ahead = undefined;
  }

  /** Resets the chip. */
  restart() {
    this.resets += 1;
    this.reset(this.chip.flash);
    this.say({ event: 'RESET' });
  }

  /** Called in the middle of each page or sector that is written. */
  cutPower() {
    this.writes += 1;
    if (this.cutAfter === null) return;
    this.cutAfter -= 1;
    if (this.cutAfter < 0) {
      this.cutAfter = null;
      throw new PowerCut();
    }
  }

  /** Runs until this time. */
  run(until) {
    const { chip } = this;
    const { clock, core } = chip;
    while (clock.nanos < until) {
      if (!core.waiting) {
        clock.tick((core.executeInstruction() * 1e9) / chip.clkSys);
        continue;
      }
      this.longest = Math.max(this.longest, clock.nanos - this.passBegan);
      if (core.pendingInterrupts & core.enabledInterrupts || core.pendingPendSV || core.pendingSystick) {
        core.waiting = false;
      } else {
        const alarm = clock.nextAlarm ? clock.nextAlarm.nanos : until;
        const nanos = Math.max(Math.min(alarm, until) - clock.nanos, 1);
        this.asleep += nanos;
        clock.tick(nanos);
      }
      this.passBegan = clock.nanos;
    }
  }

  /** The time that the clock should show. */
  due() {
    const wall = performance.now() * 1e6;
    this.ahead ??= this.chip.clock.nanos - wall;
    return wall + this.ahead;
  }

  slice() {
    if (!this.isStopped) {
      const now = this.chip.clock.nanos;
      const due = this.due();
      if (now < due - LATE_NANOS[Number(options['catch-up'])]) this.ahead = undefined;
      try {
        this.run(Math.min(now + SLICE_NANOS, due));
      } catch (error) {
        if (!(error instanceof PowerCut)) throw error;
        this.restart();
        this.isStopped = true;
        this.say({ event: 'STOP' });
      }
      this.uartPort.limit(this.uart.line.length > LINE_LEN);
      this.usbPort.limit(this.usb.toSend.length > LINE_LEN);
    }
  }

  say(message) {
    this.control.write(`${JSON.stringify(message)}\n`);
  }

  commands(data) {
    for (const line of data.toString().split('\n').filter(Boolean)) {
      const command = JSON.parse(line);
      this.say({ return: this.execute(command.execute, command.arguments) ?? {} });
    }
  }

  execute(command, args) {
    switch (command) {
      case 'qmp_capabilities':
        return;
      case 'stop':
        this.isStopped = true;
        this.say({ event: 'STOP' });
        return;
      case 'cont':
        this.isStopped = false;
        this.ahead = undefined;
        this.say({ event: 'RESUME' });
        return;
      case 'system_reset':
        this.restart();
        return;
      case 'cut-in-flash':
        this.cutAfter = args.after;
        return;
      case 'query-counters': {
        const passed = this.chip.clock.nanos;
        const { longest, writes, resets } = this;
        const counters = { awake: passed - this.asleep, passed, longest, writes, resets };
        this.longest = 0;
        return counters;
      }
      default:
        throw new Error(`unknown command ${command}`);
    }
  }
}

const board = new Board();
let isReady = false;
// As fast as possible while the emulator is late; else it naps.
const step = () => {
  board.slice();
  const { nanos } = board.chip.clock;
  const isLate = !board.isStopped && nanos < board.due() - NAP_NANOS;
  if (!isReady && !isLate && nanos > START_NANOS) {
    isReady = true;
    console.log('ready');
  }
  if (isLate) setImmediate(step);
  else setTimeout(step, NAP_NANOS / 1e6);
};
await Promise.all([board.uartPort, board.usbPort, board.control].map((port) => port.isListening));
step();
