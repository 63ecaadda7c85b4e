/* The device's side of the conversation of docs/protocol.md: bytes of requests in, replies out through board_send. */
#ifndef SESSION_H
#define SESSION_H

#include <stdbool.h>
#include <stdint.h>

#include "cobs.h"
#include "scan.h"

enum {
    LONGEST_PATTERN = HEADER_BYTES + PATTERN_BYTES + PATTERN_INJECTIONS_BYTES * MAX_INJECTIONS +
                      PATTERN_MEASUREMENTS_BYTES * MAX_MEASUREMENTS + CHECKSUM_BYTES,
    /* What comes before the readings of a frame, so that they end where the reply ends. */
    FRAME_HEAD = HEADER_BYTES + FRAME_BYTES,
};

/* One packet at a time: the reply is made where the request was. */
typedef union {
    uint8_t bytes[LONGEST_PATTERN];
    struct {
        uint8_t head[FRAME_HEAD];
        reading_t readings[MAX_INJECTIONS + MAX_MEASUREMENTS];
        uint8_t checksum[CHECKSUM_BYTES];
    } frame;
    struct {
        uint8_t head[HEADER_BYTES + ERROR_BYTES];
        char text[ERROR_TEXT_BYTES];
        uint8_t checksum[CHECKSUM_BYTES];
    } error;
} packet_t;

typedef struct {
    cobs_decoder_t decoder;
    packet_t packet;
    pattern_t patterns[PATTERN_SLOTS];
    uint32_t frames;  /* since the start, modulo 2^32 */
    bool scanned;     /* whether a frame was sent since the start */
} session_t;

void session_start(session_t *session);

/* Takes one byte of the host and answers the request that it completes. Nothing that comes does any harm. */
void session_take(session_t *session, uint8_t byte);

#endif
