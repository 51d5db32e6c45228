/* usb.c - see usb.h: the bulk endpoints, and the interrupt of the controller (4.1).
 *
 * Limitations: no interrupt may occur between two functions of this file.
 */
#include "usb.h"

#include "chip.h"
#include "usb_dpram.h"

#define ENDPOINT_BULK (1u << 31 | 1u << 29 | 2u << 26) /* enabled, one interrupt per buffer, bulk */
#define INT_BUFFERS (1u << 4)
#define INT_BUS_RESET (1u << 12)
#define INT_SETUP (1u << 16)
#define SIE_BUS_RESET (1u << 19)
#define SIE_SETUP (1u << 17)
#define SIE_PULL_UP (1u << 16)
#define SIE_EP0_INTERRUPT (1u << 29)
#define MUXING_TO_PHY (1u << 0 | 1u << 3)
#define PWR_VBUS_DETECTED (1u << 2 | 1u << 3)
#define CONTROLLER_ENABLE 1u

static bool configured;
static bool in_halted, out_halted;
static bool in_armed;            /* the host may read a packet */
static bool superseded;          /* it is not the newest */
static uint32_t in_pid, out_pid; /* of the next packet: 0 or DATA1 */
static bool cannot_abort;        /* RP2040-E2 */

/* --- IN --------------------------------------------------------------------------------------- */

/* The application treats a report as that of its last packet and discards the contents. An older
 * packet is therefore not reported. */
static void in_passed(void)
{
    in_armed = false;
    in_pid ^= DATA1;
    if (!superseded)
        usb_on_taken();
    superseded = false;
}

/* The host gets NAK while the buffer is reclaimed. A packet may still have passed. */
static void take_back(void)
{
    const uint32_t bit = BIT(1, USB_IN);
    REG(USB_EP_ABORT + SET) = bit;
    while (!(USB_EP_ABORT_DONE & bit))
        ;
    if (USB_BUFF_STATUS & bit)
        in_pid ^= DATA1;
    USB_BUFF_STATUS = bit;
    BUFFER(1, USB_IN) = in_pid;
    USB_EP_ABORT_DONE = bit;
    REG(USB_EP_ABORT + CLR) = bit;
}

void usb_send(const void *data, uint32_t size)
{
    if (!configured || in_halted)
        return;
    superseded = in_armed && cannot_abort;
    if (superseded)
        return;
    if (in_armed)
        take_back();
    buffer_fill(IN_BUFFER, data, size);
    in_armed = true;
    buffer_arm(1, USB_IN, size | FULL | LAST | in_pid);
}

void usb_collect(void)
{
    if (!(USB_BUFF_STATUS & BIT(1, USB_IN)))
        return;
    USB_BUFF_STATUS = BIT(1, USB_IN);
    in_passed();
}

/* --- OUT -------------------------------------------------------------------------------------- */

static void out_arm(void)
{
    buffer_arm(1, USB_OUT, USB_PACKET | LAST | out_pid);
    out_pid ^= DATA1;
}

/* The buffer is free for the next packet before this one is processed. */
static void out_passed(void)
{
    uint8_t packet[USB_PACKET];
    const volatile uint8_t *from = (const volatile uint8_t *)(USB_DPRAM + OUT_BUFFER);
    uint32_t size = BUFFER(1, USB_OUT) & LENGTH;
    if (size > sizeof packet)
        size = sizeof packet;
    for (uint32_t i = 0; i < size; i++)
        packet[i] = from[i];
    out_arm();
    usb_on_out(packet, size);
}

/* --- both ------------------------------------------------------------------------------------- */

/* The host does not use an endpoint while it changes its state, so no abort is needed. */
static void in_begin(bool halt)
{
    BUFFER(1, USB_IN) = halt ? STALL : 0;
    USB_BUFF_STATUS = BIT(1, USB_IN);
    in_halted = halt;
    in_armed = false;
    superseded = false;
    in_pid = 0;
}

static void out_begin(bool halt)
{
    BUFFER(1, USB_OUT) = halt ? STALL : 0;
    USB_BUFF_STATUS = BIT(1, USB_OUT);
    out_halted = halt;
    out_pid = 0;
    if (configured && !halt)
        out_arm();
}

void usb_configure(bool on)
{
    configured = on;
    ENDPOINT(1, USB_IN) = on ? ENDPOINT_BULK | IN_BUFFER : 0;
    ENDPOINT(1, USB_OUT) = on ? ENDPOINT_BULK | OUT_BUFFER : 0;
    in_begin(false);
    out_begin(false);
}

bool usb_configured(void)
{
    return configured;
}

void usb_set_halt(uint8_t address, bool halt)
{
    if (address == ADDRESS_IN)
        in_begin(halt);
    else
        out_begin(halt);
}

bool usb_halted(uint8_t address)
{
    return address == ADDRESS_IN ? in_halted : out_halted;
}

/* --- the controller --------------------------------------------------------------------------- */

static void bus_reset(void)
{
    USB_SIE_STATUS = SIE_BUS_RESET;
    USB_ADDR_ENDP = 0;
    usb_configure(false);
    control_reset();
}

/* BUFF_STATUS is acknowledged before the handlers: buffers that they arm may pass meanwhile. */
static void buffers_passed(void)
{
    const uint32_t passed = USB_BUFF_STATUS;
    USB_BUFF_STATUS = passed;
    if (passed & BIT(0, USB_IN))
        control_sent();
    if (passed & BIT(1, USB_IN))
        in_passed();
    if (passed & BIT(1, USB_OUT))
        out_passed();
}

void usb_irq(void);
void usb_irq(void)
{
    const uint32_t why = USB_INTS;
    if (why & INT_BUS_RESET)
        bus_reset();
    if (why & INT_BUFFERS)
        buffers_passed();
    if (why & INT_SETUP) {
        USB_SIE_STATUS = SIE_SETUP;
        control_setup();
    }
}

void usb_start(const char *serial)
{
    for (uint32_t at = 0; at < CONTROL_BUFFER; at += 4)
        REG(USB_DPRAM + at) = 0;
    cannot_abort = chip_older_than_b2();
    control_start(serial);
    USB_MUXING = MUXING_TO_PHY;
    USB_PWR = PWR_VBUS_DETECTED; /* the chip is powered from it */
    USB_MAIN_CTRL = CONTROLLER_ENABLE;
    REG(USB_SIE_CTRL) = SIE_EP0_INTERRUPT;
    USB_INTE = INT_BUFFERS | INT_BUS_RESET | INT_SETUP;
    NVIC_ISER = 1u << IRQ_USBCTRL;
    REG(USB_SIE_CTRL + SET) = SIE_PULL_UP;
}
