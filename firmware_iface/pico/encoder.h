/* encoder.h - quadrature counter in PIO0, up to 12.5 million edges a second. */
#ifndef ENCODER_H
#define ENCODER_H

#include <stdbool.h>
#include <stdint.h>

/* Start to count from 0 at the present position. */
void encoder_start(void);

/* Return the present count; wraps. */
int32_t encoder_count(void);

/* Return whether A and B changed at once since the last call: edges were lost. */
bool encoder_skipped(void);

#endif
