// Stands in for the boot ROM, which cannot be distributed here: the functions of the RP2040 datasheet, section 2.8.3, that the HALs
// call. Each is an undefined instruction that the emulator carries out, and a return. Float results are those of IEEE 754.
//
// Durations are approximate: of float functions those of the ROM, of the flash the typical ones of the Pico's W25Q16JV.

const TABLES = 0x20;
const CODE = 0x400;
const UNDEFINED = 0xde00;
const BX_LR = 0x4770;
const BOOT2_LEN = 0x100;
const BOOT2_IN_RAM = 0x20041f00;
const SECTOR = 4096;
const PAGE = 256;
const XIP_STAT = 0x08;
const XIP_IDLE = 3;
const ERASE_NANOS = 45e6;
const PROGRAM_NANOS = 0.4e6;

/** The processor is reset in the middle of an operation of the flash. */
export class PowerCut extends Error {}

/** The controller of the execution from flash: no transfer of its own runs, and its FIFO is empty. */
export class XipControl {
  readUint32(offset) {
    return offset === XIP_STAT ? XIP_IDLE : 0;
  }

  writeUint32Atomic() {}
}

const bits = new DataView(new ArrayBuffer(8));

export class Rom {
  /** `cut()` is called in the middle of each page or sector, and may throw. */
  constructor(chip, cut) {
    this.chip = chip;
    this.core = chip.core;
    this.cut = cut;
    this.functions = [];
    const functions = {
      P3: () => this.result(this.arg(0).toString(2).replaceAll('0', '').length, 20),
      R3: () => this.result(parseInt([...this.arg(0).toString(2).padStart(32, '0')].reverse().join(''), 2), 20),
      L3: () => this.result(Math.clz32(this.arg(0)), 20),
      T3: () => this.result(this.arg(0) ? 31 - Math.clz32(this.arg(0) & -this.arg(0)) : 32, 20),
      MS: () => this.fill(),
      S4: () => this.fill(),
      MC: () => this.copy(),
      C4: () => this.copy(),
      IF: () => {},
      EX: () => {},
      RE: () => this.erase(),
      RP: () => this.program(),
      FC: () => {},
      CX: () => {},
    };
    // By index in the table `SF`.
    const floats = [];
    floats[0] = () => this.float((a, b) => a + b);
    floats[1] = () => this.float((a, b) => a - b);
    floats[2] = () => this.float((a, b) => a * b);
    floats[3] = () => this.float((a, b) => a / b);
    floats[6] = () => this.float(Math.sqrt);
    floats[7] = () => this.toInteger(-(2 ** 31), 2 ** 31 - 1);
    floats[9] = () => this.toInteger(0, 2 ** 32 - 1);
    floats[11] = () => this.fromInteger(this.arg(0) | 0);
    floats[13] = () => this.fromInteger(this.arg(0));
    floats[21] = () => this.result(Math.sign(this.floatArg(0) - this.floatArg(1)) || 0, 40);

    const rom = new DataView(chip.bootrom.buffer);
    let end = TABLES;
    const table = (entries, width) => {
      const start = end;
      for (const entry of entries) {
        rom[width === 2 ? 'setUint16' : 'setUint32'](end, entry, true);
        end += width;
      }
      return start;
    };
    const tag = (name) => name.charCodeAt(0) | (name.charCodeAt(1) << 8);
    const code = (run) => this.add(rom, run);
    const softFloat = table(Array.from({ length: 32 }, (_, index) => code(floats[index])), 4);
    const functionTable = table([...Object.entries(functions).flatMap(([name, run]) => [tag(name), code(run)]), 0], 2);
    const dataTable = table([tag('SF'), softFloat, 0], 2);
    // A version that has the functions of `SF` from 0x54 on.
    rom.setUint32(0x10, 0x02_01_75_4d, true);
    rom.setUint16(0x14, functionTable, true);
    rom.setUint16(0x16, dataTable, true);
    rom.setUint16(0x18, code(() => this.lookUp()), true);
    chip.onBreak = (index) => this.call(index);
  }

  /** Adds a function, and returns its address. */
  add(rom, run) {
    const address = CODE + 4 * this.functions.length;
    rom.setUint16(address, UNDEFINED | this.functions.length, true);
    rom.setUint16(address + 2, BX_LR, true);
    this.functions.push(run);
    return address | 1;
  }

  call(index) {
    const at = this.core.PC - 2;
    const run = at === CODE + 4 * index && this.functions[index];
    if (!run) throw new Error(`undefined instruction, or function that the ROM lacks, at 0x${at.toString(16)}`);
    run();
  }

  arg(index) {
    return this.core.registers[index] >>> 0;
  }

  floatArg(index) {
    bits.setUint32(0, this.arg(index));
    return bits.getFloat32(0);
  }

  result(value, cycles) {
    this.core.registers[0] = value;
    this.takes((cycles * 1e9) / this.chip.clkSys);
  }

  takes(nanos) {
    this.chip.clock.tick(nanos);
  }

  float(compute) {
    bits.setFloat32(0, compute(this.floatArg(0), this.floatArg(1)));
    this.result(bits.getUint32(0), 70);
  }

  toInteger(least, most) {
    this.result(Math.min(Math.max(Math.floor(this.floatArg(0)) || 0, least), most), 37);
  }

  fromInteger(value) {
    bits.setFloat32(0, value);
    this.result(bits.getUint32(0), 55);
  }

  /** The function or the datum with a tag in a table. */
  lookUp() {
    let [at, tag] = [this.arg(0), this.arg(1)];
    for (; this.chip.readUint16(at) !== 0; at += 4) {
      if (this.chip.readUint16(at) === tag) return this.result(this.chip.readUint16(at + 2), 40);
    }
    throw new Error(`the ROM has nothing with the tag ${String.fromCharCode(tag & 0xff, tag >> 8)}`);
  }

  fill() {
    const [start, value, len] = [this.arg(0), this.arg(1), this.arg(2)];
    for (let at = start; at < start + len; at++) this.chip.writeUint8(at, value & 0xff);
    this.result(start, 20 + len / 2);
  }

  copy() {
    const [to, from, len] = [this.arg(0), this.arg(1), this.arg(2)];
    for (let at = 0; at < len; at++) this.chip.writeUint8(to + at, this.chip.readUint8(from + at));
    this.result(to, 20 + len);
  }

  /** The flash cannot be read meanwhile, so neither code nor interrupts may run from it. */
  checkCaller(address, len, unit) {
    const isInFlash = this.core.LR >>> 28 === 1;
    if (isInFlash || !this.core.PM) throw new Error('the flash was written by code in flash, or with interrupts');
    if (address % unit !== 0 || len % unit !== 0) throw new Error('the flash was written at no multiple of its unit');
  }

  erase() {
    const [start, len] = [this.arg(0), this.arg(1)];
    this.checkCaller(start, len, SECTOR);
    for (let sector = start; sector < start + len; sector += SECTOR) {
      this.takes(ERASE_NANOS / 2);
      this.chip.flash.fill(0xff, sector, sector + SECTOR / 2);
      this.cut();
      this.takes(ERASE_NANOS / 2);
      this.chip.flash.fill(0xff, sector, sector + SECTOR);
    }
  }

  program() {
    const [start, from, len] = [this.arg(0), this.arg(1), this.arg(2)];
    this.checkCaller(start, len, PAGE);
    for (let at = 0; at < len; at++) {
      if (at % PAGE === 0) this.takes(PROGRAM_NANOS);
      if (at % PAGE === PAGE / 2) this.cut();
      this.chip.flash[start + at] &= this.chip.readUint8(from + at);
    }
  }

  /** Starts the second stage of the boot loader, as the ROM does: in RAM, if its checksum is right. */
  boot() {
    const stage2 = this.chip.flash.subarray(0, BOOT2_LEN);
    let crc = 0xffffffff;
    for (const byte of stage2.subarray(0, BOOT2_LEN - 4)) {
      crc ^= byte << 24;
      for (let bit = 0; bit < 8; bit++) crc = (crc << 1) ^ (crc < 0 ? 0x04c11db7 : 0);
    }
    const stored = new DataView(stage2.buffer, stage2.byteOffset).getUint32(BOOT2_LEN - 4, true);
    if (crc >>> 0 !== stored) throw new Error('the checksum of the second-stage boot loader is wrong');
    this.chip.sram.set(stage2, BOOT2_IN_RAM - 0x20000000);
    this.core.SP = BOOT2_IN_RAM;
    this.core.LR = 0;
    this.core.PC = BOOT2_IN_RAM;
  }
}
