// The reset by the chip's watchdog. In rp2040js its alarm restarts itself endlessly, so it is
// stopped first. The chip then restarts, with the scratch registers and the reason kept.
const WATCHDOG = 0x40058;
const PSM = 0x40010;
const ALL_BUT_OSCILLATORS = 0x1fffc;

export class Watchdog {
  constructor(mcu, kept, complain, onBite) {
    const watchdog = mcu.peripherals[WATCHDOG];
    this.watchdog = watchdog;
    if (kept) {
      watchdog.scratchData.set(kept.scratch);
      watchdog.reason = kept.reason;
    }
    watchdog.onWatchdogTrigger = () => {
      watchdog.alarm.enable = false;
      if ((mcu.peripherals[PSM].wdsel & ALL_BUT_OSCILLATORS) !== ALL_BUT_OSCILLATORS) {
        complain('watchdog', 'PSM WDSEL leaves parts of the chip as they are');
      }
      onBite();
    };
  }

  // State that survives the reset.
  get kept() {
    return { scratch: this.watchdog.scratchData, reason: this.watchdog.reason };
  }
}
