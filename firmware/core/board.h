/*
 * What the core needs of a board. A port implements these functions and a config.h with the sizes; docs/firmware.md says how.
 * All of them are called from the main loop only.
 */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#include "protocol_layout.h"

/* Two electrodes between which a voltage is taken. */
typedef struct {
    uint8_t plus;
    uint8_t minus;
} pair_t;

/* What the board is. A code c means (c - zero) * per_code; a voltage's code of 0 or code_max was clipped. */
typedef struct {
    char name[CAPABILITIES_NAME_BYTES + 1];
    uint32_t serial;         /* unique */
    uint32_t boot;           /* another one after every start */
    uint32_t features;       /* FEATURE_ bits */
    float excitation;        /* V with FEATURE_VOLTAGE_SOURCE, else A */
    float full_scale;        /* V */
    float settle_time;       /* s from board_drive to the first sample; the core waits for it */
    float conversion_time;   /* s that board_sample takes for each pair */
    float volts_per_code;
    float amperes_per_code;
    uint16_t volts_zero;     /* code of 0 V */
    uint16_t amperes_zero;   /* code of 0 A */
    uint16_t code_max;
    uint16_t averages;       /* samples that make one value, 1 .. 65535 */
    uint16_t electrodes;     /* 2 .. 256 */
} board_t;

enum { BOARD_BATCH = 32 };

enum {
    BOARD_FAILED = 1,        /* no sample was taken */
    BOARD_CURRENT_LIMIT = 2, /* the source could not drive what it should */
};

/* What the board is; null while it cannot measure yet. */
const board_t *board(void);

/* Connect the source's and the sink's electrode; returns at once. */
void board_drive(uint8_t source, uint8_t sink);

/* Connect no electrode. */
void board_rest(void);

/* Take the voltage's code of each of `count` pairs once, at most BOARD_BATCH of them and perhaps none, and the code of the current; BOARD_ bits. */
uint8_t board_sample(const pair_t *pairs, uint16_t count, uint16_t *codes, uint16_t *current);

/* Microseconds since the start; never goes back. */
uint64_t board_micros(void);

/* Tell the watchdog that all is well. */
void board_kick(void);

/* One byte to the host; may wait for room. */
void board_send(uint8_t byte);

/* Boards with FEATURE_VIRTUAL: put, move or lift a touch. Null when done, else why not. */
const char *board_press(const message_press_t *press);

/* Boards with FEATURE_VIRTUAL: lift all touches. */
void board_lift(void);

#endif
