// The board as a process. Requests arrive at stdin and replies leave at stdout, little-endian, each
// a u32 length and that many bytes; the first byte of a request is its verb
// (tests/support/pico_chip).
import { readSync, writeSync } from 'node:fs';
import { readImage } from './boot.mjs';
import { Chip } from './chip.mjs';
import { missingNames } from './rp2040.mjs';

const STATE_BYTES = 49;
const ENDED_BYTES = 12;
const SETUP_BYTES = 8;
const MISSING = 3; // exit status: names of rp2040js are missing

const missing = missingNames();
if (missing.length) {
  process.stderr.write(`rp2040js has no ${missing.join(', ')}\n`);
  process.exit(MISSING);
}
const chip = new Chip(readImage(process.argv[2]), JSON.parse(process.argv[3]));

function reply(...parts) {
  const body = Buffer.concat(parts);
  const head = Buffer.alloc(4);
  head.writeUInt32LE(body.length);
  let left = Buffer.concat([head, body]);
  while (left.length) left = left.subarray(writeSync(1, left));
}

function state() {
  const head = Buffer.alloc(STATE_BYTES);
  head.writeDoubleLE(chip.nanos, 0);
  head.writeDoubleLE(chip.standing.torque, 8);
  head.writeDoubleLE(chip.standing.damping, 16);
  head.writeDoubleLE(chip.standing.resistance, 24);
  head.writeUInt8(chip.standing.amplifier, 32);
  head.writeUInt8(chip.controller.connected ? 1 : 0, 33);
  head.writeUInt8(chip.changed ? 1 : 0, 34);
  head.writeUInt32LE(chip.unplugs, 35);
  head.writeUInt32LE(chip.complaints.size, 39);
  head.writeInt32LE(chip.pins.count, 43);
  head.writeUInt16LE(chip.finished.length, 47);
  const parts = chip.finished.flatMap(({ id, status, data }) => {
    const one = Buffer.alloc(ENDED_BYTES);
    one.writeUInt32LE(id, 0);
    one.writeInt32LE(status, 4);
    one.writeUInt32LE(data.length, 8);
    return [one, data];
  });
  chip.finished = [];
  reply(head, ...parts);
}

function submitted(body) {
  const setup = body.readUInt8(5) ? Buffer.from(body.subarray(6, 6 + SETUP_BYTES)) : undefined;
  return {
    id: body.readUInt32LE(0),
    endpoint: body.readUInt8(4),
    setup,
    length: body.readUInt32LE(14),
    data: Buffer.from(body.subarray(18)),
  };
}

function told() {
  const { complaints, changes, instructions, naps, resets, nanos, bus } = chip;
  chip.changes = [];
  return {
    complaints: [...complaints.values()], changes, instructions, naps, resets, nanos,
    transactions: bus.transactions, naks: bus.naks,
  };
}

const VERBS = {
  1(body) { // run
    const count = (_, index) => body.readInt32LE(10 + 4 * index);
    const counts = Array.from({ length: body.readUInt16LE(8) }, count);
    if (counts.length) chip.planEncoder(counts);
    chip.run(body.readDoubleLE(0));
    state();
  },
  2: (body) => chip.bus.submit(submitted(body)),
  3: (body) => chip.bus.cancel(body.readUInt32LE(0)),
  4: (body) => chip.pins.drive(body.readUInt8(0), body.readUInt8(1)),
  5: () => chip.bus.reset(),
  6: () => chip.powerUp(),
  7: () => reply(Buffer.from(JSON.stringify(told()))),
  8: () => (chip.halted = true), // the processor hangs
  9: () => chip.pins.skip(),
  10: () => (chip.mcu.core.enabledInterrupts = 0), // deaf: it runs without interrupts
};

function take(size) {
  const buffer = Buffer.alloc(size);
  let got = 0;
  while (got < size) {
    const count = read(buffer, got);
    if (!count) process.exit(0);
    got += count;
  }
  return buffer;
}

function read(buffer, at) {
  for (;;) {
    try {
      return readSync(0, buffer, at, buffer.length - at, null);
    } catch (error) {
      if (error.code !== 'EAGAIN') throw error;
    }
  }
}

for (;;) {
  const body = take(take(4).readUInt32LE(0));
  VERBS[body[0]](body.subarray(1));
}
