// The state at power-up that rp2040js omits: RESETS holds the peripherals, pads have their input
// enabled, clk_sys is the ring oscillator, SRAM contains noise, and no tick runs. Each access is
// checked for violations that a real chip would not tolerate.
const PAD_AT_RESET = 0x56; // input enabled, pulled down, Schmitt
const ALL = 0x01ffffff;
const ROSC_HZ = 6.5e6;
const NOISE = 0xa5;
const TICK_HZ = 1e6;
const RESETS = 0x4000c;
const PADS = 0x4001c;
const IO = 0x40014;
const TIMER = 0x40054;
const WATCHDOG = 0x40058;
const ROSC = 0x40060;
const SYSINFO = 0x40000;
const SPI = [0x4003c, 0x40040];
const RANDOM_BIT = 0x1c;
const TICK = 0x2c;
// bits of RESETS (datasheet 2.14.3) by the peripheral's place
const HELD_BY = {
  0x4004c: 0, 0x40030: 1, 0x50000: 2, 0x40044: 3, 0x40048: 4, 0x40014: 5, 0x40018: 6, 0x4001c: 8,
  0x40020: 9, 0x50200: 10, 0x50300: 11, 0x40028: 12, 0x4002c: 13, 0x40050: 14, 0x4005c: 15,
  0x4003c: 16, 0x40040: 17, 0x40004: 18, 0x4006c: 20, 0x40054: 21, 0x40034: 22, 0x40038: 23,
  0x50110: 24, 0x50100: 24,
};
const SRAM = 0x20000000;
const SRAM_BYTES = 264 * 1024;

export class Resets {
  // `chipId`: of SYSINFO; bits 31:28 are 2 for B2. `seed`: of the ring oscillator's random bit.
  constructor(mcu, complain, chipId, seed) {
    this.mcu = mcu;
    this.complain = complain;
    this.seed = seed;
    this.tickHz = 0;
    mcu.sram.fill(NOISE);
    mcu.clkSys = ROSC_HZ;
    for (const pin of mcu.gpio) pin.padValue = PAD_AT_RESET;
    this.holdAll();
    this.watchTick();
    mcu.peripherals[SYSINFO].readUint32 = (offset) => (offset ? 0 : chipId);
    this.watchOscillator();
    this.watchAccesses();
  }

  holdAll() {
    const resets = this.mcu.peripherals[RESETS];
    resets.reset = ALL;
    const get = () => ~resets.reset & ALL;
    Object.defineProperty(resets, 'reset_done', { get, set: () => {} });
    this.registers = resets;
  }

  // Timer and watchdog count ticks of clk_ref over CYCLES; rp2040js assumes 1 MHz always.
  watchTick() {
    const watchdog = this.mcu.peripherals[WATCHDOG];
    watchdog.tickEnable = false;
    const write = watchdog.writeUint32.bind(watchdog);
    watchdog.writeUint32 = (offset, value) => {
      if (offset === TICK) this.tickHz = this.mcu.clocks.refFreq / (value & 0x1ff);
      write(offset, value);
    };
  }

  watchOscillator() {
    const rosc = this.mcu.peripherals[ROSC];
    const unknown = rosc.readUint32.bind(rosc);
    rosc.readUint32 = (offset) => (offset === RANDOM_BIT ? this.randomBit() : unknown(offset));
  }

  randomBit() {
    this.seed = (Math.imul(this.seed, 1103515245) + 12345) & 0x7fffffff;
    return (this.seed >> 16) & 1;
  }

  held(bit) {
    return (this.registers.reset >>> bit) & 1;
  }

  watchAccesses() {
    const { mcu } = this;
    mcu.findPeripheral = (address) => {
      const place = (address >>> 14) << 2;
      if (address >= 0x40000000) this.accessed(place, address);
      return mcu.peripherals[place];
    };
    for (const name of ['readUint32', 'writeUint32']) {
      const inner = mcu[name].bind(mcu);
      mcu[name] = (address, value) => {
        this.checkWord(address >>> 0, name === 'writeUint32');
        return inner(address, value);
      };
    }
    const half = mcu.writeUint16.bind(mcu);
    mcu.writeUint16 = (address, value) => {
      if (address & 1) this.complain('alignment', `16 bits at ${hex(address)}`);
      half(address, value);
    };
  }

  checkWord(address, writes) {
    if (address & 3) this.complain('alignment', `32 bits at ${hex(address)}`);
    if (address >= SRAM && address < SRAM + SRAM_BYTES) return;
    if (!writes && address >= 0x10000000 && address < 0x14000000 && !this.flash.inPlace) {
      this.complain('flash', `read in place at ${hex(address)}`);
    }
    if (writes && address < 0x18000000) this.complain('address', `write to ${hex(address)}`);
    if (!writes && address >= 0x50100000 && address < 0x50101000 && this.held(24)) {
      this.complain('reset', `access to ${hex(address)} while its peripheral is in reset`);
    }
  }

  accessed(place, address) {
    const bit = HELD_BY[place];
    if (bit !== undefined && this.held(bit)) {
      this.complain('reset', `access to ${hex(address)} while its peripheral is in reset`);
    }
    if (place === TIMER && Math.abs(this.tickHz - TICK_HZ) > 1) {
      this.complain('clock', `timer at a tick of ${this.tickHz} Hz`);
    }
    if (SPI.includes(place) && !this.mcu.clocks.periFreq) {
      this.complain('clock', 'SPI without CLK_PERI');
    }
    if (place === PADS || place === IO) this.onPins();
    this.onAccess(place);
  }

  onPins() {}

  onAccess() {}
}

function hex(address) {
  return (address >>> 0).toString(16);
}
