#include "fake_board.h"

#include <string.h>

struct fake fake;

void fake_start(void)
{
    memset(&fake, 0, sizeof fake);
    fake.about = (board_t){
        .name = "demo skin",
        .serial = 0x12345678,
        .boot = 0x9ABCDEF0,
        .features = FEATURE_VIRTUAL | FEATURE_CURRENT_MEASURED,
        .excitation = 2e-3f,
        .full_scale = 2.5f,
        .settle_time = 1e-4f,
        .conversion_time = 2e-5f,
        .volts_per_code = 1.0f / 1024.0f,
        .amperes_per_code = 1.0f / 262144.0f,
        .volts_zero = 2048,
        .amperes_zero = 0,
        .code_max = 4095,
        .averages = 1,
        .electrodes = 16,
    };
    fake.ready = true;
    fake.step = 1;
    fake.voltage_code = -1;
    fake.current_code = 512;
}

static void note(what_t what, uint8_t a, uint8_t b, uint16_t count)
{
    if (fake.n_events < MOST_EVENTS)
        fake.events[fake.n_events++] = (event_t){what, a, b, count, fake.now};
}

uint16_t fake_code(uint8_t source, uint8_t sink, uint8_t plus, uint8_t minus)
{
    return (uint16_t)(1 + (source * 7 + sink * 31 + plus * 127 + minus * 509) % 4094);
}

const board_t *board(void) { return fake.ready ? &fake.about : NULL; }

static uint8_t driven[2];

void board_drive(uint8_t source, uint8_t sink)
{
    driven[0] = source;
    driven[1] = sink;
    note(DRIVE, source, sink, 0);
}

void board_rest(void) { note(REST, 0, 0, 0); }

uint8_t board_sample(const pair_t *pairs, uint16_t count, uint16_t *codes, uint16_t *current)
{
    note(SAMPLE, count ? pairs->plus : 0, count ? pairs->minus : 0, count);
    for (uint16_t i = 0; i < count; i++) {
        const int own = fake_code(driven[0], driven[1], pairs[i].plus, pairs[i].minus);
        codes[i] = (uint16_t)((fake.voltage_code < 0 ? own : fake.voltage_code) + fake.offset);
    }
    fake.offset += fake.drift;
    *current = (uint16_t)fake.current_code;
    fake.now += 10;
    return fake.trouble;
}

uint64_t board_micros(void)
{
    fake.now += fake.step;
    return fake.now;
}

void board_kick(void) { fake.kicks++; }

void board_send(uint8_t byte)
{
    if (fake.n_sent < MOST_SENT)
        fake.sent[fake.n_sent++] = byte;
}

const char *board_press(const message_press_t *press)
{
    fake.press = *press;
    note(PRESS, 0, 0, press->number);
    return fake.why_not;
}

void board_lift(void) { note(LIFT, 0, 0, 0); }
