/* A drive pattern as the firmware keeps it: a third of its size on the wire. */
#ifndef PATTERN_H
#define PATTERN_H

#include <stddef.h>
#include <stdint.h>

#include "board.h"
#include "config.h"

typedef struct {
    uint8_t source;
    uint8_t sink;
    uint16_t count;  /* its measurements; they follow those of the injection before */
} injection_t;

/* Empty while n_inj is 0. */
typedef struct {
    uint32_t digest;
    uint16_t n_inj;
    uint16_t n_meas;
    injection_t injections[MAX_INJECTIONS];
    pair_t pairs[MAX_MEASUREMENTS];
} pattern_t;

/* 0, or the ERROR_ code that says why the payload of a PATTERN is not obeyed; `why` then says it in words. */
uint16_t pattern_check(const uint8_t *payload, size_t size, uint16_t electrodes, const char **why);

/* Keeps the pattern of a payload that was checked. The digest is that of what was kept. */
void pattern_keep(pattern_t *pattern, const uint8_t *payload);

#endif
