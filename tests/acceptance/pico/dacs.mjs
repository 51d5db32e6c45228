// The two-channel DACs that the board may have, and the analog circuit behind them: a torque from
// A, a damping factor from B, in counts of the wire. They have power of their own: a reset of the
// processor leaves their outputs as they are.
const MID = 0x8000;
const ALL = 0x10000;
const SPO = 1 << 6;
const SPH = 1 << 7;

// DAC8563 (SLAS719): 24-bit frames, sampled at the falling edge; starts at mid-scale with its
// reference off. Torque is the difference to the reference's pin, so it is 0 until that is on;
// damping takes the upper half of B. LDAC lies at ground: what is written acts.
class Dac8563 {
  static frameBits = 24;
  static fastestHz = 50e6;
  static falling = true;

  constructor() {
    this.powerUp();
  }

  powerUp() {
    this.codes = [MID, MID];
    this.gain = 1;
    this.reference = false;
  }

  // False: no such command.
  obey(word) {
    const command = (word >> 19) & 7;
    const address = (word >> 16) & 7;
    const data = word & 0xffff;
    if (command === 0 && address === 2) this.gain = data & 1 ? 1 : 2;
    else if (command === 0 || command === 2 || command === 3) return this.write(address, data);
    else if (command === 5) this.powerUp();
    else if (command === 7) this.refer(data & 1);
    else return command === 4 || command === 6; // power modes and LDAC masks: as they are
    return true;
  }

  write(address, data) {
    if (address !== 0 && address !== 1 && address !== 7) return false;
    if (address !== 1) this.codes[0] = data;
    if (address !== 0) this.codes[1] = data;
    return true;
  }

  refer(on) {
    this.reference = !!on;
    this.gain = on ? 2 : 1;
  }

  // Above the reference, in halves of the full scale of 65,536.
  above(code) {
    return this.reference ? (code * this.gain) / 2 - MID : 0;
  }

  get torque() {
    return this.above(this.codes[0]);
  }

  get damping() {
    return Math.max(0, 2 * this.above(this.codes[1]));
  }
}

// MCP4922 (DS22250): 16-bit frames, sampled at the rising edge; starts in shutdown, where the bias
// of the circuit holds torque at mid-scale and damping at 0.
class Mcp4922 {
  static frameBits = 16;
  static fastestHz = 20e6;
  static falling = false;

  constructor() {
    this.powerUp();
  }

  powerUp() {
    this.codes = [null, null];
  }

  obey(word) {
    const single = word & 0x2000;
    const code = Math.min(0xfff, (word & 0xfff) * (single ? 1 : 2));
    this.codes[word >> 15] = word & 0x1000 ? code << 4 : null;
    return true;
  }

  get torque() {
    return this.codes[0] === null ? 0 : this.codes[0] - MID;
  }

  get damping() {
    return this.codes[1] ?? 0;
  }
}

export const PARTS = { dac8563: Dac8563, mcp4922: Mcp4922 };

// A part at an SPI of the chip, selected by the pin `select`: either the SPI's own, or one that the
// firmware moves.
export class DacBus {
  constructor(part, select, complain, onOutput) {
    Object.assign(this, { part, select, complain, onOutput });
  }

  attach(mcu, number) {
    this.mcu = mcu;
    const spi = mcu.spi[number];
    this.bits = 0;
    this.word = 0;
    this.low = false;
    let frame = 0;
    const done = mcu.clock.createAlarm(() => this.sent(spi, frame));
    spi.onTransmit = (value) => {
      frame = value;
      this.check(spi);
      done.schedule((spi.dataBits * 1e9) / (spi.clockFrequency || 1));
    };
    const pin = mcu.gpio[this.select];
    pin.addListener((state) => this.selected(state === 0));
  }

  get bySpi() {
    return this.mcu.gpio[this.select].functionSelect === 1;
  }

  check(spi) {
    const { falling, fastestHz } = this.part.constructor;
    const falls = !!(spi.control0 & SPO) !== !!(spi.control0 & SPH);
    if (!spi.enabled || falls !== falling) this.complain('spi', 'edge or enable of the SPI');
    if (spi.clockFrequency > fastestHz) this.complain('spi', `${spi.clockFrequency} Hz`);
    if (!this.bySpi && !this.low) this.complain('spi', 'a frame without select');
  }

  sent(spi, frame) {
    this.word = this.word * 2 ** spi.dataBits + frame;
    this.bits += spi.dataBits;
    const more = spi.control0 & SPH && !spi.txFIFO.empty;
    if (this.bySpi && !more) this.take();
    spi.completeTransmit(0);
  }

  selected(low) {
    if (this.low && !low) this.take();
    this.low = low;
    this.bits = 0;
    this.word = 0;
  }

  // Select goes high: the frame acts.
  take() {
    const { frameBits } = this.part.constructor;
    if (this.bits !== frameBits) this.complain('spi', `${this.bits} bits in place of ${frameBits}`);
    else if (!this.part.obey(this.word % ALL ** 2)) {
      this.complain('spi', `no command of the DAC: ${this.word}`);
    }
    this.bits = 0;
    this.word = 0;
    this.onOutput();
  }
}
