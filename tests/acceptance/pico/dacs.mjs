// The two-channel DACs that the board may have, and the analog circuit behind them, in counts of
// the wire: a torque from A and a damping factor from B, or a damping factor from A and a trim of
// the resistance from B. They have their own power: a reset of the processor keeps their outputs.
const MID = 0x8000;
const ALL = 0x10000;
const CR0 = 0x0;
const SPO = 1 << 6;
const SPH = 1 << 7;

// DAC8563 (SLAS719): 24-bit frames, sampled at the falling edge; starts at mid-scale with its
// reference off. Torque is the difference to the reference's pin, so it is 0 until that is on;
// damping uses the upper half of B. LDAC is at ground: writes act at once.
class Dac8563 {
  static takes = (bits) => bits === 24;
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

  // Return false for an unknown command.
  obey(word) {
    const command = (word >> 19) & 7;
    const address = (word >> 16) & 7;
    const data = word & 0xffff;
    if (command === 0 && address === 2) this.gain = data & 1 ? 1 : 2;
    else if (command === 0 || command === 2 || command === 3) return this.write(address, data);
    else if (command === 5) this.powerUp();
    else if (command === 7) this.refer(data & 1);
    else return command === 4 || command === 6; // power modes and LDAC masks: unchanged
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
  static takes = (bits) => bits === 16;
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

// DAC8812 (SBAS349): the last 18 bits of a frame count, sampled at the rising edge. It multiplies,
// so its codes are shares of the circuit's input. With MSB at ground it starts at zero. Its select
// has a pull-up, so a reset of the processor is not a frame. LDAC is at ground.
class Dac8812 {
  static takes = (bits) => bits >= 18;
  static fastestHz = 50e6;
  static falling = false;

  constructor() {
    this.powerUp();
  }

  powerUp() {
    this.codes = [0, 0];
  }

  obey(word) {
    const channels = (word >> 16) & 3;
    if (channels & 1) this.codes[0] = word & 0xffff;
    if (channels & 2) this.codes[1] = word & 0xffff;
    return channels !== 0;
  }

  get damping() {
    return this.codes[0];
  }

  get resistance() {
    return this.codes[1] / 2;
  }
}

export const PARTS = { dac8563: Dac8563, mcp4922: Mcp4922, dac8812: Dac8812 };

// Parts at an SPI of the chip, each selected by a pin: `sockets` are pairs of part and pin.
export class SpiBus {
  constructor(sockets, complain, onOutput) {
    Object.assign(this, { sockets, complain, onOutput });
  }

  attach(mcu, number) {
    const spi = mcu.spi[number];
    this.selected = new Set();
    this.clear();
    let frame = 0;
    const done = mcu.clock.createAlarm(() => this.sent(spi, frame));
    spi.onTransmit = (value) => {
      frame = value;
      this.check(spi);
      done.schedule((spi.dataBits * 1e9) / (spi.clockFrequency || 1));
    };
    this.watchFormat(spi);
    for (const { part, select } of this.sockets) {
      mcu.gpio[select].addListener((state) => this.select(part, state === 0));
    }
  }

  clear() {
    this.bits = 0;
    this.word = 0;
  }

  // 4.4.3 of the chip's datasheet: format and rate are set while the SPI is off.
  watchFormat(spi) {
    const write = spi.writeUint32.bind(spi);
    spi.writeUint32 = (offset, value) => {
      if (offset === CR0 && spi.enabled) this.complain('spi', 'format of an SPI that is on');
      write(offset, value);
    };
  }

  check(spi) {
    const falls = !!(spi.control0 & SPO) !== !!(spi.control0 & SPH);
    if (this.selected.size !== 1) this.complain('spi', `${this.selected.size} parts selected`);
    if (!spi.enabled) this.complain('spi', 'the SPI is off');
    for (const { constructor } of this.selected) {
      if (falls !== constructor.falling) this.complain('spi', 'the other edge of the clock');
      if (spi.clockFrequency > constructor.fastestHz) {
        this.complain('spi', `${spi.clockFrequency} Hz`);
      }
    }
  }

  sent(spi, frame) {
    this.word = (this.word * 2 ** spi.dataBits + frame) % ALL ** 2;
    this.bits += spi.dataBits;
    spi.completeTransmit(0);
  }

  select(part, low) {
    if (!low && this.selected.delete(part)) this.take(part);
    if (low) this.selected.add(part);
    this.clear();
  }

  // Select goes high: the frame acts.
  take(part) {
    if (!part.constructor.takes(this.bits)) this.complain('spi', `a frame of ${this.bits} bits`);
    else if (!part.obey(this.word)) this.complain('spi', `no command of the DAC: ${this.word}`);
    this.onOutput();
  }
}
