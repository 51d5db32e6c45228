// The device controller of the RP2040 on the wire (datasheet 4.1.2). It replaces that of rp2040js,
// which accepts every packet at once and has no NAK, STALL, toggles or address.
//
// A packet takes its time on the wire: `begin…` returns the controller's answer to a token, with a
// `finish` to be called at the end of the packet. In between the controller owns the buffer, and
// EP_ABORT is not done.
const FULL = 1 << 15;
const DATA1 = 1 << 13;
const STALL = 1 << 11;
const AVAILABLE = 1 << 10;
const LENGTH = 0x3ff;
const ENABLED = 1 << 31;
const BUFFER_CONTROLS = 0x80;
const BUFFER_CONTROLS_END = 0x100;
const DPRAM = 0x50100000;
const DPRAM_BYTES = 4096;
const EP0_BUFFER = 0x100;
const BUFFER_MASK = 0xffc0;
const EP_ABORT = 0x60;
const SOF_RD = 0x48;
const SIE_DATA_SEQ = 1 << 31;
const SIE_RESET = 1 << 19;
const SIE_SETUP = 1 << 17;
const PULL_UP = 1 << 16;
const INT_SOF = 1 << 17;
const CLK_USB_ON = 1 << 11;
const USB_HZ = 48e6;
const VERSION_SHIFT = 28;
const VERSION_B2 = 2;

export const NAK = { kind: 'nak' };
export const STALLED = { kind: 'stall' };
export const NOBODY = { kind: 'nobody' };

export class Controller {
  constructor(mcu, complain, chipId) {
    this.mcu = mcu;
    this.usb = mcu.usbCtrl;
    this.view = mcu.usbDPRAMView;
    this.complain = complain;
    this.aborts = chipId >>> VERSION_SHIFT >= VERSION_B2; // RP2040-E2: B0 and B1 cannot
    this.last = new Uint32Array(32); // current buffer controls
    this.busy = -1; // the one whose packet is on the wire
    this.ordered = true; // a bus reset or a request is being processed
    this.usb.DPRAMUpdated = (offset, value) => this.controlWritten(offset, value);
    this.watchRegisters();
    this.takeBytes();
  }

  // rp2040js writes a byte as a word after reading it, which the buffers do not need.
  takeBytes() {
    const { mcu } = this;
    const write = mcu.writeUint8.bind(mcu);
    mcu.writeUint8 = (address, value) => {
      const offset = address - DPRAM;
      if (offset >= BUFFER_CONTROLS_END && offset < DPRAM_BYTES) mcu.usbDPRAM[offset] = value;
      else write(address, value);
    };
  }

  watchRegisters() {
    const { usb } = this;
    const write = usb.writeUint32.bind(usb);
    usb.writeUint32 = (offset, value) => {
      write(offset, value);
      if (offset === EP_ABORT) this.abort(value);
    };
    const read = usb.readUint32.bind(usb);
    usb.readUint32 = (offset) => {
      if (offset === SOF_RD) this.clearSof();
      return read(offset);
    };
  }

  // --- actions of the firmware -------------------------------------------------------------------
  controlWritten(offset, value) {
    if (offset < BUFFER_CONTROLS || offset >= BUFFER_CONTROLS_END) return;
    const index = (offset - BUFFER_CONTROLS) >> 2;
    const before = this.last[index];
    this.last[index] = value;
    const others = (before & ~AVAILABLE) !== (value & ~AVAILABLE);
    if (value & AVAILABLE && !(before & AVAILABLE) && others) {
      this.complain('available', `AVAILABLE was set together with other bits of buffer ${index}`);
    }
    if (this.owned(index, before) && value !== before) {
      this.complain('owned', `buffer ${index} was changed while the controller had it`);
    }
  }

  // A SETUP releases EP0's buffers, a bus reset or configuration all; otherwise only an abort does.
  owned(index, before) {
    if (index === this.busy) return true;
    const free = index < 2 || this.ordered || (this.usb.epAbortDone >>> index) & 1;
    return before & AVAILABLE && !free;
  }

  controlEnded() {
    this.ordered = false;
  }

  abort(bits) {
    if (!this.aborts && bits) this.complain('abort', 'EP_ABORT on silicon older than B2');
    if (this.busy >= 0) this.usb.epAbortDone &= ~(1 << this.busy);
  }

  clearSof() {
    this.usb.intRaw &= ~INT_SOF;
    this.usb.checkInterrupts();
  }

  // --- requests of the bus -----------------------------------------------------------------------
  get connected() {
    const { clocks, pllUsb } = this.mcu;
    const clocked = clocks.usbCtrl & CLK_USB_ON && Math.abs(pllUsb.frequency - USB_HZ) < 1;
    const pulled = this.usb.sieCtrl & PULL_UP && this.usb.mainCtrl & 1;
    if (pulled && !clocked) this.complain('clock', 'USB without 48 MHz');
    return !!(pulled && clocked);
  }

  // By the endpoint's direction: 0 OUT of the host, 1 IN, which has an even number.
  static index(endpoint, inwards) {
    return 2 * endpoint + (inwards ? 0 : 1);
  }

  control(index) {
    return this.view.getUint32(BUFFER_CONTROLS + 4 * index, true);
  }

  setControl(index, value) {
    this.view.setUint32(BUFFER_CONTROLS + 4 * index, value, true);
    this.last[index] = value;
  }

  buffer(index) {
    return index < 2 ? EP0_BUFFER : this.view.getUint32(4 * index, true) & BUFFER_MASK;
  }

  enabled(index) {
    return index < 2 || this.view.getUint32(4 * index, true) & ENABLED;
  }

  answers(address) {
    return this.connected && address === (this.usb.addrEndp & 0x7f);
  }

  raise(bits) {
    this.usb.sieStatus |= bits;
    this.usb.sieStatusUpdated();
  }

  resetBus() {
    this.ordered = true;
    this.raise(SIE_RESET);
  }

  sof(frame) {
    this.usb.sofFrameNumber = frame & 0x7ff;
    if (!(this.usb.intEnable & INT_SOF)) return;
    this.usb.intRaw |= INT_SOF;
    this.usb.checkInterrupts();
  }

  beginSetup(address, bytes) {
    if (!this.answers(address)) return NOBODY;
    const finish = () => {
      this.mcu.usbDPRAM.set(bytes, 0);
      this.usb.epStallArm &= ~3;
      this.ordered = true;
      this.raise(SIE_SETUP);
    };
    return { kind: 'ack', finish };
  }

  // Return an endpoint's answer before any data; null if it accepts the token.
  refusal(address, index, control) {
    if (!this.answers(address) || !this.enabled(index)) return NOBODY;
    const stalls = index >= 2 || (this.usb.epStallArm >>> index) & 1;
    if (control & STALL && stalls) return STALLED;
    if (!(control & AVAILABLE) || (this.usb.epAbort >>> index) & 1) return NAK;
    return null;
  }

  beginIn(address, endpoint) {
    const index = Controller.index(endpoint, true);
    const control = this.control(index);
    const refused = this.refusal(address, index, control);
    if (refused) return refused;
    if (!(control & FULL)) return NAK;
    const at = this.buffer(index);
    const data = Buffer.from(this.mcu.usbDPRAM.subarray(at, at + (control & LENGTH)));
    this.busy = index;
    const finish = () => this.pass(index, control & ~(AVAILABLE | FULL));
    return { kind: 'ack', data, pid: control & DATA1 ? 1 : 0, finish };
  }

  beginOut(address, endpoint, data, pid) {
    const index = Controller.index(endpoint, false);
    const control = this.control(index);
    const refused = this.refusal(address, index, control);
    if (refused) return refused;
    const expected = control & DATA1 ? 1 : 0;
    if (expected !== pid) return { kind: 'ack', finish: () => this.mistaken(endpoint, expected) };
    this.busy = index;
    const room = Math.min(data.length, control & LENGTH);
    const finish = () => {
      this.mcu.usbDPRAM.set(data.subarray(0, room), this.buffer(index));
      this.pass(index, (control & ~(AVAILABLE | LENGTH)) | FULL | room);
    };
    return { kind: 'ack', finish };
  }

  // Acknowledged and dropped as a repeated packet.
  mistaken(endpoint, expected) {
    this.complain('toggle', `EP${endpoint} OUT expects DATA${expected}, the other came`);
    this.raise(SIE_DATA_SEQ);
  }

  // Return the buffer to the firmware.
  pass(index, control) {
    const { usb } = this;
    this.busy = -1;
    this.setControl(index, control);
    usb.epAbortDone |= usb.epAbort & (1 << index);
    usb.buffStatus |= 1 << index;
    usb.buffStatusUpdated();
  }
}
