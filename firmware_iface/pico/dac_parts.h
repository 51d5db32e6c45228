/* dac_parts.h - the supported two-channel DACs, and their words. It uses no register of the chip,
 * so a PC compiles it too.
 *
 * Of a part that makes voltages, channel A is torque around mid-scale and B the scale factor of the
 * damping. Of one that multiplies, A is the scale factor and B the resistance trim.
 */
#ifndef DAC_PARTS_H
#define DAC_PARTS_H

#include <stdbool.h>
#include <stdint.h>

enum dac_name { DAC8563, MCP4922, DAC8812 };

struct dac_part {
    uint8_t bits;            /* of a code */
    uint8_t bytes;           /* of a word, sent high byte first */
    uint8_t spi_mode;        /* polarity << 1 | phase */
    bool damping_upper_half; /* zero damping is mid-scale, the output at power-up */
    uint32_t torque_word;    /* sent with the code in its low bits; 0: no such channel */
    uint32_t damping_word;
    uint32_t resistance_word;
    uint32_t start_word;     /* sent behind a torque of 0 while there is no authority; 0: nothing */
};

extern const struct dac_part dac_parts[];

/* Nearest code, saturated, with command and address. */
uint32_t dac_torque_word(const struct dac_part *part, int16_t count);
uint32_t dac_damping_word(const struct dac_part *part, uint16_t count);
uint32_t dac_resistance_word(const struct dac_part *part, int16_t count);

#endif
