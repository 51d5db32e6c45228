/* boot2.S - second boot stage (2.8.1.3.1). The boot ROM reads these 252 bytes from flash, checks
 * the CRC that image.py puts behind them, copies them to SRAM and jumps there.
 *
 * It makes the flash readable in place by the serial read 03h, which every chip has, and starts
 * the program. The program is copied to RAM once (start.c), so the speed of flash is irrelevant.
 */
    .syntax unified
    .cpu cortex-m0plus
    .thumb

    .equ XIP_SSI, 0x18000000            /* 4.10.13 */
    .equ CTRLR0, 0x00
    .equ CTRLR1, 0x04
    .equ SSIENR, 0x08
    .equ BAUDR, 0x14
    .equ EEPROM_READ_32_BITS, 0x001f0300
    .equ SPI_CTRLR0, 0xf4
    .equ READ_03H_24_BITS, 0x03000218   /* instruction of 8 bits, address of 24, both serial */
    .equ PROGRAM, 0x10000100
    .equ VTOR, 0xe000ed08

    .section .boot2, "ax"
    .global boot2
    .thumb_func
boot2:
    push {lr}
    ldr r3, =XIP_SSI
    movs r1, #0
    str r1, [r3, #SSIENR]               /* off while it is set up */
    movs r1, #4
    str r1, [r3, #BAUDR]                /* clk_sys / 4 */
    ldr r1, =EEPROM_READ_32_BITS
    str r1, [r3, #CTRLR0]
    movs r1, #0
    str r1, [r3, #CTRLR1]               /* one word a read */
    ldr r1, =READ_03H_24_BITS
    ldr r0, =(XIP_SSI + SPI_CTRLR0)
    str r1, [r0]
    movs r1, #1
    str r1, [r3, #SSIENR]
    pop {r0}                            /* 0 from the boot ROM; else a caller to return to */
    cmp r0, #0
    beq start
    bx r0
start:
    ldr r0, =PROGRAM
    ldr r1, =VTOR
    str r0, [r1]
    ldmia r0!, {r1, r2}                 /* stack, entry */
    msr msp, r1
    bx r2
    .ltorg
