/* flash_id.c - command 4Bh of the flash (W25Q16JV 8.2.31): four bytes are ignored, eight are read.
 *
 * The SSI selects the chip as long as its FIFO of 16 bytes is not empty, so all 13 bytes are
 * written at once; no interrupt may occur between them.
 */
#include "flash_id.h"

#include "rp2040.h"

#define READ_UNIQUE_ID 0x4bu
#define IGNORED 5 /* the command's own byte and four after it */
#define ID_BYTES 8
#define CLOCK_DIVIDER 8u /* 15.6 MHz */

static void ssi_start(void)
{
    SSI_SSIENR = 0;
    SSI_BAUDR = CLOCK_DIVIDER;
    SSI_CTRLR0 = SSI_8_BITS_BOTH_WAYS;
    SSI_SSIENR = 1;
}

static uint32_t ssi_receive(void)
{
    while (!(SSI_SR & SSI_SR_RFNE))
        ;
    return SSI_DR0;
}

void flash_serial(char serial[FLASH_SERIAL_LENGTH])
{
    static const char digits[] = "0123456789ABCDEF";
    ssi_start();
    SSI_DR0 = READ_UNIQUE_ID;
    for (int i = 1; i < IGNORED + ID_BYTES; i++)
        SSI_DR0 = 0;
    for (int i = 0; i < IGNORED; i++)
        ssi_receive();
    for (int i = 0; i < ID_BYTES; i++) {
        uint32_t byte = ssi_receive();
        *serial++ = digits[byte >> 4 & 0xf];
        *serial++ = digits[byte & 0xf];
    }
}
