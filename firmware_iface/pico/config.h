/* config.h - the properties of this board. Each value may be set on the compiler's command line. */
#ifndef CONFIG_H
#define CONFIG_H

/* the row of dac_parts.c that makes the torque: DAC8563 or MCP4922 */
#ifndef DAC_PART
#define DAC_PART DAC8563
#endif
/* and the one that makes the damping: the DAC8812 of firmware_iface/hardware, whose other channel
 * trims the resistance; or DAC_PART again, whose channel B is then a voltage */
#ifndef DAMPING_PART
#define DAMPING_PART DAC8812
#endif

/* nominal full scales of HELLO; the device file on the host has the measured ones */
#ifndef FORCE_FULL_SCALE_N
#define FORCE_FULL_SCALE_N 8.0f
#endif
#ifndef FORCE_LIMIT_N
#define FORCE_LIMIT_N 8.0f
#endif
#ifndef DAMPING_FULL_SCALE_NS_PER_M
#define DAMPING_FULL_SCALE_NS_PER_M 10.0f
#endif
#ifndef POSITION_M_PER_COUNT
#define POSITION_M_PER_COUNT 0.5e-6f
#endif

/* not measured by this board: the fields are 0, but a full scale must be a number */
#define PROBE_TORQUE_FULL_SCALE_N 2.0f
#define PROBE_VELOCITY_FULL_SCALE_M_S 2.0f
#define CURRENT_FULL_SCALE_A 10.0f
#define VOLTAGE_FULL_SCALE_V 30.0f

#ifndef PERIOD_US
#define PERIOD_US 1000
#endif
#define PHASE_US (PERIOD_US * 7 / 8)
#ifndef WATCHDOG_MS
#define WATCHDOG_MS 20 /* of the protocol: a silent host */
#endif
#define HARDWARE_WATCHDOG_US 5000 /* a processor that hangs */

#define FIRMWARE_VERSION 0x0100

#endif
