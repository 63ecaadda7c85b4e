/* A ring of bytes between an interrupt and the main loop: one side only puts, the other only takes. */
#ifndef RING_H
#define RING_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    volatile uint8_t *data;  /* written before `head` moves, read before `tail` does */
    uint16_t size;           /* one byte of it stays free, to tell full from empty */
    volatile uint16_t head;  /* where the next byte is put */
    volatile uint16_t tail;  /* where the next byte is taken */
    volatile uint32_t lost;  /* bytes that found it full */
} ring_t;

static inline uint16_t ring_after(const ring_t *ring, uint16_t at)
{
    return (uint16_t)(at + 1u == ring->size ? 0u : at + 1u);
}

/* Puts a byte; a full ring stays as it is and the byte is lost, which the packet's checksum will tell. */
static inline bool ring_put(ring_t *ring, uint8_t byte)
{
    const uint16_t next = ring_after(ring, ring->head);
    if (next == ring->tail) {
        ring->lost++;
        return false;
    }
    ring->data[ring->head] = byte;
    ring->head = next;
    return true;
}

/* The oldest byte, or -1. */
static inline int ring_take(ring_t *ring)
{
    if (ring->head == ring->tail)
        return -1;
    const uint8_t byte = ring->data[ring->tail];
    ring->tail = ring_after(ring, ring->tail);
    return byte;
}

#endif
