/* hapticd_event.h - events of the reference firmware: changes of the code at the event pins.
 *
 * Each change is an event, also a return to 0; a constant code is not. Events are numbered and
 * shown to the host one at a time, oldest first. The next one follows when the host has read
 * HAPTICD_EVENT_FRAMES frames with the one before, so a lost frame loses no event. The last one
 * stays. Beyond HAPTICD_EVENT_DEPTH the oldest are lost; their numbers reveal the loss.
 *
 * This module does not access hardware: the caller reads the pins and the clock.
 */
#ifndef HAPTICD_EVENT_H
#define HAPTICD_EVENT_H

#include <stdbool.h>
#include <stdint.h>

#include "hapticd_wire.h"

#define HAPTICD_AGE_MAX_US 65535u /* largest age in 16 bits */

struct hapticd_events {
    uint16_t code[HAPTICD_EVENT_DEPTH]; /* ring: event i is at i % HAPTICD_EVENT_DEPTH */
    uint32_t at_us[HAPTICD_EVENT_DEPTH];
    uint8_t newest; /* number of the newest event; wraps */
    uint8_t held;   /* the event that is shown and the later ones */
    uint8_t taken;  /* frames with it that the host has read */
};

/* Clear all events. `code` is at the pins, for longer than the largest age. */
void hapticd_events_start(struct hapticd_events *events, uint16_t code, uint32_t now_us);

/* Report that `code` is at the pins now. */
void hapticd_events_look(struct hapticd_events *events, uint16_t code, uint32_t now_us);

/* Drop all events but the newest: no host was connected. */
void hapticd_events_forget(struct hapticd_events *events);

/* Keep an age at its maximum, however often the clock wraps. Call at least once in half of the
 * clock's range. */
void hapticd_events_grow_old(struct hapticd_events *events, uint32_t now_us);

/* Fill the fields of a frame that is latched now. */
void hapticd_events_show(struct hapticd_events *events, struct hapticd_in *frame, uint32_t now_us);

/* The host has read a frame that showed event `number`. */
void hapticd_events_taken(struct hapticd_events *events, uint8_t number);

#endif
