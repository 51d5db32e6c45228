/* hapticd_event.h - events of the reference firmware: changes of the code at the event pins.
 *
 * Each change is an event, also that back to 0; a code that is held is none. Events are numbered,
 * and shown to the host one at a time, oldest first: the next one follows when the host has taken
 * HAPTICD_EVENT_FRAMES frames with the one before, so a frame that is lost loses no event. The last
 * one stays. Of more than HAPTICD_EVENT_DEPTH the oldest are lost, which their numbers show.
 *
 * Nothing here touches hardware: the caller reads the pins and the clock.
 */
#ifndef HAPTICD_EVENT_H
#define HAPTICD_EVENT_H

#include <stdbool.h>
#include <stdint.h>

#include "hapticd_wire.h"

#define HAPTICD_AGE_MAX_US 65535u /* what an age of 16 bits can say */

struct hapticd_events {
    uint16_t code[HAPTICD_EVENT_DEPTH]; /* ring: that of event i at i % HAPTICD_EVENT_DEPTH */
    uint32_t at_us[HAPTICD_EVENT_DEPTH];
    uint8_t newest; /* number of the newest event; wraps */
    uint8_t held;   /* the one that is shown and those after it */
    uint8_t taken;  /* frames that showed it and were taken */
};

/* Forget everything. `code` is at the pins, and has been for longer than an age can say. */
void hapticd_events_start(struct hapticd_events *events, uint16_t code, uint32_t now_us);

/* `code` is at the pins now. */
void hapticd_events_look(struct hapticd_events *events, uint16_t code, uint32_t now_us);

/* Of all but the newest: no host was there to see them. */
void hapticd_events_forget(struct hapticd_events *events);

/* An age that has reached its end stays there, however often the clock wraps meanwhile. Called at
 * least once in half of its range. */
void hapticd_events_grow_old(struct hapticd_events *events, uint32_t now_us);

/* Fill the fields of a frame that is latched now. */
void hapticd_events_show(struct hapticd_events *events, struct hapticd_in *frame, uint32_t now_us);

/* The host took a frame that showed event `number`. */
void hapticd_events_taken(struct hapticd_events *events, uint8_t number);

#endif
