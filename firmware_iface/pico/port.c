/* port.c - see port.h. docs/development/porting-firmware.md specifies each function. */
#include "port.h"

#include <string.h>

#include "chip.h"
#include "config.h"
#include "dac.h"
#include "dac_parts.h"
#include "encoder.h"
#include "events.h"
#include "pins.h"
#include "rp2040.h"
#include "usb.h"

#define AMPLIFIER (1u << PIN_AMPLIFIER_ENABLE)
#define SELECTS (1u << PIN_DAC_SELECT | 1u << PIN_DAMPING_SELECT)
#define TRIM (DAMPING_PART == DAC8812 ? HAPTICD_CAPABILITY_RESISTANCE : 0)
#define CAPABILITIES                                                                               \
    (HAPTICD_CAPABILITY_EMERGENCY_STOP | HAPTICD_CAPABILITY_AMPLIFIER_READY |                      \
     HAPTICD_CAPABILITY_EVENT | TRIM | HAPTICD_CAPABILITY_SAMPLE_PHASE)

/* --- pins ------------------------------------------------------------------------------------- */

static void output(uint32_t pin, uint32_t pull, uint32_t function)
{
    PAD(pin) = PAD_OUTPUT | pull;
    GPIO_CTRL(pin) = function;
}

static void input(uint32_t pin, uint32_t pull, uint32_t function)
{
    PAD(pin) = PAD_INPUT | pull;
    GPIO_CTRL(pin) = function;
}

/* A broken wire reads as a pressed stop, as an amplifier that is not ready, as no event. */
void port_start(void)
{
    SIO_GPIO_OUT_CLR = AMPLIFIER;
    SIO_GPIO_OUT_SET = SELECTS;
    SIO_GPIO_OE_SET = AMPLIFIER | SELECTS | 1u << PIN_LED;
    output(PIN_AMPLIFIER_ENABLE, PAD_PULL_DOWN, FUNCTION_SIO);
    output(PIN_DAC_SELECT, 0, FUNCTION_SIO);
    output(PIN_DAMPING_SELECT, 0, FUNCTION_SIO);
    output(PIN_DAC_CLOCK, 0, FUNCTION_SPI);
    output(PIN_DAC_DATA, 0, FUNCTION_SPI);
    output(PIN_LED, 0, FUNCTION_SIO);
    input(PIN_EMERGENCY_STOP, PAD_PULL_DOWN, FUNCTION_SIO);
    input(PIN_AMPLIFIER_READY, PAD_PULL_DOWN, FUNCTION_SIO);
    input(PIN_ENCODER_A, PAD_PULL_UP, FUNCTION_PIO0);
    input(PIN_ENCODER_B, PAD_PULL_UP, FUNCTION_PIO0);
    for (uint32_t pin = PIN_EVENT_FIRST; pin < PIN_EVENT_FIRST + PIN_EVENT_COUNT; pin++)
        input(pin, PAD_PULL_DOWN, FUNCTION_SIO);
    dac_start();
    encoder_start();
}

/* --- struct hapticd_port ---------------------------------------------------------------------- */

static uint32_t clock_us(void *device)
{
    (void)device;
    return chip_clock_us();
}

static uint16_t inputs(void *device)
{
    const uint32_t pins = SIO_GPIO_IN;
    uint16_t status = 0;
    (void)device;
    if (!(pins & 1u << PIN_EMERGENCY_STOP))
        status |= HAPTICD_STATUS_EMERGENCY_STOP;
    if (pins & 1u << PIN_AMPLIFIER_READY)
        status |= HAPTICD_STATUS_AMPLIFIER_READY;
    if (encoder_skipped())
        status |= HAPTICD_STATUS_ENCODER_FAULT;
    return status;
}

static void sense(void *device, struct hapticd_sensors *sensors)
{
    (void)device;
    sensors->encoder = encoder_count();
}

/* Without PROBE no host asks for pairs. */
static void measure_pair(void *device, int16_t pair[2])
{
    (void)device;
    (void)pair;
}

/* The amplifier goes off before the DAC changes, and on after it. */
static void set_torque(void *device, bool authority, int16_t count)
{
    (void)device;
    if (authority) {
        dac_set_torque(count);
        SIO_GPIO_OUT_SET = AMPLIFIER;
    } else {
        SIO_GPIO_OUT_CLR = AMPLIFIER;
        dac_rest();
    }
}

static void set_damping(void *device, uint16_t count)
{
    (void)device;
    dac_set_damping(count);
}

static void set_resistance(void *device, int16_t count)
{
    (void)device;
    dac_set_resistance(count);
}

/* The perturbation has no DAC here. */
static void set_perturbation(void *device, int16_t count)
{
    (void)device;
    (void)count;
}

static void send(void *device, const struct hapticd_in *frame)
{
    (void)device;
    usb_send(frame, sizeof *frame);
}

static uint16_t event_code(void *device)
{
    (void)device;
    return events_read();
}

const struct hapticd_port port = {
    .clock_us = clock_us,
    .inputs = inputs,
    .sense = sense,
    .measure_pair = measure_pair,
    .set_torque = set_torque,
    .set_perturbation = set_perturbation,
    .set_damping = set_damping,
    .set_resistance = set_resistance,
    .send = send,
    .event_code = event_code,
};

/* --- struct hapticd_config -------------------------------------------------------------------- */

const struct hapticd_config *port_config(const char *serial)
{
    static struct hapticd_config config = {
        .hello =
            {
                .firmware_version = FIRMWARE_VERSION,
                .axis_count = HAPTICD_AXIS_COUNT,
                .capabilities = CAPABILITIES,
                .watchdog_ms = WATCHDOG_MS,
                .force_full_scale_n = FORCE_FULL_SCALE_N,
                .damping_full_scale_ns_per_m = DAMPING_FULL_SCALE_NS_PER_M,
                .probe_torque_full_scale_n = PROBE_TORQUE_FULL_SCALE_N,
                .probe_velocity_full_scale_m_s = PROBE_VELOCITY_FULL_SCALE_M_S,
                .current_full_scale_a = CURRENT_FULL_SCALE_A,
                .voltage_full_scale_v = VOLTAGE_FULL_SCALE_V,
                .position_m_per_count = POSITION_M_PER_COUNT,
                .force_limit_n = FORCE_LIMIT_N,
            },
        .torque_limit = (int16_t)(FORCE_LIMIT_N / FORCE_FULL_SCALE_N * INT16_MAX),
        .period_us = PERIOD_US,
        .phase_us = PHASE_US,
    };
    memcpy(config.hello.serial, serial, sizeof config.hello.serial);
    return &config;
}
