// The flash behind the SSI (datasheet 4.10): read in place while the controller is in the mode of
// the boot stage; its unique id is read by command 4Bh (W25Q16JV 8.2.31). The controller selects
// the flash as long as its FIFO is not empty.
const SSI = 0x18000;
const CTRLR0 = 0x00;
const SSIENR = 0x08;
const BAUDR = 0x14;
const SR = 0x28;
const DR0 = 0x60;
const FIFO = 16;
const EEPROM_READ = 3; // mode of CTRLR0 for reading in place
const READ_UNIQUE_ID = 0x4b;
const IGNORED = 5; // the command and four bytes after it

export class Flash {
  constructor(mcu, complain, uniqueId) {
    this.mcu = mcu;
    this.complain = complain;
    this.uniqueId = Buffer.from(uniqueId, 'hex');
    this.inPlace = true;
    this.sending = [];
    this.received = [];
    this.command = [];
    this.alarm = mcu.clock.createAlarm(() => this.shifted());
    const ssi = mcu.peripherals[SSI];
    this.ssi = ssi;
    const read = ssi.readUint32.bind(ssi);
    const write = ssi.writeUint32.bind(ssi);
    ssi.readUint32 = (offset) => this.read(offset, read);
    ssi.writeUint32 = (offset, value) => {
      write(offset, value);
      this.written(offset, value);
    };
  }

  read(offset, otherwise) {
    if (offset === DR0) return this.received.shift() ?? 0;
    if (offset !== SR) return otherwise(offset);
    const { sending, received } = this;
    return (
      (this.alarmed ? 1 : 0) | (sending.length < FIFO ? 2 : 0) | (sending.length ? 0 : 4) |
      (received.length ? 8 : 0)
    );
  }

  written(offset, value) {
    if (offset === CTRLR0) this.inPlace = ((value >>> 8) & 3) === EEPROM_READ;
    if (offset === CTRLR0 || offset === BAUDR) {
      if (this.enabled) this.complain('flash', 'SSI set up while it is enabled');
    }
    if (offset === SSIENR) this.enabled = value & 1;
    if (offset !== DR0) return;
    if (!this.enabled || this.inPlace) this.complain('flash', 'DR0 in a mode that sends nothing');
    if (this.sending.length >= FIFO) this.complain('flash', 'more than the FIFO holds');
    this.sending.push(value & 0xff);
    if (!this.alarmed) this.shift();
  }

  shift() {
    this.alarmed = true;
    this.alarm.schedule((8 * this.ssi.baudr * 1e9) / this.mcu.clkSys);
  }

  shifted() {
    const at = this.command.push(this.sending.shift()) - 1;
    const asked = this.command[0] === READ_UNIQUE_ID;
    const answer = asked && at >= IGNORED ? this.uniqueId[at - IGNORED] ?? 0xff : 0xff;
    if (this.received.length >= FIFO) this.complain('flash', 'more came than the FIFO holds');
    this.received.push(answer);
    if (this.sending.length) {
      this.shift();
      return;
    }
    this.alarmed = false;
    this.command = []; // deselected
  }
}
