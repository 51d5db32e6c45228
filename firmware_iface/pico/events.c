/* events.c - see events.h. */
#include "events.h"

#include "pins.h"
#include "rp2040.h"

/* a register holds the edges of 8 pins */
#define SPLIT (PIN_EVENT_FIRST / 8u * 8u + 8u)
#define FIRST_EDGES ((~0u << 4u * (PIN_EVENT_FIRST % 8u)) & 0xccccccccu)
#define SECOND_EDGES (((1u << 4u * (PIN_EVENT_FIRST + PIN_EVENT_COUNT - SPLIT)) - 1u) & 0xccccccccu)

/* these masks take two registers, none of them to its end */
typedef char events_lie_in_two_registers[PIN_EVENT_FIRST % 8 > 0 && PIN_EVENT_COUNT == 8 ? 1 : -1];

void events_watch(void)
{
    REG(IO_PROC0_INTE + 4u * (PIN_EVENT_FIRST / 8u)) = FIRST_EDGES;
    REG(IO_PROC0_INTE + 4u * (SPLIT / 8u)) = SECOND_EDGES;
}

void events_acknowledge(void)
{
    IO_INTR(PIN_EVENT_FIRST) = FIRST_EDGES;
    IO_INTR(SPLIT) = SECOND_EDGES;
}

uint16_t events_read(void)
{
    return (uint16_t)(SIO_GPIO_IN >> PIN_EVENT_FIRST & ((1u << PIN_EVENT_COUNT) - 1));
}
