/* chip.h - clocks, resets, timer and watchdog of the RP2040, and memory that survives a reset. */
#ifndef CHIP_H
#define CHIP_H

#include <stdbool.h>
#include <stdint.h>

/* 125 MHz for the processor, 48 MHz for USB, 1 MHz for timer and watchdog, all from the 12 MHz
 * crystal. Then the subsystems of `resets` (RESET_ bits) and the timer come out of reset. */
void chip_start(uint32_t resets);

/* Microseconds, from the crystal; wraps. */
uint32_t chip_clock_us(void);

/* Raise the interrupt TIMER_0 in `us` from now; this replaces an earlier alarm. */
void chip_alarm_in(uint32_t us);
void chip_alarm_acknowledge(void);

/* The chip resets, except for the oscillators, `us` after the last feeding. */
void chip_watchdog_start(uint32_t us);
void chip_watchdog_feed(uint32_t us);

/* Return another number at each start: incremented after a reset, random after power-up. */
uint8_t chip_next_life(void);

/* Return whether the silicon is revision B0 or B1, of 2021. */
bool chip_older_than_b2(void);

#endif
