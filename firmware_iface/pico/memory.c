/* memory.c - memcpy, memset and memcmp, which the compiler also calls by itself. */
#include <string.h>

void *memcpy(void *to, const void *from, size_t size)
{
    unsigned char *write = to;
    const unsigned char *read = from;
    while (size--)
        *write++ = *read++;
    return to;
}

void *memset(void *to, int value, size_t size)
{
    unsigned char *write = to;
    while (size--)
        *write++ = (unsigned char)value;
    return to;
}

int memcmp(const void *first, const void *second, size_t size)
{
    const unsigned char *a = first;
    const unsigned char *b = second;
    for (; size--; a++, b++)
        if (*a != *b)
            return *a - *b;
    return 0;
}
