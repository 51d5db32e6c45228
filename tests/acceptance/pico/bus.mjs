// A full-speed bus with one device, and the host at its other end: transactions with their times on
// the wire, frames with a SOF every millisecond, control transfers in their stages, packets of 64
// bytes, data toggles, retries. All time is the chip's.
import { NAK } from './controller.mjs';

const BIT_NS = 1000 / 12;
const STUFFED = 7 / 6; // worst case
const OVERHEAD_BITS = 8 * 13; // token, handshake, sync and gaps of a transaction
const SOF_NS = 35 * BIT_NS;
const END_NS = 32 * BIT_NS; // before the end of a frame the wire is free
const FRAME_NS = 1e6;
const POLL_NS = 10_000; // between two tokens that meet NAK
const SUBMIT_NS = 1000;
const PATIENCE = 3; // transactions without an answer
const PACKET = 64;
// negative errno, as a controller of Linux reports
export const DONE = 0;
const EPROTO = -71;
const EOVERFLOW = -75;
const EPIPE = -32;
// standard requests, with bmRequestType
const SET_ADDRESS = 0x0005;
const SET_CONFIGURATION = 0x0009;
const SET_INTERFACE = 0x010b;
const CLEAR_HALT = 0x0201;

function wireNs(bytes) {
  return (bytes * 8 * STUFFED + OVERHEAD_BITS) * BIT_NS;
}

// A transfer: `endpoint` with 0x80 for IN, `data` or `length`, `setup` for endpoint 0.
class Transfer {
  constructor({ id, endpoint, setup, data, length }) {
    Object.assign(this, { id, endpoint: endpoint & 15, setup, data, length, at: 0, lost: 0 });
    this.got = [];
    this.size = 0;
    this.stage = setup ? 'setup' : 'data';
    this.inwards = setup ? !!(setup[0] & 0x80) : !!(endpoint & 0x80);
    this.pipe = setup ? 0 : endpoint; // served in rotation
    this.pid = 1; // of endpoint 0's next packet
    if (setup) this.length = setup[6] | (setup[7] << 8);
  }
}

export class Bus {
  constructor(chip) {
    this.chip = chip;
    this.controller = chip.controller;
    this.clock = chip.mcu.clock;
    this.alarm = this.clock.createAlarm(() => this.next());
    this.passage = this.clock.createAlarm(() => this.passed());
    this.frames = this.clock.createAlarm(() => this.frame());
    this.frames.schedule(FRAME_NS - (this.clock.nanosCounter % FRAME_NS));
    this.toggles = new Uint8Array(32);
    this.transfers = [];
    this.address = 0;
    this.turn = 0;
    this.running = false;
    this.transactions = 0;
    this.naks = 0;
  }

  frame() {
    this.controller.sof(Math.round(this.clock.nanosCounter / FRAME_NS));
    this.frames.schedule(FRAME_NS);
  }

  reset() {
    this.address = 0;
    this.toggles.fill(0);
    this.controller.resetBus();
  }

  submit(words) {
    this.transfers.push(new Transfer(words));
    if (this.running) return;
    this.running = true;
    this.alarm.schedule(SUBMIT_NS);
  }

  // Cancel a transfer; one whose packet is on the wire ends with it.
  cancel(id) {
    this.transfers = this.transfers.filter((transfer) => transfer.id !== id);
  }

  end(transfer, status) {
    this.transfers = this.transfers.filter((one) => one !== transfer);
    if (transfer.setup) this.controller.controlEnded();
    if (transfer.setup && status === DONE) this.obeyed(transfer.setup);
    this.chip.ended(transfer.id, status, Buffer.concat(transfer.got));
  }

  // Update the host's state after an accepted request.
  obeyed(setup) {
    const request = (setup[0] << 8) | setup[1];
    if (request === SET_ADDRESS) this.address = setup[2];
    if (request === SET_CONFIGURATION || request === SET_INTERFACE) this.toggles.fill(0);
    if (request === CLEAR_HALT) this.toggles[(setup[4] & 15) | (setup[4] & 0x80 ? 16 : 0)] = 0;
  }

  // --- one transaction after the other -----------------------------------------------------------
  next() {
    const heads = new Map();
    for (const one of this.transfers) if (!heads.has(one.pipe)) heads.set(one.pipe, one);
    if (!heads.size) {
      this.running = false;
      return;
    }
    const transfer = [...heads.values()][this.turn++ % heads.size];
    const begin = this.roomAt(wireNs(this.packetBytes(transfer)));
    const wait = begin - this.clock.nanosCounter;
    if (wait > 0) {
      this.turn--;
      this.alarm.schedule(wait);
    } else this.transact(transfer);
  }

  // Return when a transaction of that length fits into a frame.
  roomAt(ns) {
    const now = this.clock.nanosCounter;
    const into = now % FRAME_NS;
    if (into < SOF_NS) return now - into + SOF_NS;
    return into + ns > FRAME_NS - END_NS ? now - into + FRAME_NS + SOF_NS : now;
  }

  packetBytes({ stage, inwards, data, at }) {
    if (stage === 'setup') return 8;
    if (stage === 'status') return 0;
    return inwards ? PACKET : Math.min(PACKET, data.length - at);
  }

  transact(transfer) {
    this.transactions++;
    if (transfer.stage === 'setup') this.setup(transfer);
    else if (this.looksInwards(transfer)) this.in(transfer);
    else this.out(transfer);
  }

  // The status stage has the opposite direction of the data.
  looksInwards({ stage, inwards, length }) {
    return stage === 'status' ? !inwards || !length : inwards;
  }

  setup(transfer) {
    const answer = this.controller.beginSetup(this.address, transfer.setup);
    this.settle(transfer, answer, 8, () => {
      transfer.stage = transfer.length ? 'data' : 'status';
    });
  }

  in(transfer) {
    const { endpoint } = transfer;
    const answer = this.controller.beginIn(this.address, endpoint);
    const expected = transfer.setup ? transfer.pid : this.toggles[endpoint | 16];
    const bytes = answer.data?.length ?? 0;
    this.settle(transfer, answer, bytes, () => {
      if (answer.pid !== expected) {
        this.chip.complain('toggle', `EP${endpoint} IN sent DATA${answer.pid} out of turn`);
        return; // a repeated packet: acknowledged and dropped
      }
      this.flip(transfer, endpoint | 16);
      this.received(transfer, answer.data);
    });
  }

  received(transfer, data) {
    if (transfer.stage === 'status') {
      this.end(transfer, DONE);
      return;
    }
    transfer.got.push(data);
    transfer.size += data.length;
    if (transfer.size > transfer.length) this.end(transfer, EOVERFLOW);
    else if (transfer.size === transfer.length || data.length < PACKET) this.complete(transfer);
  }

  out(transfer) {
    const { endpoint, at, stage } = transfer;
    const status = stage === 'status';
    const piece = status ? Buffer.alloc(0) : transfer.data.subarray(at, at + PACKET);
    const pid = transfer.setup ? transfer.pid : this.toggles[endpoint];
    const answer = this.controller.beginOut(this.address, endpoint, piece, pid);
    this.settle(transfer, answer, piece.length, () => {
      if (status) {
        this.end(transfer, DONE);
        return;
      }
      this.flip(transfer, endpoint);
      transfer.at += piece.length;
      if (transfer.at >= transfer.data.length) this.complete(transfer);
    });
  }

  flip(transfer, slot) {
    if (transfer.setup) transfer.pid ^= 1;
    else this.toggles[slot] ^= 1;
  }

  complete(transfer) {
    if (!transfer.setup) {
      this.end(transfer, DONE);
      return;
    }
    transfer.stage = 'status';
    transfer.pid = 1;
  }

  // End the packet and apply its effects; or refuse the transfer.
  settle(transfer, answer, bytes, then) {
    if (answer.kind === 'ack') {
      this.passing = () => {
        answer.finish();
        if (this.transfers.includes(transfer)) then();
        else if (transfer.stage === 'data') this.flip(transfer, this.slotOf(transfer));
      };
      this.passage.schedule(wireNs(bytes));
      return;
    }
    if (answer === NAK) this.naks++;
    else if (answer.kind === 'stall') this.end(transfer, EPIPE);
    else if (++transfer.lost >= PATIENCE) this.end(transfer, EPROTO);
    this.alarm.schedule(Math.max(POLL_NS, wireNs(bytes)));
  }

  slotOf({ endpoint, inwards }) {
    return inwards ? endpoint | 16 : endpoint;
  }

  passed() {
    const pass = this.passing;
    this.passing = undefined;
    pass();
    this.alarm.schedule(0);
  }
}
