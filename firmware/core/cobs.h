/* Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999): packets without a zero byte, each ended by one. */
#ifndef COBS_H
#define COBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Undoes the stuffing byte by byte. `data` is only written below `capacity`. */
typedef struct {
    uint8_t *data;
    size_t capacity;
    size_t size;      /* bytes undone so far */
    uint8_t left;     /* bytes to come before the next code */
    bool zero;        /* the next code stands for a zero */
    bool dropping;    /* longer than `capacity`: nothing counts up to the next zero byte */
} cobs_decoder_t;

void cobs_start(cobs_decoder_t *decoder, uint8_t *data, size_t capacity);

/* Takes one byte; the size of the packet that it ends, else 0. The packet lies in `data` until the next byte comes. */
size_t cobs_take(cobs_decoder_t *decoder, uint8_t byte);

/* Sends a packet and its zero byte through `put`. */
void cobs_send(const uint8_t *data, size_t size, void (*put)(uint8_t byte));

#endif
