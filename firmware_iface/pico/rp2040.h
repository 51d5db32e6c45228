/* rp2040.h - the registers of the RP2040 that this firmware uses, with the sections of the
 * "RP2040 Datasheet" that describe them.
 */
#ifndef RP2040_H
#define RP2040_H

#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(address))
#define SET 0x2000u /* aliases that set or clear single bits (2.1.2) */
#define CLR 0x3000u

/* --- 2.3.1 SIO: pins --- */
#define SIO_GPIO_IN REG(0xd0000004u)
#define SIO_GPIO_OUT_SET REG(0xd0000014u)
#define SIO_GPIO_OUT_CLR REG(0xd0000018u)
#define SIO_GPIO_OE_SET REG(0xd0000024u)

/* --- 2.3.2 interrupt numbers, 2.4.8 processor --- */
#define IRQ_TIMER_0 0
#define IRQ_USBCTRL 5
#define IRQ_IO_BANK0 13
#define NVIC_ISER REG(0xe000e100u)
#define NVIC_ISPR REG(0xe000e200u)
#define VTOR REG(0xe000ed08u)

/* --- 2.13.5 power-on state machine --- */
#define PSM_WDSEL REG(0x40010008u)
#define PSM_ALL_BUT_OSCILLATORS 0x1fffcu

/* --- 2.14.3 subsystem resets --- */
#define RESETS_RESET 0x4000c000u
#define RESETS_DONE REG(0x4000c008u)
#define RESET_IO_BANK0 (1u << 5)
#define RESET_PADS_BANK0 (1u << 8)
#define RESET_PIO0 (1u << 10)
#define RESET_PLL_SYS (1u << 12)
#define RESET_PLL_USB (1u << 13)
#define RESET_SPI0 (1u << 16)
#define RESET_TIMER (1u << 21)
#define RESET_USBCTRL (1u << 24)

/* --- 2.15.7 clocks --- */
#define CLK_REF_CTRL REG(0x40008030u)
#define CLK_REF_SELECTED REG(0x40008038u)
#define CLK_SYS_CTRL REG(0x4000803cu)
#define CLK_SYS_SELECTED REG(0x40008044u)
#define CLK_PERI_CTRL REG(0x40008048u)
#define CLK_USB_CTRL REG(0x40008054u)
#define CLK_REF_XOSC 2u
#define CLK_SYS_REF 0u
#define CLK_SYS_AUX 1u /* whose reset state selects PLL_SYS */
#define CLK_ENABLE (1u << 11)

/* --- 2.16.7 crystal oscillator, 2.17.8 ring oscillator, 2.18.4 PLLs --- */
#define XOSC_CTRL REG(0x40024000u)
#define XOSC_STATUS REG(0x40024004u)
#define XOSC_STARTUP REG(0x4002400cu)
#define XOSC_ENABLE_1_15MHZ (0xfabu << 12 | 0xaa0u)
#define XOSC_STABLE (1u << 31)
#define ROSC_RANDOMBIT REG(0x4006001cu)
#define PLL_SYS 0x40028000u
#define PLL_USB 0x4002c000u
#define PLL_CS 0x0u
#define PLL_PWR 0x4u
#define PLL_FBDIV_INT 0x8u
#define PLL_PRIM 0xcu
#define PLL_CS_LOCK (1u << 31)
#define PLL_PWR_PD (1u << 0)
#define PLL_PWR_POSTDIVPD (1u << 3)
#define PLL_PWR_VCOPD (1u << 5)

/* --- 2.19.6 pins: user bank and its pads --- */
#define GPIO_CTRL(pin) REG(0x40014004u + 8u * (pin))
#define IO_INTR(pin) REG(0x400140f0u + 4u * ((pin) / 8u))
#define IO_PROC0_INTE 0x40014100u
#define IO_EDGES(pin) (0xcu << 4u * ((pin) % 8u)) /* falling and rising */
#define FUNCTION_SPI 1u
#define FUNCTION_SIO 5u
#define FUNCTION_PIO0 6u
#define PAD(pin) REG(0x4001c004u + 4u * (pin))
#define PAD_INPUT 0x42u     /* input enabled, Schmitt trigger */
#define PAD_PULL_UP 0x08u
#define PAD_PULL_DOWN 0x04u
#define PAD_OUTPUT 0x53u    /* 4 mA, fast */

/* --- 2.20.2 system information --- */
#define SYSINFO_CHIP_ID REG(0x40000000u)

/* --- 3.7 PIO0 --- */
#define PIO_CTRL REG(0x50200000u)
#define PIO_FSTAT REG(0x50200004u)
#define PIO_FLEVEL REG(0x5020000cu)
#define PIO_RXF0 REG(0x50200020u)
#define PIO_IRQ REG(0x50200030u)
#define PIO_INSTR_MEM(i) REG(0x50200048u + 4u * (i))
#define PIO_SM0_CLKDIV REG(0x502000c8u)
#define PIO_SM0_SHIFTCTRL REG(0x502000d0u)
#define PIO_SM0_INSTR REG(0x502000d8u)
#define PIO_SM0_PINCTRL REG(0x502000dcu)

/* --- 4.1.4 USB --- */
#define USB_DPRAM 0x50100000u
#define USB_ADDR_ENDP REG(0x50110000u)
#define USB_MAIN_CTRL REG(0x50110040u)
#define USB_SIE_CTRL 0x5011004cu
#define USB_SIE_STATUS REG(0x50110050u)
#define USB_BUFF_STATUS REG(0x50110058u)
#define USB_EP_ABORT 0x50110060u
#define USB_EP_ABORT_DONE REG(0x50110064u)
#define USB_EP_STALL_ARM REG(0x50110068u)
#define USB_MUXING REG(0x50110074u)
#define USB_PWR REG(0x50110078u)
#define USB_INTE REG(0x50110090u)
#define USB_INTS REG(0x50110098u)

/* --- 4.4.4 SPI0 --- */
#define SPI_CR0 REG(0x4003c000u)
#define SPI_CR1 REG(0x4003c004u)
#define SPI_DR REG(0x4003c008u)
#define SPI_SR REG(0x4003c00cu)
#define SPI_CPSR REG(0x4003c010u)
#define SPI_SR_BUSY (1u << 4)

/* --- 4.6.5 timer, 4.7.6 watchdog --- */
#define TIMER_ALARM0 REG(0x40054010u)
#define TIMER_RAWL REG(0x40054028u)
#define TIMER_INTR REG(0x40054034u)
#define TIMER_INTE REG(0x40054038u)
#define WATCHDOG_CTRL 0x40058000u
#define WATCHDOG_LOAD REG(0x40058004u)
#define WATCHDOG_SCRATCH0 REG(0x4005800cu)
#define WATCHDOG_TICK REG(0x4005802cu)
#define WATCHDOG_ENABLE (1u << 30)
#define WATCHDOG_TICK_ENABLE (1u << 9)

/* --- 4.10.13 SSI: the flash --- */
#define SSI_CTRLR0 REG(0x18000000u)
#define SSI_SSIENR REG(0x18000008u)
#define SSI_BAUDR REG(0x18000014u)
#define SSI_SR REG(0x18000028u)
#define SSI_DR0 REG(0x18000060u)
#define SSI_SR_RFNE (1u << 3)
#define SSI_8_BITS_BOTH_WAYS (7u << 16)

static inline void cpu_wait(void)
{
    __asm__ volatile("wfi" ::: "memory");
}

#endif
