/* CRC-32 of zlib, Ethernet and PNG. */
#ifndef CRC32_H
#define CRC32_H

#include <stddef.h>
#include <stdint.h>

/* The checksum of all that made `crc` and `size` bytes more; begin with 0. */
uint32_t crc32_add(uint32_t crc, const void *data, size_t size);

/* The same for one number of two bytes, low byte first. */
uint32_t crc32_add_u16(uint32_t crc, uint16_t value);

#endif
