// PIO in the chip's time. rp2040js runs its state machines in node's event loop. Here the enabled
// ones are stepped up to the present cycle before each access of the processor and each edge at a
// pin, so a program sees every edge at its cycle.
//
// Limitations: a program that measures or makes pulses. After IDLE_STEPS without an edge or an
// access a program is assumed to loop, as a decoder of edges does.
const IDLE_STEPS = 64;
const PLACES = { 0x50200: 0, 0x50300: 1 };

export class Pios {
  constructor(mcu, complain) {
    this.mcu = mcu;
    this.complain = complain;
    for (const pio of mcu.pio) {
      pio.run = () => {};
      for (const machine of pio.machines) machine.clkDivRestart = () => {}; // whole divisors only
    }
  }

  accessed(place) {
    const index = PLACES[place];
    if (index !== undefined) this.catchUp(this.mcu.pio[index]);
  }

  catchUpAll() {
    for (const pio of this.mcu.pio) this.catchUp(pio);
  }

  catchUp(pio) {
    const { clock, clkSys } = this.mcu;
    const cycles = (clock.nanosCounter * clkSys) / 1e9;
    for (const machine of pio.machines) {
      const now = Math.floor(cycles / divisor(machine));
      if (machine.enabled) this.step(machine, now);
      machine.seen = now;
    }
    if (pio.pinDirections) this.complain('unmodelled', 'a PIO program drives pins');
  }

  step(machine, now) {
    if (machine.clockDivFrac) this.complain('unmodelled', 'a fraction in a PIO clock divisor');
    const due = Math.min(now - (machine.seen ?? now), IDLE_STEPS);
    for (let count = 0; count < due; count++) machine.step();
  }
}

function divisor(machine) {
  return machine.clockDivInt || 65536;
}
