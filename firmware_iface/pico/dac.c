/* dac.c - see dac.h. Words go out at 15.6 MHz in bytes; the select pin frames them, so that it is
 * high before the next one begins, whatever the length of a word.
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

static const struct dac_part *const part = &dac_parts[DAC_PART];

static void send(uint32_t word)
{
    SIO_GPIO_OUT_CLR = 1u << PIN_DAC_SELECT;
    for (uint32_t left = part->bytes; left--;)
        SPI_DR = word >> 8 * left & 0xff;
    while (SPI_SR & SPI_SR_BUSY)
        ;
    SIO_GPIO_OUT_SET = 1u << PIN_DAC_SELECT;
}

void dac_start(void)
{
    SPI_CPSR = PRESCALE;
    SPI_CR0 = SERIAL_CLOCK_RATE << 8 | (part->spi_mode & 1u) << 7 | (part->spi_mode >> 1u) << 6 |
              EIGHT_BITS;
    SPI_CR1 = ENABLE;
    dac_set_damping(0);
    dac_rest();
}

void dac_set_torque(int16_t count)
{
    send(dac_torque_word(part, count));
}

void dac_rest(void)
{
    dac_set_torque(0);
    if (part->start_word)
        send(part->start_word);
}

void dac_set_damping(uint16_t count)
{
    send(dac_damping_word(part, count));
}
