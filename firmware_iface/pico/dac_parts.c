/* dac_parts.c - see dac_parts.h. Outputs of each part:
 *
 *              power-up                      reset of the processor
 *   DAC8563    mid-scale of a reference      the last codes, until dac_start; then mid-scale
 *              that is off: 0 V at both
 *   MCP4922    nothing, 500 kohm to ground,  the last codes, until dac_start; then mid-scale
 *              until it is written to        and 0
 *   DAC8812    zero at both (MSB to ground)  the last codes, until dac_start; then zero at both
 *
 * The level shifter of the DAC8563 therefore takes its offset from the reference pin of the DAC. A
 * fixed offset would be full negative torque until the reference is on. The MCP4922 needs resistors
 * that hold torque at mid-scale and damping at 0. In a reset only the amplifier enable removes the
 * force.
 *
 * The DAC8812 latches its last 18 bits whenever its select goes high. A resistor holds it high in a
 * reset, where the pin of the chip is pulled down.
 */
#include "dac_parts.h"

#define WIRE_BITS 16 /* of the counts on the wire */

const struct dac_part dac_parts[] = {
    /* SLAS719E 8.5.2: command << 19 | address << 16 | code, latched at the 24th falling edge. Write
     * and update is command 3; the start word turns the internal reference on, which sets both
     * gains to 2: mid-scale is the reference */
    [DAC8563] = {16, 3, 1, true, 0x180000, 0x190000, 0, 0x380001},
    /* DS22250A register 5-1: channel << 15 | buffered | gain 1 | active | code, at select high */
    [MCP4922] = {12, 2, 0, false, 0x7000, 0xf000, 0, 0},
    /* SBAS349 8.4.1: the last 18 bits are address << 16 | code, at select high; three bytes may
     * carry them. Rising edge. Addresses 01 and 10 are A and B; zero is where the part powers up */
    [DAC8812] = {16, 3, 0, false, 0, 0x010000, 0x020000, 0},
};

/* Return `count` without its lowest `shift` bits, rounded half up, above `offset`. */
static uint32_t code(const struct dac_part *part, uint32_t count, uint32_t shift, uint32_t offset)
{
    const uint32_t highest = (1u << part->bits) - 1;
    const uint32_t half = 1u << shift >> 1;
    const uint32_t nearest = offset + ((count + half) >> shift);
    return nearest < highest ? nearest : highest;
}

uint32_t dac_torque_word(const struct dac_part *part, int16_t count)
{
    const uint32_t above_lowest = (uint32_t)(count - INT16_MIN);
    return part->torque_word | code(part, above_lowest, WIRE_BITS - part->bits, 0);
}

uint32_t dac_damping_word(const struct dac_part *part, uint16_t count)
{
    const uint32_t half_scale = part->damping_upper_half ? 1u << part->bits >> 1 : 0;
    const uint32_t shift = WIRE_BITS - part->bits + (part->damping_upper_half ? 1u : 0u);
    return part->damping_word | code(part, count, shift, half_scale);
}

/* The circuit compensates at least its coldest winding: count 0, and any below it, is no trim. */
uint32_t dac_resistance_word(const struct dac_part *part, int16_t count)
{
    const uint32_t trim = count > 0 ? 2u * (uint32_t)count : 0;
    return part->resistance_word | code(part, trim, WIRE_BITS - part->bits, 0);
}
