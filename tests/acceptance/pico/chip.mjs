// The board: an RP2040 that runs an image from flash in rp2040js, with models of everything that
// this library lacks or does wrong, one subject per file. All time is the chip's, in nanoseconds
// since the start of the emulator.
//
// It complains where a chip would fail or might: kinds are
//   address     a write to what is not to be written     available   AVAILABLE with other bits
//   alignment   16 or 32 bits across their size          owned       a buffer that is not the CPU's
//   reset       a peripheral that is held in reset       toggle      DATA0 or DATA1 out of turn
//   clock       a clock that is missing or wrong         abort       EP_ABORT on old silicon
//   breakpoint  one was met: a fault handler             spi         frames no DAC would take
//   watchdog    a reset that leaves parts as they are    unknown     what rp2040js warns of
//   unmodelled  what this emulator does not do           boot        a wrong CRC of the boot stage
//   flash       read in place while its controller does something else, or FIFOs that overflow
import { enter } from './boot.mjs';
import { Bus } from './bus.mjs';
import { Controller } from './controller.mjs';
import { PARTS, SpiBus } from './dacs.mjs';
import { Flash } from './flash.mjs';
import { EncoderPlan, Pins } from './pins.mjs';
import { Pios } from './pio.mjs';
import { Resets } from './resets.mjs';
import { RP2040 } from './rp2040.mjs';
import { keepTime } from './timer.mjs';
import { Watchdog } from './watchdog.mjs';

const PIECE_NS = 62_500; // of the plant: within one its force is held
const MOST_KEPT = 4096; // changes of outputs
const NEAR_NS = 0.001; // tolerance of times: a shorter sleep may round to zero
const ESHUTDOWN = -108;
const FIRST_SEED = 12345;

export class Chip {
  // `options`: pins by name, dac, dampingDac, chipId, uniqueId
  constructor(image, options) {
    this.image = image;
    this.options = options;
    this.pins = new Pins(options.pins);
    this.torqueDac = new PARTS[options.dac]();
    const { dac, dampingDac } = options;
    this.dampingDac = dampingDac === dac ? this.torqueDac : new PARTS[dampingDac]();
    this.startNanos = 0;
    this.unplugs = 0;
    this.resets = 0;
    this.complaints = new Map(); // "kind: text" to its details
    this.changes = [];
    this.finished = [];
    this.amplifier = 0;
    this.instructions = 0;
    this.naps = 0;
    this.seed = FIRST_SEED;
    const complain = (kind, text) => this.complain(kind, text);
    this.dacs = new SpiBus(this.sockets, complain, () => this.note());
    this.plan = new EncoderPlan(this);
    this.standing = this.outputs;
    this.boot(null);
  }

  complain(kind, text) {
    const key = `${kind}: ${text}`;
    const known = this.complaints.get(key);
    if (known) known.times++;
    else this.complaints.set(key, { kind, text, nanos: this.mcu ? this.nanos : 0, times: 1 });
  }

  get nanos() {
    return this.startNanos + this.mcu.clock.nanosCounter;
  }

  get sockets() {
    const { torqueDac, dampingDac } = this;
    const { select, dampingSelect } = this.options.pins;
    const sockets = [{ part: torqueDac, select }];
    if (dampingDac !== torqueDac) sockets.push({ part: dampingDac, select: dampingSelect });
    return sockets;
  }

  get outputs() {
    const { amplifier, torqueDac, dampingDac } = this;
    const { damping, resistance = 0 } = dampingDac;
    return { torque: torqueDac.torque, damping, resistance, amplifier };
  }

  // --- power and resets --------------------------------------------------------------------------
  powerUp() {
    this.torqueDac.powerUp();
    this.dampingDac.powerUp();
    this.restart(null);
  }

  restart(kept) {
    const lost = this.bus.transfers;
    this.unplugs++;
    this.boot(kept);
    this.plan.drop();
    this.amplifier = 0; // pulled down
    this.note();
    for (const { id } of lost) this.ended(id, ESHUTDOWN, Buffer.alloc(0));
    this.stop = true;
  }

  boot(kept) {
    this.startNanos = this.mcu ? this.nanos : 0;
    const mcu = new RP2040();
    this.mcu = mcu;
    this.halted = false;
    this.bitten = false;
    mcu.flash.set(this.image);
    this.listen();
    const { chipId, pins, uniqueId } = this.options;
    const complain = (kind, text) => this.complain(kind, text);
    this.pios = new Pios(mcu, complain);
    const resets = new Resets(mcu, complain, chipId, this.seed++);
    resets.onPins = () => (this.pins.changed = true);
    resets.onAccess = (place) => this.pios.accessed(place);
    resets.flash = new Flash(mcu, complain, uniqueId);
    keepTime(mcu);
    this.watchdog = new Watchdog(mcu, kept, complain, () => (this.bitten = true));
    this.controller = new Controller(mcu, complain, chipId);
    this.bus = new Bus(this);
    this.dacs.attach(mcu, pins.spi);
    this.pins.attach(mcu, this.pios, (level) => this.enable(level));
    if (enter(mcu, this.image)) return;
    this.complain('boot', 'the boot ROM refuses the second stage');
    this.halted = true;
  }

  listen() {
    const { mcu } = this;
    const warn = (who, text) => this.complain('unknown', `${who}: ${text}`);
    const quiet = () => {};
    mcu.logger = { debug: quiet, info: quiet, warn, error: warn };
    mcu.onBreak = () => {
      this.complain('breakpoint', `at ${mcu.core.PC.toString(16)}`);
      this.halted = true;
    };
  }

  // --- outputs -----------------------------------------------------------------------------------
  enable(level) {
    this.amplifier = level;
    this.note();
  }

  // A changed output acts on the plant from the next piece on, so the run ends there.
  note() {
    const { standing, outputs } = this;
    for (const name of Object.keys(outputs)) {
      if (outputs[name] === standing[name]) continue;
      if (this.changes.length < MOST_KEPT) this.changes.push([this.nanos, name, outputs[name]]);
      this.changed = true;
    }
    this.standing = outputs;
    if (this.changed) this.limit = Math.min(this.limit, this.pieceEnd);
  }

  get pieceEnd() {
    return Math.ceil(this.nanos / PIECE_NS) * PIECE_NS;
  }

  ended(id, status, data) {
    this.finished.push({ id, status, data });
    this.stop = true;
  }

  // --- time --------------------------------------------------------------------------------------
  planEncoder(counts) {
    this.changed = false;
    this.plan.begin(Math.round(this.nanos / PIECE_NS) * PIECE_NS, PIECE_NS, counts);
  }

  // Run until `until`, the end of a transfer, or the end of a piece in which an output changed.
  run(until) {
    this.stop = this.finished.length > 0;
    this.limit = this.changed ? Math.min(until, this.pieceEnd) : until;
    while (!this.stop && this.nanos < this.limit - NEAR_NS) {
      if (this.mcu.core.waiting || this.halted) this.nap();
      else this.work();
      if (!this.bitten) continue;
      this.resets++;
      this.restart(this.watchdog.kept);
    }
  }

  // Advance to the next alarm in one step.
  nap() {
    const { clock } = this.mcu;
    const left = this.limit - this.startNanos;
    const next = clock.nextAlarm ? Math.min(clock.nextAlarm.nanos, left) : left;
    this.naps++;
    clock.tick(Math.max(0, next - clock.nanosCounter));
  }

  // Run instructions until the processor sleeps or another event occurs.
  work() {
    const { mcu } = this;
    const { core, clock } = mcu;
    let hz = mcu.clkSys;
    let cycleNs = 1e9 / hz;
    while (!this.stop && clock.nanosCounter < this.limit - this.startNanos) {
      const at = clock.nanosCounter + core.executeInstruction() * cycleNs;
      this.instructions++;
      if (clock.nextAlarm && clock.nextAlarm.nanos <= at) clock.tick(at - clock.nanosCounter);
      else clock.nanosCounter = at;
      if (core.waiting || this.halted || this.bitten) return;
      if (mcu.clkSys === hz) continue;
      hz = mcu.clkSys;
      cycleNs = 1e9 / hz;
    }
  }
}
