// The host of the USB device: it enumerates a CDC port, and carries its bytes at full speed while the port is open.
//
// While it is closed the host takes no data, so the device's last packets wait: that is what Linux does.

import { USBCDC } from 'rp2040js';

const PULL_UP = 1 << 16;
const LINE_STATE = 3 << 2;
const LINE_STATE_J = 1 << 2;
// A register for each endpoint and direction says who owns its buffer.
const BUFFER_CONTROL = 0x80;
const OUT = 4;
const AVAILABLE = 1 << 10;
const LAST_ENDPOINT = 15;
// A packet of 64 bytes; a frame of 1 ms carries 19 (USB 2.0, section 5.8.4).
const PACKET_NANOS = 1e6 / 19;
const MAX_PACKET = 64;

export class UsbHost {
  constructor(chip, onData) {
    const usb = (this.usb = chip.usbCtrl);
    this.cdc = new USBCDC(usb);
    this.cdc.onSerialData = onData;
    this.cdc.onDeviceConnected = () => {
      // The enumeration ends with DTR set.
      this.isConnected = this.state = true;
      this.connectAlarm.schedule(1e6);
    };
    this.isConnected = this.isOpen = this.isSending = this.isTaking = this.state = false;
    this.toSend = [];
    this.outAlarm = chip.clock.createAlarm(() => this.sendPacket());
    this.inAlarm = chip.clock.createAlarm(() => this.takePacket());
    this.connectAlarm = chip.clock.createAlarm(() => this.setLineState());

    // A device shows itself by its pull-up.
    usb.onUSBEnabled = () => {};
    const writeSieControl = usb.handleSieCtrlWrite.bind(usb);
    usb.handleSieCtrlWrite = (value) => {
      const attaches = value & PULL_UP && !(usb.sieCtrl & PULL_UP);
      writeSieControl(value);
      if (!attaches) return;
      usb.resetDevice();
      // After the reset the line is idle, for which the workaround for erratum RP2040-E5 waits.
      usb.sieStatus = (usb.sieStatus & ~LINE_STATE) | LINE_STATE_J;
    };

    // The device offers a packet, or room for one, perhaps before it is configured. rp2040js would take the packet at once, and fill
    // the room with an empty one. Until the host does, the buffer stays available to it.
    this.give = usb.DPRAMUpdated.bind(usb);
    this.memory = chip.usbDPRAMView;
    this.room = new Set();
    usb.DPRAMUpdated = (offset, value) => {
      const endpoint = (offset - BUFFER_CONTROL) >> 3;
      if (endpoint <= 0 || endpoint > LAST_ENDPOINT) {
        this.give(offset, value);
      } else if (value & AVAILABLE) {
        if (offset & OUT) this.room.add(endpoint);
        else if (endpoint === this.cdc.inEndpoint) this.offered = [offset, value];
        this.send();
        this.take();
      }
    };
  }

  /**
   * A program opens the port, or closes it. As on Linux, the host reads before it sets DTR.
   *
   * Both at once would meet a race of rp2040-hal 0.12: `UsbBus::poll` clears the bits of all IN endpoints, also of one that was set after
   * it has read them. The device then waits for the end of that packet, and never sends again.
   */
  setOpen(isOpen) {
    this.isOpen = isOpen;
    this.toSend = [];
    this.connectAlarm.schedule(1e6);
    this.take();
  }

  setLineState() {
    if (this.isConnected && this.state !== this.isOpen) {
      this.state = this.isOpen;
      this.cdc.cdcSetControlLineState(this.isOpen ? 3 : 0);
    }
  }

  feed(bytes) {
    for (const byte of bytes) this.toSend.push(byte);
    this.send();
  }

  send() {
    if (this.isSending || !this.room.has(this.cdc.outEndpoint) || this.toSend.length === 0) return;
    this.isSending = true;
    this.outAlarm.schedule(PACKET_NANOS);
  }

  sendPacket() {
    this.isSending = false;
    if (this.toSend.length === 0) return;
    const endpoint = this.cdc.outEndpoint;
    this.room.delete(endpoint);
    const control = BUFFER_CONTROL + 8 * endpoint + OUT;
    this.memory.setUint32(control, this.memory.getUint32(control, true) & ~AVAILABLE, true);
    this.usb.finishRead(endpoint, Uint8Array.from(this.toSend.splice(0, MAX_PACKET)));
  }

  take() {
    if (this.isTaking || !this.isOpen || !this.offered) return;
    this.isTaking = true;
    this.inAlarm.schedule(PACKET_NANOS);
  }

  takePacket() {
    this.isTaking = false;
    if (!this.isOpen || !this.offered) return;
    const [offset, value] = this.offered;
    this.offered = undefined;
    this.give(offset, value);
  }
}
