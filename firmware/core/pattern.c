#include "pattern.h"

#include <stdbool.h>
#include <string.h>

#include "crc32.h"

static uint16_t u16_at(const uint8_t *rows, size_t index)
{
    return (uint16_t)(rows[2 * index] | rows[2 * index + 1] << 8);
}

static bool pair_is_bad(uint16_t a, uint16_t b, uint16_t electrodes)
{
    return a >= electrodes || b >= electrodes || a == b;
}

uint16_t pattern_check(const uint8_t *payload, size_t size, uint16_t electrodes, const char **why)
{
    message_pattern_t head;
    if (size < sizeof head) {
        *why = "the payload is too short for a pattern";
        return ERROR_BAD_REQUEST;
    }
    memcpy(&head, payload, sizeof head);
    const size_t bytes = sizeof head + (size_t)PATTERN_INJECTIONS_BYTES * head.n_inj + (size_t)PATTERN_MEASUREMENTS_BYTES * head.n_meas;
    if (size != bytes) {
        *why = "the payload's length does not fit its counts";
        return ERROR_BAD_REQUEST;
    }
    if (head.n_inj == 0 || head.n_meas == 0) {
        *why = "a pattern needs an injection and a measurement";
        return ERROR_BAD_PATTERN;
    }
    if (head.slot >= PATTERN_SLOTS || head.n_inj > MAX_INJECTIONS || head.n_meas > MAX_MEASUREMENTS) {
        *why = "more slots, injections or measurements than there are";
        return ERROR_TOO_LARGE;
    }
    const uint8_t *injections = payload + sizeof head;
    for (size_t k = 0; k < head.n_inj; k++) {
        if (pair_is_bad(u16_at(injections, 2 * k), u16_at(injections, 2 * k + 1), electrodes)) {
            *why = "an injection needs two electrodes that are there";
            return ERROR_BAD_PATTERN;
        }
    }
    const uint8_t *measurements = injections + (size_t)PATTERN_INJECTIONS_BYTES * head.n_inj;
    uint16_t before = 0;
    for (size_t k = 0; k < head.n_meas; k++) {
        const uint16_t injection = u16_at(measurements, 3 * k);
        if (pair_is_bad(u16_at(measurements, 3 * k + 1), u16_at(measurements, 3 * k + 2), electrodes)) {
            *why = "a measurement needs two electrodes that are there";
            return ERROR_BAD_PATTERN;
        }
        if (injection < before || injection >= head.n_inj) {
            *why = "measurements must be sorted by injection, and their injections be there";
            return ERROR_BAD_PATTERN;
        }
        before = injection;
    }
    return 0;
}

/* The digest of docs/protocol.md, of what is kept rather than of what came. */
static uint32_t digest(const pattern_t *pattern)
{
    uint32_t crc = crc32_add_u16(crc32_add_u16(0, pattern->n_inj), pattern->n_meas);
    for (uint16_t k = 0; k < pattern->n_inj; k++) {
        crc = crc32_add_u16(crc, pattern->injections[k].source);
        crc = crc32_add_u16(crc, pattern->injections[k].sink);
    }
    const pair_t *pair = pattern->pairs;
    for (uint16_t k = 0; k < pattern->n_inj; k++) {
        for (uint16_t i = 0; i < pattern->injections[k].count; i++, pair++) {
            crc = crc32_add_u16(crc, k);
            crc = crc32_add_u16(crc, pair->plus);
            crc = crc32_add_u16(crc, pair->minus);
        }
    }
    return crc;
}

void pattern_keep(pattern_t *pattern, const uint8_t *payload)
{
    message_pattern_t head;
    memcpy(&head, payload, sizeof head);
    pattern->n_inj = head.n_inj;
    pattern->n_meas = head.n_meas;
    const uint8_t *injections = payload + sizeof head;
    for (size_t k = 0; k < head.n_inj; k++)
        pattern->injections[k] = (injection_t){(uint8_t)u16_at(injections, 2 * k), (uint8_t)u16_at(injections, 2 * k + 1), 0};
    const uint8_t *measurements = injections + (size_t)PATTERN_INJECTIONS_BYTES * head.n_inj;
    for (size_t k = 0; k < head.n_meas; k++) {
        pattern->injections[u16_at(measurements, 3 * k)].count++;
        pattern->pairs[k] = (pair_t){(uint8_t)u16_at(measurements, 3 * k + 1), (uint8_t)u16_at(measurements, 3 * k + 2)};
    }
    pattern->digest = digest(pattern);
}
