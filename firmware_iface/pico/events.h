/* events.h - a group of inputs for the events of an experiment: triggers, buttons. */
#ifndef EVENTS_H
#define EVENTS_H

#include <stdint.h>

/* Return the present levels: bit 0 is PIN_EVENT_FIRST; bits without a pin are 0. */
uint16_t events_read(void);

/* Enable the interrupt at each edge of these pins. */
void events_watch(void);

/* Acknowledge the edges that interrupted; call it before the levels are read. */
void events_acknowledge(void);

#endif
