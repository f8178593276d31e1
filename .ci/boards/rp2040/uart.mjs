// A UART as the RP2040 has it (Arm's PL011), at the speed of its line. The one of rp2040js sends at once, and interrupts too often.
//
// If the far end has another rate, a receiver samples bits too early or too late, and the wrong one if that is by half a bit. The noise
// of the edges is such that a difference of 2 % is harmless, and 3.5 % damages a few bytes of 1,000.
//
// Left out: flow control, breaks, parity errors, and the modem's signals.

const [DR, RSR, FR, IBRD, FBRD, LCR_H, CR, IFLS, IMSC, RIS, MIS, ICR, DMACR] = [
  0x00, 0x04, 0x18, 0x24, 0x28, 0x2c, 0x30, 0x34, 0x38, 0x3c, 0x40, 0x44, 0x48,
];
const FLAG = { BUSY: 1 << 3, RX_EMPTY: 1 << 4, TX_FULL: 1 << 5, RX_FULL: 1 << 6, TX_EMPTY: 1 << 7 };
const INTERRUPT = { RX: 1 << 4, TX: 1 << 5, TIMEOUT: 1 << 6, OVERRUN: 1 << 10 };
const OVERRUN_IN_DATA = 1 << 11;
const FRAMING_ERROR_IN_DATA = 1 << 8;
const FIFOS_ENABLED = 1 << 4;
const ENABLED = 1;
const FIFO_LEN = 32;
// Bits of a byte on the line, with its start and stop bits.
const BITS = 10;
// The standard deviation of a sample, in bits.
const NOISE = 0.06;
// The FIFO's levels by which it interrupts, by the field of UARTIFLS.
const LEVELS = [4, 8, 16, 24, 28];
const IRQ = 20;
// Requests to the DMA: their numbers, and the bits that enable them.
const REQUEST = { TX: 20, RX: 21 };
const REQUESTS_ENABLED = { RX: 1, TX: 2 };

/** Returns a number with normal distribution. */
const gaussian = () => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());

/** What samples the bytes of a line whose sender may have another rate. */
class Receiver {
  constructor() {
    this.isMissed = false;
  }

  /** Returns a byte as it is sampled, with an error flag, or undefined; `next` is the byte behind it. `ratio` is the rate of the sender
   * against that of the receiver. */
  sample(byte, next, ratio) {
    if (this.isMissed) {
      this.isMissed = false;
      return undefined;
    }
    // Start bits are 0. Stop bits are 1, and so is an idle line.
    const bits = (byte) => 0x200 | (byte << 1);
    const line = bits(byte) | ((next === undefined ? 0x3ff : bits(next)) << BITS);
    let sampled = 0;
    for (let bit = 0; bit < BITS; bit++) {
      const at = (bit + 0.5) * ratio + NOISE * gaussian();
      sampled |= ((line >> Math.max(Math.floor(at), 0)) & 1) << bit;
    }
    const isFramed = sampled >> (BITS - 1) === 1;
    // Where it expected the stop bit, the next start bit has begun: that byte is lost.
    this.isMissed = !isFramed && ratio > 1;
    return ((sampled >> 1) & 0xff) | (isFramed ? 0 : FRAMING_ERROR_IN_DATA);
  }
}

export class Uart {
  /** `baud` is the rate of the far end; 0 if it is this one's. */
  constructor(chip, baud, onByte) {
    this.chip = chip;
    this.baud = baud;
    this.near = new Receiver();
    this.far = new Receiver();
    this.onByte = onByte;
    this.line = [];
    this.received = [];
    this.toSend = [];
    this.isSending = false;
    this.isOverrun = false;
    // UARTCR enables both directions after a reset; UARTIFLS is at half of the FIFO.
    this.registers = { [CR]: 0x300, [IFLS]: 0x12, [IBRD]: 0, [FBRD]: 0, [LCR_H]: 0, [IMSC]: 0, [DMACR]: 0 };
    this.raw = 0;
    this.sendAlarm = chip.clock.createAlarm(() => this.sent());
    this.receiveAlarm = chip.clock.createAlarm(() => this.receive());
    this.timeoutAlarm = chip.clock.createAlarm(() => {
      if (this.received.length > 0) this.raise(INTERRUPT.TIMEOUT);
    });
    this.isReceiving = false;
  }

  get bitNanos() {
    const divider = this.registers[IBRD] + this.registers[FBRD] / 64;
    return (16e9 * divider) / this.chip.clkPeri;
  }

  /** The rate of the far end against this one's. */
  get ratio() {
    return this.baud === 0 ? 1 : (this.baud * this.bitNanos) / 1e9;
  }

  get depth() {
    return this.registers[LCR_H] & FIFOS_ENABLED ? FIFO_LEN : 1;
  }

  level(shift) {
    return this.depth === 1 ? 1 : LEVELS[(this.registers[IFLS] >> shift) & 7];
  }

  raise(interrupts) {
    this.raw |= interrupts;
    this.update();
  }

  update() {
    this.chip.setInterrupt(IRQ, (this.raw & this.registers[IMSC]) !== 0);
    this.request('RX', this.received.length > 0);
    this.request('TX', this.toSend.length < this.depth);
  }

  /** Asks the DMA for transfers as long as the FIFO has a byte, or room for one. */
  request(direction, isReady) {
    const { dma } = this.chip;
    if (isReady && this.registers[DMACR] & REQUESTS_ENABLED[direction]) dma.setDREQ(REQUEST[direction]);
    else dma.clearDREQ(REQUEST[direction]);
  }

  /** Puts bytes onto the line, behind those that are still on it. */
  feed(bytes) {
    for (const byte of bytes) this.line.push(byte);
    this.listen();
  }

  listen() {
    if (this.isReceiving || this.line.length === 0 || !(this.registers[CR] & ENABLED)) return;
    this.isReceiving = true;
    this.receiveAlarm.schedule(BITS * this.bitNanos);
  }

  receive() {
    const byte = this.near.sample(this.line.shift(), this.line[0], this.ratio);
    this.isReceiving = false;
    this.listen();
    if (byte === undefined) return;
    if (this.received.length < this.depth) {
      this.received.push(byte | (this.isOverrun ? OVERRUN_IN_DATA : 0));
      this.isOverrun = false;
    } else {
      this.isOverrun = true;
      this.raw |= INTERRUPT.OVERRUN;
    }
    if (this.received.length >= this.level(3)) this.raw |= INTERRUPT.RX;
    this.timeoutAlarm.schedule(32 * this.bitNanos);
    this.update();
  }

  send(byte) {
    if (this.toSend.length >= this.depth) return;
    this.toSend.push(byte);
    if (this.toSend.length > this.txLevel) this.raw &= ~INTERRUPT.TX;
    this.update();
    if (!this.isSending) this.shift();
  }

  get txLevel() {
    return this.depth === 1 ? 0 : this.level(0);
  }

  /** Moves a byte from the FIFO to the line. */
  shift() {
    this.sending = this.toSend.shift();
    this.isSending = this.sending !== undefined;
    if (!this.isSending) return;
    // The interrupt is raised by a transition through the level.
    if (this.toSend.length === this.txLevel) this.raw |= INTERRUPT.TX;
    this.update();
    this.sendAlarm.schedule(BITS * this.bitNanos);
  }

  sent() {
    // As an adapter does, it hands over bytes with errors, too.
    const byte = this.far.sample(this.sending, this.toSend[0], 1 / this.ratio);
    if (byte !== undefined) this.onByte(byte & 0xff);
    this.shift();
  }

  readUint32(offset) {
    switch (offset) {
      case DR: {
        const value = this.received.shift() ?? 0;
        if (this.received.length < this.level(3)) this.raw &= ~INTERRUPT.RX;
        if (this.received.length === 0) this.raw &= ~INTERRUPT.TIMEOUT;
        this.update();
        return value;
      }
      case RSR:
        return 0;
      case FR:
        return (
          (this.isSending ? FLAG.BUSY : 0) |
          (this.received.length === 0 ? FLAG.RX_EMPTY : 0) |
          (this.toSend.length >= this.depth ? FLAG.TX_FULL : 0) |
          (this.received.length >= this.depth ? FLAG.RX_FULL : 0) |
          (this.toSend.length === 0 ? FLAG.TX_EMPTY : 0)
        );
      case RIS:
        return this.raw;
      case MIS:
        return this.raw & this.registers[IMSC];
      default:
        return this.registers[offset] ?? 0;
    }
  }

  writeUint32Atomic(offset, value, kind) {
    const old = kind === 0 ? 0 : this.readUint32(offset);
    this.writeUint32(offset, [value, old ^ value, old | value, old & ~value][kind]);
  }

  writeUint32(offset, value) {
    if (offset === DR) {
      this.send(value & 0xff);
    } else if (offset === ICR) {
      this.raw &= ~value;
      this.update();
    } else {
      this.registers[offset] = value;
      this.update();
      this.listen();
    }
  }
}
