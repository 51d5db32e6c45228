/* port.h - the hardware behind the reference firmware, and what this board tells of itself. */
#ifndef PORT_H
#define PORT_H

#include "hapticd_board.h"

extern const struct hapticd_port port;

/* Pins as they have to be, the amplifier off before it is an output; DAC and encoder run. */
void port_start(void);

/* HELLO and limits of config.h, with the serial number of 16 characters. */
const struct hapticd_config *port_config(const char *serial);

#endif
