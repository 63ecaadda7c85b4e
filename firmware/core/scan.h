/* Drives a pattern once and measures. */
#ifndef SCAN_H
#define SCAN_H

#include <stdbool.h>
#include <stdint.h>

#include "pattern.h"

/* A sum of codes while it is measured, a value in V or A afterwards. */
typedef union {
    uint32_t sum;
    float value;
} reading_t;

typedef struct {
    uint64_t time;   /* us, when the last sample was taken */
    uint32_t flags;  /* FLAG_ bits */
} scan_outcome_t;

/*
 * For every injection: drive it, wait for the settling time, then take `averages` rounds over its pairs, so that a drift
 * meets all of them alike. `readings` gets the n_inj currents (A), then the n_meas voltages (V; +-inf clipped).
 * False if the board failed.
 */
bool scan(const pattern_t *pattern, const board_t *about, reading_t *readings, scan_outcome_t *outcome);

#endif
