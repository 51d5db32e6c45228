/* pins.h - the connections of the GPIOs; docs/pico.md has the wiring. */
#ifndef PINS_H
#define PINS_H

#define PIN_ENCODER_A 2
#define PIN_ENCODER_B 3 /* the pin after A: the PIO program reads both at once */
#define PIN_EVENT_FIRST 4
#define PIN_EVENT_COUNT 8
/* 12 to 15 are SPI1, reserved for a sampling ADC */
#define PIN_DAMPING_SELECT 16
#define PIN_DAC_SELECT 17
#define PIN_DAC_CLOCK 18
#define PIN_DAC_DATA 19
#define PIN_AMPLIFIER_ENABLE 20
#define PIN_EMERGENCY_STOP 21
#define PIN_AMPLIFIER_READY 22
#define PIN_LED 25

#endif
