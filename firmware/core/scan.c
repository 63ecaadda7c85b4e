#include "scan.h"

#include <math.h>

enum { LATENESS = 1000 }; /* us beyond twice the settling time that go without FLAG_OVERRUN */

/* Sums that no 65535 codes of 16 bits can make. */
static const uint32_t CLIPPED_LOW = 0xFFFFFFFEu;
static const uint32_t CLIPPED_HIGH = 0xFFFFFFFFu;

/* What is driven, where it is not measured; of a voltage source that is not known. */
static float nominal(const board_t *about)
{
    return about->features & FEATURE_VOLTAGE_SOURCE ? NAN : about->excitation;
}

static void settle(const board_t *about, uint32_t *flags)
{
    const uint64_t start = board_micros();
    const uint64_t wait = (uint64_t)(about->settle_time * 1e6f) + 1; /* the first microsecond may be a short one */
    while (board_micros() - start < wait)
        board_kick();
    if (board_micros() - start > 2 * wait + LATENESS)
        *flags |= FLAG_OVERRUN;
}

/* One clipped sample clips the whole: its true value is not known. */
static void add(reading_t *reading, uint16_t code, uint16_t zero, uint16_t code_max)
{
    if (reading->sum >= CLIPPED_LOW)
        return;
    if (code >= code_max)
        reading->sum = CLIPPED_HIGH;
    else if (code == 0 && zero > 0)
        reading->sum = CLIPPED_LOW;
    else
        reading->sum += code;
}

static void finish(reading_t *reading, uint32_t samples, uint16_t zero, float per_code, uint32_t *flags)
{
    const uint32_t sum = reading->sum;
    if (sum >= CLIPPED_LOW) {
        reading->value = sum == CLIPPED_HIGH ? INFINITY : -INFINITY;
        *flags |= FLAG_CLIPPED;
        return;
    }
    reading->value = (float)((int64_t)sum - (int64_t)zero * samples) * per_code / (float)samples;
}

bool scan(const pattern_t *pattern, const board_t *about, reading_t *readings, scan_outcome_t *outcome)
{
    const pair_t *pairs = pattern->pairs;
    reading_t *voltages = readings + pattern->n_inj;
    *outcome = (scan_outcome_t){0};
    for (uint16_t k = 0; k < pattern->n_inj; k++) {
        const injection_t *injection = &pattern->injections[k];
        const uint16_t count = injection->count;
        reading_t *current = &readings[k];
        current->sum = 0;
        for (uint16_t i = 0; i < count; i++)
            voltages[i].sum = 0;

        board_drive(injection->source, injection->sink);
        settle(about, &outcome->flags);
        for (uint16_t round = 0; round < about->averages; round++) {
            uint16_t at = 0;
            do { /* at least once, for the current */
                const uint16_t batch = (uint16_t)(count - at < BOARD_BATCH ? count - at : BOARD_BATCH);
                uint16_t codes[BOARD_BATCH], current_code = 0;
                board_kick();
                const uint8_t trouble = board_sample(pairs + at, batch, codes, &current_code);
                if (trouble & BOARD_FAILED) {
                    board_rest();
                    return false;
                }
                if (trouble & BOARD_CURRENT_LIMIT)
                    outcome->flags |= FLAG_CURRENT_LIMIT;
                for (uint16_t i = 0; i < batch; i++)
                    add(&voltages[at + i], codes[i], about->volts_zero, about->code_max);
                if (at == 0) /* one current for each round: the same weight as the voltages */
                    add(current, current_code, about->amperes_zero, about->code_max);
                at = (uint16_t)(at + batch);
            } while (at < count);
        }
        outcome->time = board_micros();
        if (about->features & FEATURE_CURRENT_MEASURED)
            finish(current, about->averages, about->amperes_zero, about->amperes_per_code, &outcome->flags);
        else
            current->value = nominal(about);
        for (uint16_t i = 0; i < count; i++)
            finish(&voltages[i], about->averages, about->volts_zero, about->volts_per_code, &outcome->flags);
        pairs += count;
        voltages += count;
    }
    board_rest();
    return true;
}
