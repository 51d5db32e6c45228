// The timer's alarms as in the chip (datasheet 4.6): they fire when the counter reaches their
// value, not up to a microsecond earlier. One that is set to a past value waits until the counter
// reaches it again.
const TIMER = 0x40054;
const ALARM0 = 0x10;
const ALARM3 = 0x1c;
const WRAP_US = 2 ** 32;

export function keepTime(mcu) {
  const timer = mcu.peripherals[TIMER];
  const write = timer.writeUint32.bind(timer);
  timer.writeUint32 = (offset, value) => {
    write(offset, value);
    if (offset < ALARM0 || offset > ALARM3) return;
    const nowUs = Math.floor(mcu.clock.nanosCounter / 1000);
    const waitUs = (value - nowUs) >>> 0 || WRAP_US;
    const alarm = timer.alarms[(offset - ALARM0) / 4];
    alarm.clockAlarm.schedule((nowUs + waitUs) * 1000 - mcu.clock.nanosCounter);
  };
}
