/* string.h - the three functions of it that the reference firmware uses; the compiler brings none. */
#ifndef PICO_STRING_H
#define PICO_STRING_H

#include <stddef.h>

void *memcpy(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);
int memcmp(const void *first, const void *second, size_t size);

#endif
