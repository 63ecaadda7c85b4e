/* Made by firmware/generate.py from ohmskin.device.layout; change it there. */
#ifndef PROTOCOL_LAYOUT_H
#define PROTOCOL_LAYOUT_H

#include <stdint.h>

/* Sent before the payload of every packet. */
typedef struct __attribute__((packed)) {
    uint8_t version;
    uint8_t kind;
    uint16_t sequence;
} message_header_t;

#define PROTOCOL_VERSION 1
#define PROTOCOL_VERSION_TEXT "1"
#define MAX_PACKET 65536
#define HEADER_BYTES 4
#define CHECKSUM_BYTES 4
_Static_assert(sizeof(message_header_t) == HEADER_BYTES, "packed");

enum {
    KIND_HELLO = 0x01,
    KIND_PATTERN = 0x02,
    KIND_SCAN = 0x03,
    KIND_PRESS = 0x04,
    KIND_CAPABILITIES = 0x81,
    KIND_ACK = 0x82,
    KIND_FRAME = 0x83,
    KIND_ERROR = 0xFF,
};

enum {
    ERROR_WRONG_VERSION = 0x01,
    ERROR_UNKNOWN_KIND = 0x02,
    ERROR_BAD_REQUEST = 0x03,
    ERROR_BAD_PATTERN = 0x04,
    ERROR_TOO_LARGE = 0x05,
    ERROR_UNKNOWN_SLOT = 0x06,
    ERROR_DIGEST_MISMATCH = 0x07,
    ERROR_NOT_SUPPORTED = 0x08,
    ERROR_BUSY = 0x09,
    ERROR_FAILED = 0x0A,
};

enum {
    FEATURE_VIRTUAL = 0x01,
    FEATURE_CURRENT_MEASURED = 0x02,
    FEATURE_VOLTAGE_SOURCE = 0x04,
    FEATURE_DRIVEN_MEASURED = 0x08,
    FEATURE_AUXILIARY = 0x10,
};

enum {
    FLAG_CLIPPED = 0x01,
    FLAG_CURRENT_LIMIT = 0x02,
    FLAG_FIRST = 0x04,
    FLAG_OVERRUN = 0x08,
};

#define PRESS_X_MIN -100.0f
#define PRESS_X_MAX 100.0f
#define PRESS_Y_MIN -100.0f
#define PRESS_Y_MAX 100.0f
#define PRESS_RADIUS_MIN 9.5367431640625e-07f
#define PRESS_RADIUS_MAX 10.0f
#define PRESS_PRESSURE_MIN 0.0f
#define PRESS_PRESSURE_MAX 1000000000.0f

#define HELLO_BYTES 0

typedef struct __attribute__((packed)) {
    uint16_t slot;
    uint16_t n_inj;
    uint16_t n_meas;
} message_pattern_t;
#define PATTERN_BYTES 6
_Static_assert(sizeof(message_pattern_t) == PATTERN_BYTES, "packed");
#define PATTERN_INJECTIONS_BYTES 4 /* each */
#define PATTERN_MEASUREMENTS_BYTES 6 /* each */

typedef struct __attribute__((packed)) {
    uint32_t digest;
    uint16_t slot;
} message_scan_t;
#define SCAN_BYTES 6
_Static_assert(sizeof(message_scan_t) == SCAN_BYTES, "packed");

typedef struct __attribute__((packed)) {
    float x;
    float y;
    float radius;
    float pressure;
    uint16_t number;
} message_press_t;
#define PRESS_BYTES 18
_Static_assert(sizeof(message_press_t) == PRESS_BYTES, "packed");

typedef struct __attribute__((packed)) {
    uint32_t serial;
    uint32_t boot;
    uint32_t features;
    float excitation;
    float full_scale;
    float settle_time;
    float conversion_time;
    uint16_t n_electrodes;
    uint16_t max_injections;
    uint16_t max_measurements;
    uint8_t pattern_slots;
    uint8_t firmware_major;
    uint8_t firmware_minor;
    uint8_t firmware_patch;
} message_capabilities_t;
#define CAPABILITIES_BYTES 38
_Static_assert(sizeof(message_capabilities_t) == CAPABILITIES_BYTES, "packed");
#define CAPABILITIES_NAME_BYTES 32 /* longest */

typedef struct __attribute__((packed)) {
    uint32_t value;
} message_ack_t;
#define ACK_BYTES 4
_Static_assert(sizeof(message_ack_t) == ACK_BYTES, "packed");

typedef struct __attribute__((packed)) {
    uint32_t digest;
    uint32_t number;
    uint64_t time;
    uint32_t flags;
    uint16_t n_inj;
    uint16_t n_meas;
} message_frame_t;
#define FRAME_BYTES 24
_Static_assert(sizeof(message_frame_t) == FRAME_BYTES, "packed");
#define FRAME_CURRENTS_BYTES 4 /* each */
#define FRAME_VOLTAGES_BYTES 4 /* each */

typedef struct __attribute__((packed)) {
    uint16_t code;
} message_error_t;
#define ERROR_BYTES 2
_Static_assert(sizeof(message_error_t) == ERROR_BYTES, "packed");
#define ERROR_TEXT_BYTES 120 /* longest */

#endif
