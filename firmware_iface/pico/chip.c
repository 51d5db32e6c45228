/* chip.c - see chip.h. */
#include "chip.h"

#include "rp2040.h"

#define XOSC_STARTUP_10_MS (12000000u / 100u / 256u)
#define TICK_CYCLES 12u /* of the crystal, for 1 us */
#define LIFE_MAGIC 0x68617000u
#define RANDOM_BITS 64

/* --- clocks (2.15 to 2.18) -------------------------------------------------------------------- */

static void end_reset(uint32_t bits)
{
    REG(RESETS_RESET + CLR) = bits;
    while (~RESETS_DONE & bits)
        ;
}

static void crystal_start(void)
{
    XOSC_STARTUP = XOSC_STARTUP_10_MS;
    XOSC_CTRL = XOSC_ENABLE_1_15MHZ;
    while (!(XOSC_STATUS & XOSC_STABLE))
        ;
    CLK_REF_CTRL = CLK_REF_XOSC;
    while (CLK_REF_SELECTED != 1u << CLK_REF_XOSC)
        ;
    CLK_SYS_CTRL = CLK_SYS_REF;
    while (CLK_SYS_SELECTED != 1u << CLK_SYS_REF)
        ;
}

/* 12 MHz * feedback / (post1 * post2); the order is that of 2.18.3. */
static void pll_start(uint32_t pll, uint32_t feedback, uint32_t post1, uint32_t post2)
{
    REG(pll + PLL_CS) = 1;
    REG(pll + PLL_FBDIV_INT) = feedback;
    REG(pll + PLL_PWR + CLR) = PLL_PWR_PD | PLL_PWR_VCOPD;
    while (!(REG(pll + PLL_CS) & PLL_CS_LOCK))
        ;
    REG(pll + PLL_PRIM) = post1 << 16 | post2 << 12;
    REG(pll + PLL_PWR + CLR) = PLL_PWR_POSTDIVPD;
}

void chip_start(uint32_t resets)
{
    crystal_start();
    end_reset(RESET_PLL_SYS | RESET_PLL_USB);
    pll_start(PLL_SYS, 125, 6, 2); /* 1500 MHz / 12 = 125 MHz */
    pll_start(PLL_USB, 100, 5, 5); /* 1200 MHz / 25 = 48 MHz */
    CLK_SYS_CTRL = CLK_SYS_AUX;
    while (CLK_SYS_SELECTED != 1u << CLK_SYS_AUX)
        ;
    CLK_PERI_CTRL = CLK_ENABLE; /* from clk_sys */
    CLK_USB_CTRL = CLK_ENABLE;  /* from PLL_USB */
    WATCHDOG_TICK = TICK_CYCLES | WATCHDOG_TICK_ENABLE;
    end_reset(resets | RESET_TIMER);
    TIMER_INTE = 1;
}

/* --- timer (4.6) ------------------------------------------------------------------------------ */

uint32_t chip_clock_us(void)
{
    return TIMER_RAWL;
}

/* The alarm compares for equality: a time that passed before it was set would match only after the
 * wrap of the clock. The interrupt is then set pending by hand. */
void chip_alarm_in(uint32_t us)
{
    uint32_t due_us = TIMER_RAWL + us;
    TIMER_ALARM0 = due_us;
    if ((int32_t)(TIMER_RAWL - due_us) >= 0)
        NVIC_ISPR = 1u << IRQ_TIMER_0;
}

void chip_alarm_acknowledge(void)
{
    TIMER_INTR = 1;
}

/* --- watchdog (4.7) --------------------------------------------------------------------------- */

void chip_watchdog_start(uint32_t us)
{
    PSM_WDSEL = PSM_ALL_BUT_OSCILLATORS;
    chip_watchdog_feed(us);
    REG(WATCHDOG_CTRL + SET) = WATCHDOG_ENABLE;
}

void chip_watchdog_feed(uint32_t us)
{
    WATCHDOG_LOAD = 2 * us; /* RP2040-E1: it counts down twice a tick */
}

/* --- differences between starts, and between chips -------------------------------------------- */

uint8_t chip_next_life(void)
{
    uint8_t life = (uint8_t)(WATCHDOG_SCRATCH0 + 1);
    if ((WATCHDOG_SCRATCH0 & ~0xffu) != LIFE_MAGIC)
        for (int i = 0; i < RANDOM_BITS; i++)
            life = (uint8_t)((life << 1 | life >> 7) ^ (ROSC_RANDOMBIT & 1));
    WATCHDOG_SCRATCH0 = LIFE_MAGIC | life;
    return life;
}

bool chip_older_than_b2(void)
{
    return SYSINFO_CHIP_ID >> 28 < 2;
}
