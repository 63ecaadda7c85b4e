#include "session.h"

#include <stdbool.h>
#include <string.h>

#include "crc32.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "payloads are copied to structures as they are");
_Static_assert(sizeof(float) == 4, "f32 is IEEE 754 single precision");
_Static_assert(FRAME_HEAD % 4 == 0 && FRAME_HEAD == offsetof(packet_t, frame.readings), "readings follow the head of a frame");
_Static_assert(LONGEST_PATTERN <= MAX_PACKET - 512, "a packet holds no larger pattern");
_Static_assert(PATTERN_SLOTS <= 255 && MAX_INJECTIONS <= 65535 && MAX_MEASUREMENTS <= 65535, "CAPABILITIES tells no more");

void session_start(session_t *session)
{
    memset(session, 0, sizeof *session);
    cobs_start(&session->decoder, session->packet.bytes, sizeof session->packet.bytes);
}

/* Sends the reply whose payload of `size` bytes is in place. */
static void reply(session_t *session, uint8_t kind, uint16_t sequence, size_t size)
{
    const message_header_t header = {PROTOCOL_VERSION, kind, sequence};
    uint8_t *bytes = session->packet.bytes;
    memcpy(bytes, &header, sizeof header);
    const uint32_t checksum = crc32_add(0, bytes, HEADER_BYTES + size);
    memcpy(bytes + HEADER_BYTES + size, &checksum, CHECKSUM_BYTES);
    cobs_send(bytes, HEADER_BYTES + size + CHECKSUM_BYTES, board_send);
}

static size_t text_length(const char *text, size_t most)
{
    size_t length = 0;
    while (length < most && text[length] != 0)
        length++;
    return length;
}

static void refuse(session_t *session, uint16_t sequence, uint16_t code, const char *why)
{
    const message_error_t error = {code};
    uint8_t *payload = session->packet.bytes + HEADER_BYTES;
    const size_t length = text_length(why, ERROR_TEXT_BYTES);
    memcpy(payload, &error, sizeof error);
    memcpy(payload + sizeof error, why, length);
    reply(session, KIND_ERROR, sequence, sizeof error + length);
}

static void acknowledge(session_t *session, uint16_t sequence, uint32_t value)
{
    const message_ack_t ack = {value};
    memcpy(session->packet.bytes + HEADER_BYTES, &ack, sizeof ack);
    reply(session, KIND_ACK, sequence, sizeof ack);
}

static void hello(session_t *session, uint16_t sequence, const board_t *about)
{
    memset(session->patterns, 0, sizeof session->patterns);
    if (about->features & FEATURE_VIRTUAL)
        board_lift();
    const message_capabilities_t able = {
        .serial = about->serial,
        .boot = about->boot,
        .features = about->features,
        .excitation = about->excitation,
        .full_scale = about->full_scale,
        .settle_time = about->settle_time,
        .conversion_time = about->conversion_time * (float)about->averages,
        .n_electrodes = about->electrodes,
        .max_injections = MAX_INJECTIONS,
        .max_measurements = MAX_MEASUREMENTS,
        .pattern_slots = PATTERN_SLOTS,
        .firmware_major = FIRMWARE_MAJOR,
        .firmware_minor = FIRMWARE_MINOR,
        .firmware_patch = FIRMWARE_PATCH,
    };
    uint8_t *payload = session->packet.bytes + HEADER_BYTES;
    const size_t length = text_length(about->name, CAPABILITIES_NAME_BYTES);
    memcpy(payload, &able, sizeof able);
    memcpy(payload + sizeof able, about->name, length);
    reply(session, KIND_CAPABILITIES, sequence, sizeof able + length);
}

static void set_pattern(session_t *session, uint16_t sequence, const uint8_t *payload, size_t size, const board_t *about)
{
    const char *why = "";
    const uint16_t code = pattern_check(payload, size, about->electrodes, &why);
    if (code != 0) {
        refuse(session, sequence, code, why);
        return;
    }
    message_pattern_t head;
    memcpy(&head, payload, sizeof head);
    pattern_t *pattern = &session->patterns[head.slot];
    pattern_keep(pattern, payload);
    acknowledge(session, sequence, pattern->digest);
}

static void scan_slot(session_t *session, uint16_t sequence, const uint8_t *payload, size_t size, const board_t *about)
{
    message_scan_t asked;
    if (size != sizeof asked) {
        refuse(session, sequence, ERROR_BAD_REQUEST, "SCAN has a slot and a digest");
        return;
    }
    memcpy(&asked, payload, sizeof asked);
    if (asked.slot >= PATTERN_SLOTS || session->patterns[asked.slot].n_inj == 0) {
        refuse(session, sequence, ERROR_UNKNOWN_SLOT, "no pattern in this slot; send it again");
        return;
    }
    const pattern_t *pattern = &session->patterns[asked.slot];
    if (pattern->digest != asked.digest) {
        refuse(session, sequence, ERROR_DIGEST_MISMATCH, "another pattern in this slot; send it again");
        return;
    }
    scan_outcome_t outcome;
    if (!scan(pattern, about, session->packet.frame.readings, &outcome)) {
        refuse(session, sequence, ERROR_FAILED, "the converter did not answer");
        return;
    }
    const message_frame_t frame = {
        .digest = pattern->digest,
        .number = ++session->frames,
        .time = outcome.time,
        .flags = outcome.flags | (session->scanned ? 0 : FLAG_FIRST),
        .n_inj = pattern->n_inj,
        .n_meas = pattern->n_meas,
    };
    session->scanned = true;
    memcpy(session->packet.bytes + HEADER_BYTES, &frame, sizeof frame);
    reply(session, KIND_FRAME, sequence, sizeof frame + sizeof(reading_t) * (size_t)(frame.n_inj + frame.n_meas));
}

static bool within(float value, float low, float high)
{
    return value >= low && value <= high; /* false for NaN */
}

static void press(session_t *session, uint16_t sequence, const uint8_t *payload, size_t size, const board_t *about)
{
    message_press_t touch;
    if (size != sizeof touch) {
        refuse(session, sequence, ERROR_BAD_REQUEST, "PRESS has x, y, radius, pressure and number");
        return;
    }
    if (!(about->features & FEATURE_VIRTUAL)) {
        refuse(session, sequence, ERROR_NOT_SUPPORTED, "this skin is real; press it with a finger");
        return;
    }
    memcpy(&touch, payload, sizeof touch);
    if (!within(touch.x, PRESS_X_MIN, PRESS_X_MAX) || !within(touch.y, PRESS_Y_MIN, PRESS_Y_MAX) ||
        !within(touch.radius, PRESS_RADIUS_MIN, PRESS_RADIUS_MAX) ||
        !within(touch.pressure, PRESS_PRESSURE_MIN, PRESS_PRESSURE_MAX)) {
        refuse(session, sequence, ERROR_BAD_REQUEST, "the press is out of range");
        return;
    }
    const char *why_not = board_press(&touch);
    if (why_not)
        refuse(session, sequence, ERROR_BAD_REQUEST, why_not);
    else
        acknowledge(session, sequence, 0);
}

static void answer(session_t *session, size_t size)
{
    message_header_t header;
    memcpy(&header, session->packet.bytes, sizeof header);
    const uint8_t *payload = session->packet.bytes + HEADER_BYTES;
    const board_t *about = board();
    if (header.version != PROTOCOL_VERSION) {
        refuse(session, header.sequence, ERROR_WRONG_VERSION, "this device speaks protocol " PROTOCOL_VERSION_TEXT);
        return;
    }
    if (about == NULL) {
        refuse(session, header.sequence, ERROR_BUSY, "the board is not ready; ask again");
        return;
    }
    switch (header.kind) {
    case KIND_HELLO:
        if (size == HELLO_BYTES)
            hello(session, header.sequence, about);
        else
            refuse(session, header.sequence, ERROR_BAD_REQUEST, "HELLO has no payload");
        break;
    case KIND_PATTERN:
        set_pattern(session, header.sequence, payload, size, about);
        break;
    case KIND_SCAN:
        scan_slot(session, header.sequence, payload, size, about);
        break;
    case KIND_PRESS:
        press(session, header.sequence, payload, size, about);
        break;
    default:
        refuse(session, header.sequence, ERROR_UNKNOWN_KIND, "no such request");
    }
}

void session_take(session_t *session, uint8_t byte)
{
    const size_t size = cobs_take(&session->decoder, byte);
    if (size < HEADER_BYTES + CHECKSUM_BYTES)
        return;
    const uint8_t *bytes = session->packet.bytes;
    uint32_t told;
    memcpy(&told, bytes + size - CHECKSUM_BYTES, sizeof told);
    if (told == crc32_add(0, bytes, size - CHECKSUM_BYTES))
        answer(session, size - HEADER_BYTES - CHECKSUM_BYTES);
}
