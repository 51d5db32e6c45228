"""Defects of the Pico's firmware, inserted into a copy of its sources, with the check of
`pico_checks` that finds each. For a defect that only a real chip would not tolerate, the kind of
the emulator's complaint is added.
"""

from typing import NamedTuple

from support.pico_chip import B1, B2
from support.pico_firmware import Change


class Defect(NamedTuple):
    """The change, the check that finds it, the complaint if any, and the silicon."""

    changes: tuple[Change, ...]
    check: str
    complaint: str = ""
    chip_id: int = B2


def _one(file: str, old: str, new: str, check: str, complaint: str = "") -> Defect:
    return Defect(((file, old, new),), check, complaint)


POWER_UP = "power_up"
IN_TOGGLE = "    in_armed = false;\n    in_pid ^= DATA1;\n"
TWO_STEPS = """\
    BUFFER(ep, direction) = control;
    __asm__ volatile("b 1f\\n1: b 1f\\n1: b 1f\\n1: b 1f\\n1: b 1f\\n1: b 1f\\n1:" ::: "memory");
    BUFFER(ep, direction) = control | AVAILABLE;
"""
ABORT = """\
    REG(USB_EP_ABORT + SET) = bit;
    while (!(USB_EP_ABORT_DONE & bit))
        ;
"""
ACKNOWLEDGED = """\
    const uint32_t passed = USB_BUFF_STATUS;
    USB_BUFF_STATUS = passed;
"""
LAST_HANDLER = """\
    if (passed & BIT(1, USB_OUT))
        out_passed();
"""

DEFECTS = {
    # --- the bus
    "toggle of IN kept": _one("usb.c", IN_TOGGLE, "    in_armed = false;\n", "exchange", "toggle"),
    "toggle of OUT kept": _one("usb.c", "    out_pid ^= DATA1;\n", "", "exchange", "toggle"),
    "AVAILABLE in one write": _one(
        "usb_dpram.h",
        TWO_STEPS,
        "    BUFFER(ep, direction) = control | AVAILABLE;\n",
        "exchange",
        "available",
    ),
    "a frame replaced without an abort": _one("usb.c", ABORT, "", "replaced", "owned"),
    "EP_ABORT on old silicon": Defect(
        (("usb.c", "cannot_abort = chip_older_than_b2();", "cannot_abort = false;"),),
        "replaced",
        "abort",
        B1,
    ),
    "toggle kept over an abort that came late": _one(
        "usb.c",
        "    if (USB_BUFF_STATUS & bit)\n        in_pid ^= DATA1;\n",
        "",
        "race",
        "toggle",
    ),
    "BUFF_STATUS acknowledged after the handlers": Defect(
        (
            ("usb.c", ACKNOWLEDGED, "    const uint32_t passed = USB_BUFF_STATUS;\n"),
            ("usb.c", LAST_HANDLER, LAST_HANDLER + "    USB_BUFF_STATUS = passed;\n"),
        ),
        "burst",
    ),
    "address taken before its status": _one(
        "usb_control.c",
        "        new_address = setup->value & 0x7f;\n",
        "        USB_ADDR_ENDP = setup->value & 0x7f;\n",
        POWER_UP,
    ),
    # --- clocks and resets
    "USBCTRL left in reset": _one(
        "main.c", "RESET_SPI0 | RESET_USBCTRL)", "RESET_SPI0)", POWER_UP, "reset"
    ),
    "CLK_USB off": _one(
        "chip.c", "    CLK_USB_CTRL = CLK_ENABLE;  /* from PLL_USB */\n", "", POWER_UP, "clock"
    ),
    "PLL_USB at 60 MHz": _one(
        "chip.c",
        "pll_start(PLL_USB, 100, 5, 5)",
        "pll_start(PLL_USB, 100, 5, 4)",
        POWER_UP,
        "clock",
    ),
    "no tick": _one(
        "chip.c", "    WATCHDOG_TICK = TICK_CYCLES | WATCHDOG_TICK_ENABLE;\n", "", POWER_UP, "clock"
    ),
    "random bit of a register that is not there": _one(
        "rp2040.h", "REG(0x4006001cu)", "REG(0x40060024u)", POWER_UP, "unknown"
    ),
    "decoder at a fraction of the clock": _one(
        "encoder.c",
        "CLOCK_DIVIDER_1 (1u << 16)",
        "CLOCK_DIVIDER_1 (1u << 16 | 128u << 8)",
        POWER_UP,
        "unmodelled",
    ),
    "SSI set up while it is enabled": _one(
        "flash_id.c", "    SSI_SSIENR = 0;\n", "", POWER_UP, "flash"
    ),
    # --- the hardware watchdog
    "watchdog not fed": _one(
        "main.c", "    chip_watchdog_feed(HARDWARE_WATCHDOG_US);\n", "", POWER_UP
    ),
    "watchdog fed from the main loop": Defect(
        (
            ("main.c", "    chip_watchdog_feed(HARDWARE_WATCHDOG_US);\n", ""),
            (
                "main.c",
                "        cpu_wait();\n",
                "        chip_watchdog_feed(HARDWARE_WATCHDOG_US);\n",
            ),
        ),
        "deaf",
    ),
    "watchdog not started": _one(
        "main.c", "        chip_watchdog_start(HARDWARE_WATCHDOG_US);\n", "", "hang"
    ),
    "watchdog that resets the processor alone": _one(
        "chip.c", "    PSM_WDSEL = PSM_ALL_BUT_OSCILLATORS;\n", "", "hang", "watchdog"
    ),
    "life kept in flash, which a store does not write": _one(
        "chip.c",
        "    WATCHDOG_SCRATCH0 = LIFE_MAGIC | life;\n",
        "    REG(0x101ff000u) = LIFE_MAGIC | life;\n",
        "hang",
        "address",
    ),
    "life not counted": _one("chip.c", "    WATCHDOG_SCRATCH0 = LIFE_MAGIC | life;\n", "", "hang"),
    # --- pins and parts
    "DAC channels swapped": Defect(
        (("dac_parts.c", "0x180000, 0x190000", "0x190000, 0x180000"),),
        "outputs",
    ),
    "DAC at the other edge": _one(
        "dac_parts.c", "{16, 3, 1, true", "{16, 3, 0, true", POWER_UP, "spi"
    ),
    "reference of the DAC off": _one(
        "dac_parts.c", "0x190000, 0, 0x380001", "0x190000, 0, 0", "outputs"
    ),
    "channels of the DAC8812 swapped": _one(
        "dac_parts.c", "0x010000, 0x020000", "0x020000, 0x010000", "outputs"
    ),
    "word of the DAC8812 too short": _one(
        "dac_parts.c", "[DAC8812] = {16, 3,", "[DAC8812] = {16, 2,", POWER_UP, "spi"
    ),
    "DAC8812 at the other edge": _one(
        "dac_parts.c", "{16, 3, 0, false", "{16, 3, 1, false", POWER_UP, "spi"
    ),
    "one word to both DACs": _one(
        "dac.c",
        "1u << (ONE_PART ? PIN_DAC_SELECT : PIN_DAMPING_SELECT)",
        "1u << PIN_DAC_SELECT | 1u << PIN_DAMPING_SELECT",
        POWER_UP,
        "spi",
    ),
    "edge of the SPI changed while it is on": _one(
        "dac.c", "    SPI_CR1 = 0;\n", "", POWER_UP, "spi"
    ),
    "trim stated and not set": _one(
        "port.c", "    dac_set_resistance(count);\n", "    (void)count;\n", "trim"
    ),
    "trim below the coldest winding": _one(
        "dac_parts.c", "count > 0 ? 2u * (uint32_t)count : 0", "2u * (uint32_t)count", "trim"
    ),
    "words of the PIO program two bytes apart": _one(
        "rp2040.h", "0x50200048u + 4u * (i)", "0x50200048u + 2u * (i)", POWER_UP, "alignment"
    ),
    "encoder's A and B swapped": Defect(
        (
            (
                "encoder.c",
                "JMP(UP), JMP(DOWN), JMP(SKIP), /* 00",
                "JMP(DOWN), JMP(UP), JMP(SKIP), /* 00",
            ),
            (
                "encoder.c",
                "JMP(DOWN), JMP(SAME), JMP(SKIP), JMP(UP), /* 01",
                "JMP(UP), JMP(SAME), JMP(SKIP), JMP(DOWN), /* 01",
            ),
            (
                "encoder.c",
                "JMP(UP), JMP(SKIP), JMP(SAME), JMP(DOWN), /* 10",
                "JMP(DOWN), JMP(SKIP), JMP(SAME), JMP(UP), /* 10",
            ),
            (
                "encoder.c",
                "JMP(SKIP), JMP(DOWN), JMP(UP), JMP(SAME), /* 11",
                "JMP(SKIP), JMP(UP), JMP(DOWN), JMP(SAME), /* 11",
            ),
        ),
        "encoder",
    ),
    "a skip is not told": _one("port.c", "    if (encoder_skipped())\n", "    if (0)\n", "skip"),
    "stop input not pulled": _one(
        "port.c",
        "    input(PIN_EMERGENCY_STOP, PAD_PULL_DOWN, FUNCTION_SIO);\n",
        "    input(PIN_EMERGENCY_STOP, 0, FUNCTION_SIO);\n",
        "stop",
    ),
    "stop without its interrupt": _one(
        "main.c",
        "        REG(IO_PROC0_INTE + 4u * (PIN_EMERGENCY_STOP / 8u)) = WATCHED_EDGES;\n",
        "",
        "stop",
    ),
    "stop's interrupt without a handler": _one(
        "start.c",
        "    [16 + IRQ_IO_BANK0] = {.handler = io_irq},\n",
        "    [16 + IRQ_IO_BANK0] = NONE,\n",
        "stop",
        "breakpoint",
    ),
    "ready input not pulled": _one(
        "port.c",
        "    input(PIN_AMPLIFIER_READY, PAD_PULL_DOWN, FUNCTION_SIO);\n",
        "    input(PIN_AMPLIFIER_READY, 0, FUNCTION_SIO);\n",
        "ready",
    ),
    "amplifier left on": _one(
        "port.c",
        "        SIO_GPIO_OUT_CLR = AMPLIFIER;\n        dac_rest();\n",
        "        dac_rest();\n",
        "stop",
    ),
}
