/* dac.c - see dac.h. Words are sent at 15.6 MHz in bytes. The select pin frames them, so that it is
 * high before the next one begins, for any length of a word. Two parts may need different edges of
 * the clock, so each word sets its edge; the clock idles low for all of them.
 */
#include "dac.h"

#include "config.h"
#include "dac_parts.h"
#include "pins.h"
#include "rp2040.h"

#define PRESCALE 2u       /* 125 MHz / 2 / (1 + 3) */
#define SERIAL_CLOCK_RATE 3u
#define EIGHT_BITS 7u
#define ENABLE (1u << 1)
#define ONE_PART (DAMPING_PART == DAC_PART)

typedef char torque_is_a_voltage[DAC_PART != DAC8812 ? 1 : -1];
typedef char damping_is_of_a_part_that_is_there[ONE_PART || DAMPING_PART == DAC8812 ? 1 : -1];

struct socket {
    const struct dac_part *part;
    uint32_t select;
};

static const struct socket torque = {&dac_parts[DAC_PART], 1u << PIN_DAC_SELECT};
static const struct socket damping = {
    &dac_parts[DAMPING_PART], 1u << (ONE_PART ? PIN_DAC_SELECT : PIN_DAMPING_SELECT)};

/* 4.4.3: it is configured while it is off. */
static void spi_start(uint32_t mode)
{
    SPI_CR1 = 0;
    SPI_CR0 = SERIAL_CLOCK_RATE << 8 | (mode & 1u) << 7 | (mode >> 1u) << 6 | EIGHT_BITS;
    SPI_CR1 = ENABLE;
}

static void send(const struct socket *to, uint32_t word)
{
    spi_start(to->part->spi_mode);
    SIO_GPIO_OUT_CLR = to->select;
    for (uint32_t left = to->part->bytes; left--;)
        SPI_DR = word >> 8 * left & 0xff;
    while (SPI_SR & SPI_SR_BUSY)
        ;
    SIO_GPIO_OUT_SET = to->select;
}

void dac_start(void)
{
    SPI_CPSR = PRESCALE;
    dac_set_damping(0);
    dac_set_resistance(0);
    dac_rest();
}

void dac_set_torque(int16_t count)
{
    send(&torque, dac_torque_word(torque.part, count));
}

void dac_rest(void)
{
    dac_set_torque(0);
    if (torque.part->start_word)
        send(&torque, torque.part->start_word);
}

void dac_set_damping(uint16_t count)
{
    send(&damping, dac_damping_word(damping.part, count));
}

void dac_set_resistance(int16_t count)
{
    if (damping.part->resistance_word)
        send(&damping, dac_resistance_word(damping.part, count));
}
