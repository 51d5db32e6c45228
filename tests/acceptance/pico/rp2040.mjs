// rp2040js, from the folder of modules in HAPTICD_NODE_MODULES, and its internal names that this
// folder uses. That library does not guarantee them, so each is checked at the start.
import { createRequire } from 'node:module';

const { RP2040 } = createRequire(`${process.env.HAPTICD_NODE_MODULES}/`)('rp2040js');

const NAMES = {
  core: ['executeInstruction', 'waiting', 'VTOR', 'SP', 'LR', 'PC', 'enabledInterrupts'],
  clock: ['nanosCounter', 'nextAlarm', 'tick', 'createAlarm'],
  usbCtrl: [
    'DPRAMUpdated', 'sieCtrl', 'sieStatus', 'sieStatusUpdated', 'mainCtrl', 'addrEndp', 'intRaw',
    'intEnable', 'checkInterrupts', 'buffStatus', 'buffStatusUpdated', 'epAbort', 'epAbortDone',
    'epStallArm', 'sofFrameNumber', 'writeUint32',
  ],
  usbDPRAMView: ['getUint32', 'setUint32'],
  clocks: ['usbCtrl', 'periFreq', 'refFreq'],
  pllUsb: ['frequency'],
  'pio.0': ['run', 'machines', 'checkChangedPins', 'pinDirections', 'irq'],
  'pio.0.machines.0': ['step', 'enabled', 'clockDivInt', 'clockDivFrac', 'clkDivRestart', 'x'],
  'spi.0': [
    'onTransmit', 'completeTransmit', 'dataBits', 'control0', 'clockFrequency', 'enabled',
    'writeUint32',
  ],
  'gpio.0': [
    'setInputValue', 'addListener', 'padValue', 'pullupEnabled', 'pulldownEnabled', 'inputValue',
    'value',
  ],
  'peripherals.98304': ['baudr', 'readUint32', 'writeUint32'], // 0x18000, SSI
  'peripherals.262228.alarms.0': ['clockAlarm'], // 0x40054, TIMER
  'peripherals.262156': ['reset', 'reset_done'], // 0x4000c, RESETS
  'peripherals.262160': ['wdsel'], // 0x40010, PSM
  'peripherals.262232': [ // 0x40058, WATCHDOG
    'onWatchdogTrigger', 'alarm', 'scratchData', 'reason', 'tickEnable', 'enable', 'timer',
  ],
  '': [
    'findPeripheral', 'peripherals', 'gpioValues', 'clkSys', 'sram', 'flash', 'usbDPRAM', 'logger',
    'onBreak', 'readUint32', 'writeUint32', 'writeUint16',
  ],
};

// Return the names that this version of rp2040js lacks, as "place.name".
export function missingNames(names = NAMES) {
  const mcu = new RP2040();
  const missing = [];
  for (const [place, wanted] of Object.entries(names)) {
    const steps = place.split('.').filter(Boolean);
    const found = steps.reduce((owner, step) => owner?.[step], mcu);
    for (const name of wanted) {
      if (found?.[name] === undefined) missing.push(`${place}.${name}`);
    }
  }
  return missing;
}

export { NAMES, RP2040 };
