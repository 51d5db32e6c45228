// The connections of the pins: driven levels, open wires (the pad's pull decides, or the last level
// stays), the quadrature encoder, and the amplifier's enable input with its pull-down.
const PADS = 0x4001c;
const QUADRATURE = [0, 1, 3, 2]; // B << 1 | A, in the direction that counts up
const OPEN = 2;

export class Pins {
  constructor(numbers) {
    this.numbers = numbers; // a, b, stop, ready, amplifier
    this.driven = new Map(); // pin: 0, 1 or OPEN
    this.levels = new Map(); // at the pads
    this.count = 0;
  }

  // Connect them to a chip just out of reset.
  attach(mcu, pios, onAmplifier) {
    this.mcu = mcu;
    this.pios = pios;
    this.cacheInputs();
    const pads = mcu.peripherals[PADS];
    const write = pads.writeUint32.bind(pads);
    pads.writeUint32 = (offset, value) => {
      write(offset, value);
      this.changed = true;
      for (const [pin, level] of this.driven) if (level === OPEN) this.settle(pin);
    };
    const amplifier = mcu.gpio[this.numbers.amplifier];
    amplifier.addListener((state) => onAmplifier(state === 1 ? 1 : 0));
    for (const pin of this.driven.keys()) this.settle(pin, true);
    this.showEncoder(true);
  }

  // rp2040js reads all thirty pins at each step of a PIO program.
  cacheInputs() {
    const { mcu } = this;
    const prototype = Object.getPrototypeOf(mcu);
    const asked = Object.getOwnPropertyDescriptor(prototype, 'gpioValues').get.bind(mcu);
    let word = 0;
    this.changed = true;
    const get = () => {
      if (this.changed) {
        word = asked();
        this.changed = false;
      }
      return word;
    };
    Object.defineProperty(mcu, 'gpioValues', { get });
  }

  drive(pin, level) {
    this.driven.set(pin, level);
    this.settle(pin);
  }

  settle(pin, anew = false) {
    const driven = this.driven.get(pin);
    this.show(pin, driven === OPEN ? this.pulled(pin) : driven, anew);
  }

  pulled(pin) {
    const pad = this.mcu.gpio[pin];
    if (pad.pullupEnabled) return 1;
    return pad.pulldownEnabled ? 0 : this.levels.get(pin) ?? 0;
  }

  show(pin, level, anew) {
    if (!anew && this.levels.get(pin) === level) return;
    this.levels.set(pin, level);
    this.pios.catchUpAll();
    this.mcu.gpio[pin].setInputValue(!!level);
    this.changed = true;
  }

  // One step of the encoder per call.
  encoder(count) {
    this.count = count;
    this.showEncoder(false);
  }

  showEncoder(anew) {
    const state = QUADRATURE[this.count & 3];
    this.show(this.numbers.a, state & 1, anew);
    this.show(this.numbers.b, state >> 1, anew);
  }

  // Both signals change at once, as in no real encoder.
  skip() {
    const { mcu, numbers, levels } = this;
    this.pios.catchUpAll();
    for (const pin of [numbers.a, numbers.b]) {
      const level = levels.get(pin) ^ 1;
      levels.set(pin, level);
      mcu.gpio[pin].setInputValue(!!level);
    }
    this.changed = true;
    this.count += 2;
  }
}

// The encoder's counts at the ends of equal pieces of time; edges are spread evenly within each.
export class EncoderPlan {
  constructor(chip) {
    this.chip = chip;
    this.counts = [];
  }

  begin(startNanos, pieceNanos, counts) {
    this.alarm?.cancel();
    this.alarm = this.chip.mcu.clock.createAlarm(() => this.step());
    Object.assign(this, { startNanos, pieceNanos, counts, piece: 0, done: 0 });
    this.from = this.chip.pins.count;
    this.schedule();
  }

  drop() {
    this.counts = [];
    this.alarm = undefined;
  }

  schedule() {
    const { counts } = this;
    while (this.piece < counts.length && counts[this.piece] === this.from) this.piece++;
    if (this.piece >= counts.length) return;
    const steps = Math.abs(counts[this.piece] - this.from);
    const at = this.startNanos + (this.piece + (this.done + 1) / steps) * this.pieceNanos;
    this.alarm.schedule(Math.max(0, at - this.chip.nanos));
  }

  step() {
    const to = this.counts[this.piece];
    this.chip.pins.encoder(this.chip.pins.count + Math.sign(to - this.from));
    this.done++;
    if (this.done >= Math.abs(to - this.from)) {
      this.from = to;
      this.done = 0;
      this.piece++;
    }
    this.schedule();
  }
}
