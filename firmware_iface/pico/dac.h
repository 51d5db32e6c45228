/* dac.h - the DACs at SPI0: one for the torque; the same, or another, for the damping. */
#ifndef DAC_H
#define DAC_H

#include <stdint.h>

/* No torque, no damping, no trim; then the start word of the torque DAC. */
void dac_start(void);

void dac_set_torque(int16_t count);

/* No torque. The part starts again if its own supply has been switched on since. */
void dac_rest(void);

void dac_set_damping(uint16_t count);

/* No effect if the damping DAC has no channel for it. */
void dac_set_resistance(int16_t count);

#endif
