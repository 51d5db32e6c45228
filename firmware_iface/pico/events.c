/* events.c - see events.h. */
#include "events.h"

#include "pins.h"
#include "rp2040.h"

uint16_t events_read(void)
{
    return (uint16_t)(SIO_GPIO_IN >> PIN_EVENT_FIRST & ((1u << PIN_EVENT_COUNT) - 1));
}
