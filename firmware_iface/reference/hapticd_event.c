/* hapticd_event.c - see hapticd_event.h. Numbers wrap after 256 events, a multiple of the ring. */
#include "hapticd_event.h"

#include <string.h>

static uint8_t shown(const struct hapticd_events *events)
{
    return (uint8_t)(events->newest - events->held + 1);
}

/* Drop the oldest event. */
static void advance(struct hapticd_events *events)
{
    events->held--;
    events->taken = 0;
}

void hapticd_events_start(struct hapticd_events *events, uint16_t code, uint32_t now_us)
{
    memset(events, 0, sizeof *events);
    events->code[0] = code;
    events->at_us[0] = now_us - HAPTICD_AGE_MAX_US;
    events->held = 1;
}

void hapticd_events_look(struct hapticd_events *events, uint16_t code, uint32_t now_us)
{
    uint8_t place;
    if (code == events->code[events->newest % HAPTICD_EVENT_DEPTH])
        return;
    if (events->held == HAPTICD_EVENT_DEPTH)
        advance(events);
    events->newest++;
    events->held++;
    place = events->newest % HAPTICD_EVENT_DEPTH;
    events->code[place] = code;
    events->at_us[place] = now_us;
}

void hapticd_events_forget(struct hapticd_events *events)
{
    while (events->held > 1)
        advance(events);
}

void hapticd_events_grow_old(struct hapticd_events *events, uint32_t now_us)
{
    for (uint8_t i = 0; i < events->held; i++) {
        uint32_t *at_us = &events->at_us[(uint8_t)(events->newest - i) % HAPTICD_EVENT_DEPTH];
        if (now_us - *at_us > HAPTICD_AGE_MAX_US)
            *at_us = now_us - HAPTICD_AGE_MAX_US;
    }
}

void hapticd_events_show(struct hapticd_events *events, struct hapticd_in *frame, uint32_t now_us)
{
    uint8_t place;
    if (events->taken == HAPTICD_EVENT_FRAMES && events->held > 1)
        advance(events);
    hapticd_events_grow_old(events, now_us);
    frame->event_seq = shown(events);
    place = frame->event_seq % HAPTICD_EVENT_DEPTH;
    frame->event_code = events->code[place];
    frame->event_age_us = (uint16_t)(now_us - events->at_us[place]);
}

void hapticd_events_taken(struct hapticd_events *events, uint8_t number)
{
    if (number == shown(events) && events->taken < HAPTICD_EVENT_FRAMES)
        events->taken++;
}
