/* port.h - the hardware behind the reference firmware, and the properties of this board. */
#ifndef PORT_H
#define PORT_H

#include "hapticd_board.h"

extern const struct hapticd_port port;

/* Set up all pins, with the amplifier off before its pin is an output; start DAC and encoder. */
void port_start(void);

/* Return HELLO and limits of config.h, with the serial number of 16 characters. */
const struct hapticd_config *port_config(const char *serial);

#endif
