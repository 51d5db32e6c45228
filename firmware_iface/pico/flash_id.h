/* flash_id.h - the serial number of the board: the unique id of its flash. */
#ifndef FLASH_ID_H
#define FLASH_ID_H

#define FLASH_SERIAL_LENGTH 16

/* 16 hexadecimal digits, not terminated. Flash cannot be read in place afterwards. */
void flash_serial(char serial[FLASH_SERIAL_LENGTH]);

#endif
