/* dac.h - the DAC at SPI0. */
#ifndef DAC_H
#define DAC_H

#include <stdint.h>

/* No torque and no damping; then what the part needs to start. */
void dac_start(void);

void dac_set_torque(int16_t count);

/* No torque. The part starts again if its own supply has come, or come back, since. */
void dac_rest(void);

void dac_set_damping(uint16_t count);

#endif
