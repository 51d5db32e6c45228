/* start.c - vector tables, and the path from the boot stage to main: copy all to RAM, clear the
 * rest, jump there.
 */
#include "pins.h"
#include "rp2040.h"

extern uint32_t __ram_load[], __ram_start[], __ram_end[], __bss_start[], __bss_end[], __stack_top[];
int main(void);
void reset(void);
void unexpected(void);
void timer_irq(void);
void usb_irq(void);
void io_irq(void);

union vector {
    uint32_t *stack;
    void (*handler)(void);
};

__attribute__((section(".flash_vectors"), used)) static const union vector first_vectors[2] = {
    {.stack = __stack_top}, {.handler = reset}};

#define NONE {.handler = unexpected}

/* 2.4.5: 16 of the processor, 32 lines of interrupts */
__attribute__((section(".vectors"), used)) static const union vector vectors[16 + 32] = {
    {.stack = __stack_top}, {.handler = reset}, NONE, NONE, NONE, NONE, NONE, NONE,
    NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE,
    [16 + IRQ_TIMER_0] = {.handler = timer_irq},
    NONE, NONE, NONE, NONE,
    [16 + IRQ_USBCTRL] = {.handler = usb_irq},
    NONE, NONE, NONE, NONE, NONE, NONE, NONE,
    [16 + IRQ_IO_BANK0] = {.handler = io_irq},
    NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE,
    NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE};

/* A fault of the processor, or an interrupt that is not enabled. The amplifier goes off now, and
 * the watchdog restarts the chip; a debugger stops here. */
void unexpected(void)
{
    SIO_GPIO_OUT_CLR = 1u << PIN_AMPLIFIER_ENABLE;
    for (;;)
        __asm__ volatile("bkpt 0");
}

__attribute__((section(".flash_code"), noreturn)) void reset(void)
{
    const volatile uint32_t *from = __ram_load;
    volatile uint32_t *to = __ram_start;
    while (to < (volatile uint32_t *)__ram_end)
        *to++ = *from++;
    for (to = __bss_start; to < (volatile uint32_t *)__bss_end;)
        *to++ = 0;
    VTOR = (uint32_t)__ram_start;
    main();
    for (;;)
        cpu_wait();
}
