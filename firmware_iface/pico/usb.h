/* usb.h - device controller of the RP2040: one vendor interface, bulk OUT and IN of 64 bytes. */
#ifndef USB_H
#define USB_H

#include <stdbool.h>
#include <stdint.h>

#define USB_PACKET 64
#define USB_REPLY_MAX 128
#define USB_SERIAL_MAX 16
#define USB_STALL (-1)

struct usb_setup { /* USB 2.0, 9.3 */
    uint8_t request_type;
    uint8_t request;
    uint16_t value;
    uint16_t index;
    uint16_t length;
};

/* Connect to the host, with this serial number of USB_SERIAL_MAX characters. From now on the
 * interrupt USBCTRL calls usb_on_out, usb_on_taken and usb_on_vendor. */
void usb_start(const char *serial);

/* The IN endpoint holds this packet from now on; it replaces an unread one. Silicon older than B2
 * cannot reclaim a buffer: there the new packet is dropped. */
void usb_send(const void *data, uint32_t size);

/* Call usb_on_taken now if a packet was read and its interrupt is still pending. */
void usb_collect(void);

/* --- of the application ----------------------------------------------------------------------- */

void usb_on_out(const uint8_t *data, uint32_t size);
void usb_on_taken(void);

/* A vendor request without data from the host. Returns the bytes in `reply`, or USB_STALL. */
int usb_on_vendor(const struct usb_setup *setup, uint8_t *reply);

#endif
