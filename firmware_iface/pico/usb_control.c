/* usb_control.c - endpoint 0: descriptors, standard requests (USB 2.0, 9.4), vendor requests.
 *
 * No supported request has data from the host: a transfer is data to the host and an empty OUT, or
 * only an empty IN.
 */
#include <stddef.h>

#include "config.h"
#include "hapticd_wire.h"
#include "usb_dpram.h"

enum {
    GET_STATUS,
    CLEAR_FEATURE,
    SET_FEATURE = 3,
    SET_ADDRESS = 5,
    GET_DESCRIPTOR,
    GET_CONFIGURATION = 8,
    SET_CONFIGURATION,
    GET_INTERFACE,
    SET_INTERFACE
};
enum { DEVICE = 1, CONFIGURATION, STRING };
enum { TO_DEVICE, TO_INTERFACE, TO_ENDPOINT };

#define RECIPIENT 0x1fu
#define TYPE 0x60u
#define TYPE_STANDARD 0x00u
#define TYPE_VENDOR 0x40u
#define TO_HOST 0x80u
#define FEATURE_HALT 0
#define ENGLISH_US 0x0409
#define LOW(word) ((word) & 0xff)
#define HIGH(word) ((word) >> 8)

static const uint8_t device_descriptor[] = {
    18, DEVICE, 0x00, 0x02,                                   /* USB 2.0 */
    0xff, 0, 0, USB_PACKET,                                   /* vendor class */
    LOW(HAPTICD_USB_VENDOR_ID), HIGH(HAPTICD_USB_VENDOR_ID),
    LOW(HAPTICD_USB_PRODUCT_ID), HIGH(HAPTICD_USB_PRODUCT_ID),
    LOW(FIRMWARE_VERSION), HIGH(FIRMWARE_VERSION),
    1, 2, 3, 1};                                              /* strings, one configuration */
static const uint8_t configuration_descriptor[] = {
    9, CONFIGURATION, 32, 0, 1, 1, 0, 0x80, 50,               /* 100 mA from the bus */
    9, 4, 0, 0, 2, 0xff, 0, 0, 0,                             /* interface 0: vendor, 2 endpoints */
    7, 5, ADDRESS_OUT, 2, USB_PACKET, 0, 0,                   /* bulk */
    7, 5, ADDRESS_IN, 2, USB_PACKET, 0, 0};
static const char *const names[] = {"hapticd", "hapticd board on a Raspberry Pi Pico"};

static char serial_number[USB_SERIAL_MAX + 1];
static uint8_t reply[USB_REPLY_MAX];
static const uint8_t *data_left;
static uint32_t bytes_left;
static bool empty_packet;   /* ends short data that fill their last packet */
static bool status_out;     /* the transfer ends with an empty OUT */
static uint32_t pid;
static uint8_t new_address; /* valid once the status of SET_ADDRESS has passed */

/* --- replies ---------------------------------------------------------------------------------- */

static void stall(void)
{
    USB_EP_STALL_ARM = BIT(0, USB_IN) | BIT(0, USB_OUT);
    BUFFER(0, USB_IN) = STALL;
    BUFFER(0, USB_OUT) = STALL;
}

static void send_next(void)
{
    const uint32_t size = bytes_left < USB_PACKET ? bytes_left : USB_PACKET;
    buffer_fill(CONTROL_BUFFER, data_left, size);
    data_left += size;
    bytes_left -= size;
    if (size < USB_PACKET)
        empty_packet = false;
    buffer_arm(0, USB_IN, size | FULL | LAST | pid);
    pid ^= DATA1;
}

static void answer(const uint8_t *data, uint32_t size, uint32_t asked)
{
    data_left = data;
    bytes_left = size < asked ? size : asked;
    empty_packet = bytes_left < asked;
    status_out = asked;
    pid = DATA1;
    send_next();
}

/* --- standard requests ------------------------------------------------------------------------ */

static int string_descriptor(uint8_t index)
{
    uint8_t size = 2;
    if (index > 3)
        return USB_STALL;
    if (!index) {
        reply[size++] = LOW(ENGLISH_US);
        reply[size++] = HIGH(ENGLISH_US);
    } else {
        const char *from = index == 3 ? serial_number : names[index - 1];
        for (; *from && size < USB_REPLY_MAX; size = (uint8_t)(size + 2)) {
            reply[size] = (uint8_t)*from++;
            reply[size + 1] = 0;
        }
    }
    reply[0] = size;
    reply[1] = STRING;
    return size;
}

static int descriptor(uint16_t value, const uint8_t **data)
{
    switch (HIGH(value)) {
    case DEVICE:
        *data = device_descriptor;
        return sizeof device_descriptor;
    case CONFIGURATION:
        *data = configuration_descriptor;
        return sizeof configuration_descriptor;
    case STRING:
        return string_descriptor((uint8_t)value);
    default:
        return USB_STALL;
    }
}

static int byte(uint8_t value)
{
    reply[0] = value;
    return 1;
}

static int configure(uint16_t value)
{
    if (value > 1)
        return USB_STALL;
    usb_configure(value);
    return 0;
}

static bool known_endpoint(uint16_t index)
{
    return usb_configured() && (index == ADDRESS_IN || index == ADDRESS_OUT);
}

static int status(uint8_t recipient, uint16_t index)
{
    reply[0] = 0;
    reply[1] = 0;
    if (recipient != TO_ENDPOINT || !(index & 0x7f))
        return 2;
    if (!known_endpoint(index))
        return USB_STALL;
    reply[0] = usb_halted((uint8_t)index);
    return 2;
}

static int feature(const struct usb_setup *setup)
{
    if ((setup->request_type & RECIPIENT) != TO_ENDPOINT || setup->value != FEATURE_HALT ||
        !known_endpoint(setup->index))
        return USB_STALL;
    usb_set_halt((uint8_t)setup->index, setup->request == SET_FEATURE);
    return 0;
}

/* Return the bytes of `data`, or USB_STALL. */
static int standard(const struct usb_setup *setup, const uint8_t **data)
{
    switch (setup->request) {
    case GET_STATUS:
        return status(setup->request_type & RECIPIENT, setup->index);
    case CLEAR_FEATURE:
    case SET_FEATURE:
        return feature(setup);
    case SET_ADDRESS:
        new_address = setup->value & 0x7f;
        return 0;
    case GET_DESCRIPTOR:
        return descriptor(setup->value, data);
    case GET_CONFIGURATION:
        return byte(usb_configured());
    case SET_CONFIGURATION:
        return configure(setup->value);
    case GET_INTERFACE:
        return byte(0);
    case SET_INTERFACE:
        return setup->value || setup->index ? USB_STALL : configure(usb_configured());
    default:
        return USB_STALL;
    }
}

/* --- called by usb.c -------------------------------------------------------------------------- */

/* A new transfer ends an incomplete one. */
void control_setup(void)
{
    const uint32_t low = SETUP_LOW;
    const uint32_t high = SETUP_HIGH;
    const struct usb_setup setup = {(uint8_t)low, (uint8_t)(low >> 8), (uint16_t)(low >> 16),
                                    (uint16_t)high, (uint16_t)(high >> 16)};
    const uint8_t *data = reply;
    int size = USB_STALL;
    BUFFER(0, USB_IN) = 0;
    BUFFER(0, USB_OUT) = 0;
    USB_BUFF_STATUS = BIT(0, USB_IN) | BIT(0, USB_OUT);
    control_reset();
    if (setup.length && !(setup.request_type & TO_HOST))
        size = USB_STALL;
    else if ((setup.request_type & TYPE) == TYPE_STANDARD)
        size = standard(&setup, &data);
    else if ((setup.request_type & TYPE) == TYPE_VENDOR)
        size = usb_on_vendor(&setup, reply);
    if (size < 0)
        stall();
    else
        answer(data, (uint32_t)size, setup.length);
}

void control_sent(void)
{
    if (new_address)
        USB_ADDR_ENDP = new_address;
    new_address = 0;
    if (bytes_left || empty_packet)
        send_next();
    else if (status_out)
        buffer_arm(0, USB_OUT, USB_PACKET | LAST | DATA1);
}

void control_reset(void)
{
    new_address = 0;
    bytes_left = 0;
    empty_packet = false;
    status_out = false;
}

void control_start(const char *serial)
{
    for (uint32_t i = 0; i < USB_SERIAL_MAX; i++)
        serial_number[i] = serial[i];
}
