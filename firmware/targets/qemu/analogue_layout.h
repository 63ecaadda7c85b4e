/* Made by firmware/generate.py from ohmskin.device.analogue; change it there. */
#ifndef ANALOGUE_LAYOUT_H
#define ANALOGUE_LAYOUT_H

#include <stdint.h>

#define ANALOGUE_REPLY 0x80

enum {
    ANALOGUE_DESCRIBE = 0x01,
    ANALOGUE_SAMPLE = 0x02,
    ANALOGUE_PRESS = 0x03,
    ANALOGUE_LIFT = 0x04,
};

#define ASK_DESCRIBE_BYTES 0

typedef struct __attribute__((packed)) {
    uint32_t serial;
    uint32_t boot;
    uint32_t features;
    float excitation;
    float full_scale;
    float settle_time;
    float conversion_time;
    float volts_per_code;
    float amperes_per_code;
    uint16_t volts_zero;
    uint16_t amperes_zero;
    uint16_t code_max;
    uint16_t averages;
    uint16_t electrodes;
} message_tell_describe_t;
#define TELL_DESCRIBE_BYTES 46
_Static_assert(sizeof(message_tell_describe_t) == TELL_DESCRIBE_BYTES, "packed");
#define TELL_DESCRIBE_NAME_BYTES 32 /* longest */

typedef struct __attribute__((packed)) {
    uint16_t elapsed;
    uint8_t source;
    uint8_t sink;
    uint8_t count;
} message_ask_sample_t;
#define ASK_SAMPLE_BYTES 5
_Static_assert(sizeof(message_ask_sample_t) == ASK_SAMPLE_BYTES, "packed");
#define ASK_SAMPLE_PAIRS_BYTES 2 /* each */

typedef struct __attribute__((packed)) {
    uint16_t current;
    uint8_t flags;
    uint8_t count;
} message_tell_sample_t;
#define TELL_SAMPLE_BYTES 4
_Static_assert(sizeof(message_tell_sample_t) == TELL_SAMPLE_BYTES, "packed");
#define TELL_SAMPLE_CODES_BYTES 2 /* each */

typedef struct __attribute__((packed)) {
    float x;
    float y;
    float radius;
    float pressure;
    uint16_t number;
} message_ask_press_t;
#define ASK_PRESS_BYTES 18
_Static_assert(sizeof(message_ask_press_t) == ASK_PRESS_BYTES, "packed");

#define TELL_PRESS_BYTES 0
#define TELL_PRESS_TEXT_BYTES 100 /* longest */

#define ASK_LIFT_BYTES 0

#define TELL_LIFT_BYTES 0

#endif
