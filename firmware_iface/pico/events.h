/* events.h - a group of inputs for the events of an experiment: triggers, buttons. */
#ifndef EVENTS_H
#define EVENTS_H

#include <stdint.h>

/* The levels at this moment: bit 0 is PIN_EVENT_FIRST; bits without a pin are 0. */
uint16_t events_read(void);

/* Each edge of these pins interrupts from now on. */
void events_watch(void);

/* The edges that interrupted have been seen; call it before the levels are read. */
void events_acknowledge(void);

#endif
