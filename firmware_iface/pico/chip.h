/* chip.h - clocks, resets, timer, watchdog of the RP2040, and what survives a reset. */
#ifndef CHIP_H
#define CHIP_H

#include <stdbool.h>
#include <stdint.h>

/* 125 MHz for the processor, 48 MHz for USB, 1 MHz for timer and watchdog, all from the crystal of
 * 12 MHz. Then the subsystems of `resets` (RESET_ bits) and the timer come out of reset. */
void chip_start(uint32_t resets);

/* Microseconds, from the crystal; wraps. */
uint32_t chip_clock_us(void);

/* The interrupt TIMER_0 comes in `us` from now, in the place of an earlier one. */
void chip_alarm_in(uint32_t us);
void chip_alarm_acknowledge(void);

/* The chip resets, oscillators aside, `us` after the last feeding. */
void chip_watchdog_start(uint32_t us);
void chip_watchdog_feed(uint32_t us);

/* Another number at each start: counted on over a reset, drawn after power-up. */
uint8_t chip_next_life(void);

/* Silicon revisions B0 and B1, of 2021. */
bool chip_older_than_b2(void);

#endif
