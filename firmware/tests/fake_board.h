/* A board that writes down what it is asked for. */
#ifndef FAKE_BOARD_H
#define FAKE_BOARD_H

#include <stdbool.h>
#include <stddef.h>

#include "board.h"

enum { MOST_EVENTS = 4096, MOST_SENT = 1 << 20 };

typedef enum { DRIVE, REST, SAMPLE, PRESS, LIFT } what_t;

/* One call: its arguments, and when it came (us). */
typedef struct {
    what_t what;
    uint8_t a;
    uint8_t b;
    uint16_t count;
    uint64_t time;
} event_t;

extern struct fake {
    board_t about;
    bool ready;
    uint8_t trouble;           /* what board_sample tells */
    uint64_t now;              /* us */
    uint64_t step;             /* us that each look at the clock takes */
    int offset;                /* added to every voltage's code in the next round, then to be more by `drift` */
    int drift;
    int voltage_code;          /* of every pair; below 0: a code of its own for each, fake_code() */
    int current_code;
    const char *why_not;       /* what board_press tells */
    message_press_t press;
    unsigned kicks;
    event_t events[MOST_EVENTS];
    size_t n_events;
    uint8_t sent[MOST_SENT];   /* to the host */
    size_t n_sent;
} fake;

void fake_start(void);

/* The code of a pair during an injection. */
uint16_t fake_code(uint8_t source, uint8_t sink, uint8_t plus, uint8_t minus);

#endif
