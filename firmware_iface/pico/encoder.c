/* encoder.c - see encoder.h; PIO instructions are those of 3.4.
 *
 * Register X is the count. Each round of at most 10 cycles pushes it. Then the last and the present
 * state of the pins form the address of the next jump: (last BA, now BA) is 0 to 15. PIO cannot
 * increment, so up is ~(~x - 1). A step by two states raises flag 0.
 *
 * Limitations: the program must start at address 0.
 */
#include "encoder.h"

#include "pins.h"
#include "rp2040.h"

#define JMP(to) (0x0000u | (to))
#define JMP_X_DECREMENT(to) (0x0040u | (to))
#define MOV_X_NOT_X 0xa029u
#define MOV_ISR_X 0xa0c1u
#define MOV_OSR_ISR 0xa0e6u
#define MOV_PC_ISR 0xa0a6u
#define MOV_OSR_PINS 0xa0e0u
#define PUSH_NO_BLOCK 0x8000u
#define OUT_ISR_2 0x60c2u
#define IN_PINS_2 0x4002u
#define IRQ_SET_0 0xc000u
#define SET_X_0 0xe020u

enum { DOWN = 16, SKIP = 18, UP = 20, SAME = 23 };

static const uint16_t program[] = {
    JMP(SAME), JMP(UP), JMP(DOWN), JMP(SKIP), /* 00 -> 00 01 10 11 */
    JMP(DOWN), JMP(SAME), JMP(SKIP), JMP(UP), /* 01 */
    JMP(UP), JMP(SKIP), JMP(SAME), JMP(DOWN), /* 10 */
    JMP(SKIP), JMP(DOWN), JMP(UP), JMP(SAME), /* 11 */
    JMP_X_DECREMENT(SAME),                    /* 16 DOWN; goes on here where X was 0 */
    JMP(SAME),
    IRQ_SET_0,                                /* 18 SKIP */
    JMP(SAME),
    MOV_X_NOT_X,                              /* 20 UP */
    JMP_X_DECREMENT(22),                      /* to 22 in any case */
    MOV_X_NOT_X,                              /* 22 */
    MOV_ISR_X,                                /* 23 SAME */
    PUSH_NO_BLOCK,                            /* this clears ISR */
    OUT_ISR_2,                                /* the last pins, which OSR kept */
    IN_PINS_2,
    MOV_OSR_ISR,
    MOV_PC_ISR,
};

#define COUNT (sizeof program / sizeof *program)
#define CLOCK_DIVIDER_1 (1u << 16)
#define OSR_TO_THE_RIGHT (1u << 19) /* and ISR to the left */
#define IN_BASE(pin) ((pin) << 15)
#define RX_EMPTY (1u << 8)
#define RX_LEVEL (PIO_FLEVEL >> 4 & 0xfu)

void encoder_start(void)
{
    for (uint32_t i = 0; i < COUNT; i++)
        PIO_INSTR_MEM(i) = program[i];
    PIO_SM0_CLKDIV = CLOCK_DIVIDER_1;
    PIO_SM0_SHIFTCTRL = OSR_TO_THE_RIGHT;
    PIO_SM0_PINCTRL = IN_BASE(PIN_ENCODER_A);
    PIO_SM0_INSTR = SET_X_0;
    PIO_SM0_INSTR = MOV_OSR_PINS;
    PIO_SM0_INSTR = JMP(SAME);
    PIO_CTRL = 1;
}

/* The FIFO holds old values, pushed while there was room. The value after them is fresh. */
int32_t encoder_count(void)
{
    uint32_t old = RX_LEVEL;
    uint32_t count;
    do {
        while (PIO_FSTAT & RX_EMPTY)
            ;
        count = PIO_RXF0;
    } while (old--);
    return (int32_t)count;
}

/* A flag raised after the read stays for the next call. */
bool encoder_skipped(void)
{
    const bool skipped = PIO_IRQ & 1;
    if (skipped)
        PIO_IRQ = 1;
    return skipped;
}
