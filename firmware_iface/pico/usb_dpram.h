/* usb_dpram.h - memory of the USB controller (4.1.2.5), shared by usb.c and usb_control.c.
 *
 * The controller owns a buffer while AVAILABLE is set in its control word. It returns the buffer
 * with a bit in BUFF_STATUS. The firmware alternates DATA0 and DATA1.
 */
#ifndef USB_DPRAM_H
#define USB_DPRAM_H

#include "rp2040.h"
#include "usb.h"

enum usb_direction { USB_IN, USB_OUT };

#define SETUP_LOW REG(USB_DPRAM)
#define SETUP_HIGH REG(USB_DPRAM + 4u)
#define ENDPOINT(ep, direction) REG(USB_DPRAM + 8u * (ep) + 4u * (direction))
#define BUFFER(ep, direction) REG(USB_DPRAM + 0x80u + 8u * (ep) + 4u * (direction))
#define CONTROL_BUFFER 0x100u /* its place in the controller */
#define OUT_BUFFER 0x180u
#define IN_BUFFER 0x1c0u

/* of a buffer control word (4.1.2.5.3) */
#define FULL (1u << 15)
#define LAST (1u << 14)
#define DATA1 (1u << 13)
#define STALL (1u << 11)
#define AVAILABLE (1u << 10)
#define LENGTH 0x3ffu

/* of BUFF_STATUS, EP_ABORT and, for endpoint 0, EP_STALL_ARM */
#define BIT(ep, direction) (1u << (2u * (ep) + (direction)))

#define ADDRESS_IN 0x81u /* of the two endpoints */
#define ADDRESS_OUT 0x01u

/* The controller reads the word with its own clock of 48 MHz: AVAILABLE must follow the rest by
 * at least one of its cycles (4.1.2.5.4). Six branches are 12 cycles of the processor. */
static inline void buffer_arm(uint32_t ep, enum usb_direction direction, uint32_t control)
{
    BUFFER(ep, direction) = control;
    __asm__ volatile("b 1f\n1: b 1f\n1: b 1f\n1: b 1f\n1: b 1f\n1: b 1f\n1:" ::: "memory");
    BUFFER(ep, direction) = control | AVAILABLE;
}

static inline void buffer_fill(uint32_t offset, const uint8_t *from, uint32_t size)
{
    volatile uint8_t *to = (volatile uint8_t *)(USB_DPRAM + offset);
    while (size--)
        *to++ = *from++;
}

/* --- usb.c for usb_control.c ------------------------------------------------------------------ */

/* Both endpoints start with DATA0 and no halt, or are switched off. */
void usb_configure(bool on);
bool usb_configured(void);
void usb_set_halt(uint8_t address, bool halt);
bool usb_halted(uint8_t address);

/* --- usb_control.c for usb.c ------------------------------------------------------------------ */

void control_start(const char *serial);
void control_reset(void);
void control_setup(void);
void control_sent(void);

#endif
