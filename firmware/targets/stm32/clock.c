#include "clock.h"

#include "stm32f1.h"

/* The timer's whole 24 bits: an emulator that is held up loses no turn of 5 seconds, as it would one of a millisecond. */
static const uint32_t LAST = 0xFFFFFFu;

static volatile uint32_t turns;
static uint32_t megahertz;

void systick_handler(void);
void systick_handler(void)
{
    turns++;
}

void clock_start(uint32_t hertz)
{
    megahertz = hertz / 1000000u;
    SYSTICK_LOAD = LAST;
    SYSTICK_VAL = 0;
    SYSTICK_CTRL = 3; /* an eighth of the processor's clock, interrupt, on */
}

uint64_t clock_micros(void)
{
    static uint64_t newest;
    uint32_t before, now = turns, left;
    do { /* until none has ended between the two readings */
        before = now;
        left = SYSTICK_VAL;
        now = turns;
    } while (now != before);
    const uint64_t ticks = (uint64_t)now * (LAST + 1u) + ((LAST + 1u - left) & LAST); /* a turn begins at 0 */
    const uint64_t micros = 8u * ticks / megahertz;
    if (micros > newest) /* an emulator's timer may begin anew some time before its interrupt comes */
        newest = micros;
    return newest;
}
