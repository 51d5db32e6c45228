/* main.c - start-up, and the interrupts that call the reference firmware.
 *
 * All interrupts have the priority of reset, the highest: none interrupts another, as
 * hapticd_board.h demands. The main loop sleeps.
 */
#include "chip.h"
#include "config.h"
#include "events.h"
#include "flash_id.h"
#include "hapticd_board.h"
#include "pins.h"
#include "port.h"
#include "rp2040.h"
#include "usb.h"

#define RESETS_USED                                                                                \
    (RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_PIO0 | RESET_SPI0 | RESET_USBCTRL)
#define WATCHED_EDGES (IO_EDGES(PIN_EMERGENCY_STOP) | IO_EDGES(PIN_AMPLIFIER_READY))

/* one register acknowledges, and one enables, the edges of both */
typedef char inputs_share_a_register[PIN_EMERGENCY_STOP / 8 == PIN_AMPLIFIER_READY / 8 ? 1 : -1];

int main(void);
void timer_irq(void);
void io_irq(void);

static struct hapticd_board board;

static void alarm_at_next_event(void)
{
    chip_alarm_in(hapticd_board_wait_us(&board));
}

/* The only function that feeds the watchdog. */
static void serve(void)
{
    usb_collect();
    hapticd_board_service(&board);
    chip_watchdog_feed(HARDWARE_WATCHDOG_US);
    alarm_at_next_event();
}

void timer_irq(void)
{
    chip_alarm_acknowledge();
    serve();
}

/* Emergency stop, amplifier ready or an event pin changed. */
void io_irq(void)
{
    IO_INTR(PIN_EMERGENCY_STOP) = WATCHED_EDGES;
    events_acknowledge();
    serve();
}

void usb_on_out(const uint8_t *data, uint32_t size)
{
    hapticd_board_out(&board, data, size);
    alarm_at_next_event();
}

void usb_on_taken(void)
{
    hapticd_board_taken(&board);
}

int usb_on_vendor(const struct usb_setup *setup, uint8_t *reply)
{
    return hapticd_board_control(&board, setup->request_type, setup->request, setup->value,
                                 setup->index, setup->length, reply);
}

/* A board that fails its self-test stays off: outputs off, not connected, no light. */
int main(void)
{
    char serial[FLASH_SERIAL_LENGTH];
    chip_start(RESETS_USED);
    port_start();
    flash_serial(serial);
    if (hapticd_board_boot(&board, port_config(serial), &port, chip_next_life())) {
        SIO_GPIO_OUT_SET = 1u << PIN_LED;
        REG(IO_PROC0_INTE + 4u * (PIN_EMERGENCY_STOP / 8u)) = WATCHED_EDGES;
        events_watch();
        chip_watchdog_start(HARDWARE_WATCHDOG_US);
        alarm_at_next_event();
        NVIC_ISER = 1u << IRQ_TIMER_0 | 1u << IRQ_IO_BANK0;
        usb_start(serial);
    }
    for (;;)
        cpu_wait();
}
