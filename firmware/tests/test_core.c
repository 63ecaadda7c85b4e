/* The core on a fake board: what docs/protocol.md asks of a device. Prints one line for each failure; exit status 1 if any. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crc32.h"
#include "fake_board.h"
#include "ring.h"
#include "session.h"
#include "vectors.h"

static const char *test = "";
static unsigned failures, checks;

#define CHECK(truth)                                                              \
    do {                                                                          \
        checks++;                                                                 \
        if (!(truth)) {                                                           \
            failures++;                                                           \
            printf("%s: line %d: %s\n", test, __LINE__, #truth);                  \
        }                                                                         \
    } while (0)

static session_t session;

/* A reply, undone and checked. */
static struct {
    uint8_t bytes[4096];
    size_t size;        /* of the payload */
    const uint8_t *payload;
    message_header_t header;
} got;

static void start(void)
{
    fake_start();
    session_start(&session);
}

static void take(uint8_t byte) { session_take(&session, byte); }

static void feed(const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < size; i++)
        take(data[i]);
}

/* The number of replies since the last call; the newest of them is in `got`. */
static unsigned replies(void)
{
    cobs_decoder_t decoder;
    unsigned count = 0;
    cobs_start(&decoder, got.bytes, sizeof got.bytes);
    for (size_t i = 0; i < fake.n_sent; i++) {
        const size_t size = cobs_take(&decoder, fake.sent[i]);
        if (size == 0)
            continue;
        uint32_t told;
        memcpy(&told, got.bytes + size - CHECKSUM_BYTES, sizeof told);
        CHECK(told == crc32_add(0, got.bytes, size - CHECKSUM_BYTES));
        memcpy(&got.header, got.bytes, sizeof got.header);
        got.payload = got.bytes + HEADER_BYTES;
        got.size = size - HEADER_BYTES - CHECKSUM_BYTES;
        count++;
    }
    CHECK(fake.n_sent == 0 || fake.sent[fake.n_sent - 1] == 0);
    fake.n_sent = 0;
    return count;
}

static void send(uint8_t version, uint8_t kind, uint16_t sequence, const void *payload, size_t size)
{
    uint8_t packet[4096];
    const message_header_t header = {version, kind, sequence};
    memcpy(packet, &header, sizeof header);
    if (size > 0)
        memcpy(packet + HEADER_BYTES, payload, size);
    const uint32_t checksum = crc32_add(0, packet, HEADER_BYTES + size);
    memcpy(packet + HEADER_BYTES + size, &checksum, sizeof checksum);
    cobs_send(packet, HEADER_BYTES + size + CHECKSUM_BYTES, take);
}

/* The code of the ERROR that came, or 0 if something else did. */
static uint16_t error(void)
{
    message_error_t told;
    if (replies() != 1 || got.header.kind != KIND_ERROR || got.size <= sizeof told)
        return 0;
    memcpy(&told, got.payload, sizeof told);
    return told.code;
}

static size_t put_u16(uint8_t *at, size_t index, unsigned value)
{
    at[2 * index] = (uint8_t)(value & 255u);
    at[2 * index + 1] = (uint8_t)(value >> 8);
    return index + 1;
}

/* The payload of a PATTERN: injections (k, k + 1), each with `each` measurements. */
static size_t pattern_payload(uint8_t *payload, unsigned slot, unsigned n_inj, unsigned each)
{
    size_t n = put_u16(payload, 0, slot);
    n = put_u16(payload, n, n_inj);
    n = put_u16(payload, n, n_inj * each);
    for (unsigned k = 0; k < n_inj; k++)
        n = put_u16(payload, put_u16(payload, n, k), k + 1);
    for (unsigned k = 0; k < n_inj; k++)
        for (unsigned i = 0; i < each; i++) {
            n = put_u16(payload, n, k);
            n = put_u16(payload, n, i % 16);
            n = put_u16(payload, n, (i + 1) % 16);
        }
    return 2 * n;
}

static uint32_t digest_of(const uint8_t *payload, size_t size) { return crc32_add(0, payload + 2, size - 2); }

static void scan_slot(unsigned slot, uint32_t digest)
{
    const message_scan_t request = {digest, (uint16_t)slot};
    send(PROTOCOL_VERSION, KIND_SCAN, 77, &request, sizeof request);
}

static float value(size_t index)
{
    float number;
    memcpy(&number, got.payload + FRAME_BYTES + 4 * index, sizeof number);
    return number;
}

static message_frame_t frame(void)
{
    message_frame_t told = {0};
    CHECK(replies() == 1);
    CHECK(got.header.kind == KIND_FRAME);
    if (got.header.kind == KIND_FRAME)
        memcpy(&told, got.payload, sizeof told);
    return told;
}

static bool sent_is(const uint8_t *packet, size_t size) { return fake.n_sent == size && memcmp(fake.sent, packet, size) == 0; }

static void checksum_and_stuffing_are_those_of_the_document(void)
{
    CHECK(crc32_add(0, "123456789", 9) == VECTOR_CRC);
    CHECK(crc32_add(crc32_add(0, "12345", 5), "6789", 4) == VECTOR_CRC);
    const uint8_t example[] = {0x11, 0x00, 0x22};
    const uint8_t stuffed[] = {0x02, 0x11, 0x02, 0x22, 0x00};
    fake_start();
    cobs_send(example, sizeof example, board_send);
    CHECK(sent_is(stuffed, sizeof stuffed));
}

static void every_length_and_zero_survives_stuffing(void)
{
    static uint8_t data[600], undone[600];
    for (size_t size = 1; size < sizeof data; size++) {
        for (unsigned zeros = 0; zeros < 3; zeros++) {
            for (size_t i = 0; i < size; i++)
                data[i] = zeros == 0 ? 1 : zeros == 1 ? 0 : (uint8_t)(i * i % 5 * (i % 255 != 0));
            cobs_decoder_t decoder;
            cobs_start(&decoder, undone, sizeof undone);
            fake.n_sent = 0;
            cobs_send(data, size, board_send);
            size_t ended = 0;
            for (size_t i = 0; i < fake.n_sent; i++) {
                CHECK(ended == 0 && (fake.sent[i] == 0) == (i == fake.n_sent - 1));
                ended = cobs_take(&decoder, fake.sent[i]);
            }
            CHECK(ended == size && memcmp(data, undone, size) == 0);
        }
    }
}

/* The vectors of docs/protocol.md: runs of 253, 254 and 255 bytes without a zero, and 254 behind one. */
static void full_blocks_are_stuffed_as_documented(void)
{
    uint8_t data[256], expected[260];
    for (size_t i = 0; i < 256; i++)
        data[i] = (uint8_t)i;
    const struct { size_t from, size; } cases[] = {{1, 253}, {1, 254}, {1, 255}, {0, 255}};
    for (size_t k = 0; k < 4; k++) {
        size_t n = 0, at = cases[k].from;
        const size_t end = at + cases[k].size;
        if (at == 0) {
            expected[n++] = 1;
            at++;
        }
        const size_t run = end - at < 254 ? end - at : 254;
        expected[n++] = (uint8_t)(run + 1);
        memcpy(expected + n, data + at, run);
        n += run;
        if (end - at > run) {
            expected[n++] = 2;
            expected[n++] = 0xFF;
        }
        expected[n++] = 0;
        fake_start();
        cobs_send(data + cases[k].from, cases[k].size, board_send);
        CHECK(sent_is(expected, n));
    }
}

static void the_vectors_are_answered_by_vectors(void)
{
    start();
    feed(VECTOR_HELLO, sizeof VECTOR_HELLO);
    CHECK(replies() == 1 && got.header.kind == KIND_CAPABILITIES && got.header.sequence == 1);
    CHECK(got.size == CAPABILITIES_BYTES + 9 && memcmp(got.payload + CAPABILITIES_BYTES, "demo skin", 9) == 0);
    message_capabilities_t able;
    memcpy(&able, got.payload, sizeof able);
    CHECK(able.serial == 0x12345678 && able.boot == 0x9ABCDEF0 && able.features == 3 && able.n_electrodes == 16);
    CHECK(able.excitation == 2e-3f && able.full_scale == 2.5f && able.settle_time == 1e-4f && able.conversion_time == 2e-5f);
    CHECK(able.max_injections == MAX_INJECTIONS && able.max_measurements == MAX_MEASUREMENTS && able.pattern_slots == PATTERN_SLOTS);
    CHECK(able.firmware_major == 1 && able.firmware_minor == 2 && able.firmware_patch == 3);

    feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN);
    CHECK(sent_is(VECTOR_ACK, sizeof VECTOR_ACK));
    fake.n_sent = 0;

    session.scanned = true;
    session.frames = 6; /* the frame of the document: number 7 at 1.5 s, 2 mA each, 0.25 V, something, clipped */
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    const message_frame_t told = frame();
    CHECK(got.header.sequence == 3 && told.digest == VECTOR_DIGEST && told.number == 7 && told.n_inj == 2 && told.n_meas == 3);
    CHECK(told.flags == 0 && got.size == FRAME_BYTES + 4 * 5);

    feed(VECTOR_PRESS, sizeof VECTOR_PRESS);
    CHECK(replies() == 1 && got.header.kind == KIND_ACK && got.header.sequence == 4);
    CHECK(fake.press.x == 0.0625f && fake.press.y == 0.125f && fake.press.radius == 0.0078125f);
    CHECK(fake.press.pressure == 20000.0f && fake.press.number == 0);
}

/* Each check fails for the reason it names: the request that is right in all else is obeyed. */
static void every_refusal_has_its_code(void)
{
    uint8_t payload[2048];
    start();
    scan_slot(0, 1);
    CHECK(error() == ERROR_UNKNOWN_SLOT);
    scan_slot(PATTERN_SLOTS, 1);
    CHECK(error() == ERROR_UNKNOWN_SLOT);
    size_t size = pattern_payload(payload, 0, 2, 3);
    const uint32_t digest = digest_of(payload, size);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    CHECK(replies() == 1 && got.header.kind == KIND_ACK);
    scan_slot(0, digest + 1);
    CHECK(error() == ERROR_DIGEST_MISMATCH && got.header.sequence == 77);

    send(PROTOCOL_VERSION + 1, KIND_HELLO, 5, NULL, 0);
    CHECK(error() == ERROR_WRONG_VERSION && got.header.version == PROTOCOL_VERSION && got.header.sequence == 5);
    send(PROTOCOL_VERSION, 0x42, 6, NULL, 0);
    CHECK(error() == ERROR_UNKNOWN_KIND);
    send(PROTOCOL_VERSION, KIND_ACK, 6, &digest, 4);
    CHECK(error() == ERROR_UNKNOWN_KIND);
    send(PROTOCOL_VERSION, KIND_HELLO, 6, payload, 1);
    CHECK(error() == ERROR_BAD_REQUEST);
    send(PROTOCOL_VERSION, KIND_SCAN, 6, payload, SCAN_BYTES + 1);
    CHECK(error() == ERROR_BAD_REQUEST);
    send(PROTOCOL_VERSION, KIND_SCAN, 6, payload, SCAN_BYTES - 1);
    CHECK(error() == ERROR_BAD_REQUEST);
    for (size_t cut = 1; cut <= size; cut++) {
        send(PROTOCOL_VERSION, KIND_PATTERN, 6, payload, size - cut);
        CHECK(error() == ERROR_BAD_REQUEST);
    }
    send(PROTOCOL_VERSION, KIND_PATTERN, 6, payload, size + 1);
    CHECK(error() == ERROR_BAD_REQUEST);

    static const struct {
        unsigned index; /* of the number that is changed; slot, n_inj, n_meas, 2 x 2 electrodes, 6 x 3 of measurements */
        unsigned value;
        uint16_t code;
    } changes[] = {
        {0, PATTERN_SLOTS, ERROR_TOO_LARGE}, {0, 65535, ERROR_TOO_LARGE},   {3, 1, ERROR_BAD_PATTERN},  {3, 16, ERROR_BAD_PATTERN},
        {6, 256, ERROR_BAD_PATTERN},         {7, 1, ERROR_BAD_PATTERN},     {8, 1, ERROR_BAD_PATTERN},  {9, 16, ERROR_BAD_PATTERN},
        {12, 257, ERROR_BAD_PATTERN},        {22, 2, ERROR_BAD_PATTERN},    {22, 0, ERROR_BAD_PATTERN},
    };
    for (size_t k = 0; k < sizeof changes / sizeof *changes; k++) {
        size = pattern_payload(payload, 0, 2, 3);
        put_u16(payload, changes[k].index, changes[k].value);
        send(PROTOCOL_VERSION, KIND_PATTERN, 8, payload, size);
        CHECK(error() == changes[k].code);
    }
    size = pattern_payload(payload, 0, MAX_INJECTIONS + 1, 2);
    send(PROTOCOL_VERSION, KIND_PATTERN, 8, payload, size);
    CHECK(error() == ERROR_TOO_LARGE);
    size = pattern_payload(payload, 0, 1, MAX_MEASUREMENTS + 1);
    send(PROTOCOL_VERSION, KIND_PATTERN, 8, payload, size);
    CHECK(error() == ERROR_TOO_LARGE);
    size = pattern_payload(payload, 0, 0, 0);
    send(PROTOCOL_VERSION, KIND_PATTERN, 8, payload, size);
    CHECK(error() == ERROR_BAD_PATTERN);

    scan_slot(0, digest); /* all of which left the slot as it was */
    CHECK(frame().digest == digest);

    fake.trouble = BOARD_FAILED;
    scan_slot(0, digest);
    CHECK(error() == ERROR_FAILED && fake.events[fake.n_events - 1].what == REST);
    fake.trouble = 0;
    fake.ready = false;
    scan_slot(0, digest);
    CHECK(error() == ERROR_BUSY);
    send(PROTOCOL_VERSION + 1, KIND_HELLO, 5, NULL, 0);
    CHECK(error() == ERROR_WRONG_VERSION);
    fake.ready = true;
    scan_slot(0, digest);
    CHECK(frame().digest == digest);
}

static void presses_are_passed_on_or_refused(void)
{
    start();
    message_press_t press = {0.1f, 0.05f, 8e-3f, 2e4f, 3};
    send(PROTOCOL_VERSION, KIND_PRESS, 1, &press, sizeof press);
    CHECK(replies() == 1 && got.header.kind == KIND_ACK && memcmp(&fake.press, &press, sizeof press) == 0);
    send(PROTOCOL_VERSION, KIND_PRESS, 1, &press, sizeof press - 1);
    CHECK(error() == ERROR_BAD_REQUEST);
    fake.why_not = "off the sheet";
    send(PROTOCOL_VERSION, KIND_PRESS, 1, &press, sizeof press);
    CHECK(error() == ERROR_BAD_REQUEST && got.size == ERROR_BYTES + 13 && memcmp(got.payload + ERROR_BYTES, "off the sheet", 13) == 0);
    fake.why_not = NULL;
    fake.n_events = 0;
    const float wrong[] = {NAN, INFINITY, -1e9f};
    for (size_t field = 0; field < 4; field++) {
        for (size_t k = 0; k < 3; k++) {
            message_press_t bad = press;
            memcpy((char *)&bad + 4 * field, &wrong[k], 4);
            send(PROTOCOL_VERSION, KIND_PRESS, 1, &bad, sizeof bad);
            CHECK(error() == ERROR_BAD_REQUEST);
        }
    }
    CHECK(fake.n_events == 0);
    send(PROTOCOL_VERSION, KIND_HELLO, 2, NULL, 0);
    CHECK(replies() == 1 && fake.n_events == 1 && fake.events[0].what == LIFT);
    fake.about.features = 0;
    send(PROTOCOL_VERSION, KIND_PRESS, 1, &press, sizeof press);
    CHECK(error() == ERROR_NOT_SUPPORTED);
    CHECK(fake.n_events == 1);
}

static void damaged_packets_are_dropped_and_the_next_one_counts(void)
{
    start();
    for (size_t i = 0; i < sizeof VECTOR_PATTERN - 1; i++) {
        for (unsigned bit = 0; bit < 8; bit++) {
            uint8_t packet[sizeof VECTOR_PATTERN];
            memcpy(packet, VECTOR_PATTERN, sizeof packet);
            packet[i] = (uint8_t)(packet[i] ^ 1u << bit);
            feed(packet, sizeof packet);
            CHECK(fake.n_sent == 0);
        }
    }
    for (size_t cut = 1; cut < sizeof VECTOR_PATTERN; cut++) {
        feed(VECTOR_PATTERN + cut, sizeof VECTOR_PATTERN - cut); /* its beginning was lost */
        CHECK(fake.n_sent == 0);
        feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN - 1 - cut); /* its end was */
        take(0);
        CHECK(fake.n_sent == 0);
    }
    CHECK(session.patterns[0].n_inj == 0);
    srand(1);
    for (unsigned round = 0; round < 300; round++) {
        for (unsigned i = 0; i < 200; i++)
            take((uint8_t)rand());
        take(0);
        CHECK(fake.n_sent == 0);
        feed(VECTOR_HELLO, sizeof VECTOR_HELLO);
        CHECK(replies() == 1 && got.header.kind == KIND_CAPABILITIES);
    }
}

static void an_overlong_packet_is_dropped_and_touches_nothing(void)
{
    start();
    pattern_t before[PATTERN_SLOTS];
    memcpy(before, session.patterns, sizeof before);
    for (unsigned i = 0; i < 100000; i++)
        take((uint8_t)(1 + i % 255));
    CHECK(memcmp(before, session.patterns, sizeof before) == 0 && session.frames == 0);
    take(0);
    CHECK(fake.n_sent == 0);

    /* One byte more than the longest pattern has, with a checksum that is right. */
    uint8_t payload[LONGEST_PATTERN];
    memset(payload, 7, sizeof payload);
    const size_t longest = LONGEST_PATTERN - HEADER_BYTES - CHECKSUM_BYTES;
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, longest + 1);
    CHECK(fake.n_sent == 0);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, longest);
    CHECK(error() == ERROR_BAD_REQUEST);
    const size_t size = pattern_payload(payload, 1, MAX_INJECTIONS, MAX_MEASUREMENTS / MAX_INJECTIONS);
    CHECK(size == longest);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    CHECK(replies() == 1 && got.header.kind == KIND_ACK);
    scan_slot(1, digest_of(payload, size));
    CHECK(frame().n_meas == MAX_MEASUREMENTS);
    CHECK(got.size == FRAME_BYTES + 4 * (MAX_INJECTIONS + MAX_MEASUREMENTS));
}

static void a_request_may_be_repeated(void)
{
    start();
    for (unsigned again = 0; again < 3; again++) {
        feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN);
        CHECK(sent_is(VECTOR_ACK, sizeof VECTOR_ACK));
        fake.n_sent = 0;
    }
    for (unsigned again = 1; again < 4; again++) {
        feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
        const message_frame_t told = frame();
        CHECK(told.number == again && got.header.sequence == 3);
        CHECK(told.flags == (again == 1 ? FLAG_FIRST : 0));
    }
    session.frames = UINT32_MAX;
    for (unsigned again = 0; again < 2; again++) { /* the number wraps, and no frame is the first again */
        feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
        const message_frame_t told = frame();
        CHECK(told.number == again && told.flags == 0);
    }
    feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN); /* one after the other without waiting */
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(replies() == 2 && got.header.kind == KIND_FRAME);
}

static void slots_are_kept_apart_until_hello(void)
{
    uint8_t payload[2048];
    uint32_t digests[PATTERN_SLOTS];
    start();
    for (unsigned slot = 0; slot < PATTERN_SLOTS; slot++) {
        const size_t size = pattern_payload(payload, slot, slot + 1, 4);
        digests[slot] = digest_of(payload, size);
        send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
        message_ack_t ack = {0};
        CHECK(replies() == 1 && got.header.kind == KIND_ACK);
        memcpy(&ack, got.payload, sizeof ack);
        CHECK(ack.value == digests[slot]);
    }
    for (unsigned slot = 0; slot < PATTERN_SLOTS; slot++) {
        scan_slot(slot, digests[slot]);
        const message_frame_t told = frame();
        CHECK(told.digest == digests[slot] && told.n_inj == slot + 1 && told.n_meas == 4 * (slot + 1));
        scan_slot(slot, digests[(slot + 1) % PATTERN_SLOTS]);
        CHECK(error() == ERROR_DIGEST_MISMATCH);
    }
    send(PROTOCOL_VERSION, KIND_HELLO, 1, NULL, 0);
    CHECK(replies() == 1);
    for (unsigned slot = 0; slot < PATTERN_SLOTS; slot++) {
        scan_slot(slot, digests[slot]);
        CHECK(error() == ERROR_UNKNOWN_SLOT);
    }
}

static void an_injection_settles_before_it_is_sampled(void)
{
    uint8_t payload[2048];
    start();
    fake.about.averages = 4;
    const size_t size = pattern_payload(payload, 0, 3, 5);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    replies();
    fake.kicks = 0;
    scan_slot(0, digest_of(payload, size));
    const message_frame_t told = frame();
    CHECK(fake.n_events == 3 * 5 + 1);
    for (unsigned k = 0; k < 3; k++) {
        const event_t *drive = &fake.events[5 * k];
        CHECK(drive->what == DRIVE && drive->a == k && drive->b == k + 1);
        for (unsigned i = 1; i <= 4; i++)
            CHECK(drive[i].what == SAMPLE && drive[i].count == 5 && drive[i].a == 0 && drive[i].b == 1);
        CHECK(drive[1].time - drive->time >= 100 && drive[1].time - drive->time < 120);
        CHECK(drive[2].time - drive[1].time < 20);
    }
    CHECK(fake.events[15].what == REST);
    CHECK(told.time > fake.events[14].time && told.time <= fake.now);
    CHECK(fake.kicks >= 3 * 100); /* the watchdog is told all the while */
}

static void values_are_the_means_of_scaled_codes(void)
{
    uint8_t payload[2048];
    start();
    size_t size = pattern_payload(payload, 0, 2, 3);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    replies();
    scan_slot(0, digest_of(payload, size));
    frame();
    for (unsigned k = 0; k < 2; k++) {
        CHECK(value(k) == 512.0f / 262144.0f);
        for (unsigned i = 0; i < 3; i++) {
            const int code = fake_code((uint8_t)k, (uint8_t)(k + 1), (uint8_t)i, (uint8_t)(i + 1));
            CHECK(value(2 + 3 * k + i) == (float)(code - 2048) / 1024.0f);
        }
    }
    fake.about.averages = 8; /* codes 1000 .. 1007: mean 1003.5 */
    fake.voltage_code = 1000;
    fake.drift = 1;
    scan_slot(0, digest_of(payload, size));
    frame();
    CHECK(value(2) == (1003.5f - 2048.0f) / 1024.0f);
    CHECK(value(3) == value(2) && value(4) == value(2)); /* a drift meets all pairs alike */
    CHECK(value(5) == (1011.5f - 2048.0f) / 1024.0f);
    CHECK(value(0) == 512.0f / 262144.0f);
    fake.offset = fake.drift = 0;

    fake.about.amperes_zero = 100;
    fake.about.averages = 65535; /* the largest sum */
    fake.voltage_code = 4094;
    scan_slot(0, digest_of(payload, size));
    const message_frame_t told = frame();
    CHECK(told.flags == 0);
    CHECK(fabsf(value(2) - (4094.0f - 2048.0f) / 1024.0f) < 1e-6f && fabsf(value(0) - 412.0f / 262144.0f) < 1e-9f);
}

static void currents_that_are_not_measured_are_those_driven(void)
{
    start();
    fake.about.features &= ~(uint32_t)FEATURE_CURRENT_MEASURED;
    fake.current_code = 0;
    feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN);
    CHECK(replies() == 1);
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(frame().flags == FLAG_FIRST && value(0) == 2e-3f && value(1) == 2e-3f);
    fake.current_code = fake.about.code_max; /* nor does it clip */
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(frame().flags == 0 && value(0) == 2e-3f);
    fake.about.features |= FEATURE_VOLTAGE_SOURCE;
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(frame().flags == 0 && isnan(value(0)) && value(2) == (float)(fake_code(0, 1, 2, 3) - 2048) / 1024);
}

static void number_and_clock_go_on_through_sessions(void)
{
    start();
    uint64_t last = 0;
    for (unsigned number = 1; number < 4; number++) {
        feed(VECTOR_HELLO, sizeof VECTOR_HELLO);
        feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN);
        CHECK(replies() == 2);
        feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
        const message_frame_t told = frame();
        CHECK(told.number == number && told.flags == (number == 1 ? FLAG_FIRST : 0));
        CHECK(told.time > last && told.time <= fake.now); /* the last sample's, not the reply's */
        last = told.time;
    }
}

static void the_time_of_an_average_is_told(void)
{
    start();
    fake.about.averages = 8;
    feed(VECTOR_HELLO, sizeof VECTOR_HELLO);
    CHECK(replies() == 1);
    message_capabilities_t able;
    memcpy(&able, got.payload, sizeof able);
    CHECK(able.conversion_time == 8 * 2e-5f && able.settle_time == 1e-4f); /* for each measurement; for each injection */
}

static void clipped_samples_are_infinite_and_flagged(void)
{
    uint8_t payload[2048];
    start();
    fake.about.averages = 3;
    const size_t size = pattern_payload(payload, 0, 2, 3);
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    replies();
    fake.voltage_code = 4093; /* 4093, 4094, 4095, 4096 ... */
    fake.drift = 1;
    scan_slot(0, digest_of(payload, size));
    message_frame_t told = frame();
    CHECK(told.flags == (FLAG_FIRST | FLAG_CLIPPED) && value(2) == INFINITY && value(5) == INFINITY);
    fake.voltage_code = 4095;
    fake.offset = 0;
    fake.drift = -1; /* 4095, 4094 ...: the first sample alone */
    scan_slot(0, digest_of(payload, size));
    told = frame();
    CHECK(told.flags == FLAG_CLIPPED && value(2) == INFINITY && value(5) == (4091.0f - 2048.0f) / 1024.0f);
    fake.voltage_code = 5;
    fake.offset = 0;
    fake.drift = -1; /* 5, 4, 3 and 2, 1, 0: the second injection ends at the first code */
    scan_slot(0, digest_of(payload, size));
    told = frame();
    CHECK(told.flags == FLAG_CLIPPED && value(2) == -2044.0f / 1024.0f && value(5) == -INFINITY);
    fake.drift = fake.offset = 0;
    fake.current_code = 0; /* is its zero: nothing clipped */
    scan_slot(0, digest_of(payload, size));
    CHECK(frame().flags == 0 && value(0) == 0.0f);
    fake.current_code = 4095;
    fake.trouble = BOARD_CURRENT_LIMIT;
    scan_slot(0, digest_of(payload, size));
    CHECK(frame().flags == (FLAG_CLIPPED | FLAG_CURRENT_LIMIT) && value(0) == INFINITY);
}

static void many_pairs_of_an_injection_and_none_are_taken_in_batches(void)
{
    uint8_t payload[2048];
    start();
    fake.about.averages = 2;
    fake.drift = 1;
    fake.voltage_code = 1000;
    size_t size = pattern_payload(payload, 0, 1, 33);
    put_u16(payload, 1, 2); /* a second injection, without measurements */
    memmove(payload + 14, payload + 10, size - 10);
    put_u16(payload, 5, 4);
    put_u16(payload, 6, 9);
    size += 4;
    send(PROTOCOL_VERSION, KIND_PATTERN, 1, payload, size);
    CHECK(replies() == 1 && got.header.kind == KIND_ACK);
    scan_slot(0, digest_of(payload, size));
    frame();
    static const uint16_t counts[] = {0, BOARD_BATCH, 1, BOARD_BATCH, 1, 0, 0, 0, 0};
    static const what_t whats[] = {DRIVE, SAMPLE, SAMPLE, SAMPLE, SAMPLE, DRIVE, SAMPLE, SAMPLE, REST};
    CHECK(fake.n_events == 9);
    for (size_t i = 0; i < 9; i++)
        CHECK(fake.events[i].what == whats[i] && fake.events[i].count == counts[i]);
    CHECK(value(2) == (1001.0f - 2048.0f) / 1024.0f && value(2 + 31) == value(2)); /* 1000 and 1002 */
    CHECK(value(2 + 32) == (1002.0f - 2048.0f) / 1024.0f);                         /* 1001 and 1003 */
    CHECK(value(0) == value(1) && value(1) == 512.0f / 262144.0f);
}

static void a_late_sample_is_flagged(void)
{
    start();
    feed(VECTOR_PATTERN, sizeof VECTOR_PATTERN);
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(replies() == 3);
    message_frame_t told;
    memcpy(&told, got.payload, sizeof told);
    CHECK(told.flags == 0);
    fake.step = 1500; /* something held the processor up for 1.5 ms */
    feed(VECTOR_SCAN, sizeof VECTOR_SCAN);
    CHECK(frame().flags == FLAG_OVERRUN);
}

static void a_full_ring_loses_bytes_and_nothing_else(void)
{
    uint8_t memory[12];
    memset(memory, 0xEE, sizeof memory);
    ring_t ring = {memory + 2, 8, 0, 0, 0};
    CHECK(ring_take(&ring) == -1);
    for (unsigned round = 0; round < 20; round++) {
        for (uint8_t byte = 0; byte < 10; byte++)
            CHECK(ring_put(&ring, byte) == (byte < 7));
        for (uint8_t byte = 0; byte < 7; byte++)
            CHECK(ring_take(&ring) == byte);
        CHECK(ring_take(&ring) == -1 && ring.lost == 3 * (round + 1));
    }
    CHECK(memory[0] == 0xEE && memory[1] == 0xEE && memory[10] == 0xEE && memory[11] == 0xEE);

    /* Two requests into a ring with room for one and a half: the second is dropped, the next one is answered. */
    static uint8_t room[sizeof VECTOR_PATTERN + sizeof VECTOR_PATTERN / 2];
    ring_t line = {room, sizeof room, 0, 0, 0};
    start();
    for (unsigned copy = 0; copy < 2; copy++)
        for (size_t i = 0; i < sizeof VECTOR_PATTERN; i++)
            ring_put(&line, VECTOR_PATTERN[i]);
    for (int byte; (byte = ring_take(&line)) >= 0;)
        take((uint8_t)byte);
    CHECK(line.lost > 0 && replies() == 1 && got.header.kind == KIND_ACK);
    take(0);
    feed(VECTOR_HELLO, sizeof VECTOR_HELLO);
    CHECK(replies() == 1 && got.header.kind == KIND_CAPABILITIES);
}

int main(void)
{
    static const struct {
        const char *name;
        void (*run)(void);
    } tests[] = {
#define TEST(name) {#name, name}
        TEST(checksum_and_stuffing_are_those_of_the_document),
        TEST(every_length_and_zero_survives_stuffing),
        TEST(full_blocks_are_stuffed_as_documented),
        TEST(the_vectors_are_answered_by_vectors),
        TEST(every_refusal_has_its_code),
        TEST(presses_are_passed_on_or_refused),
        TEST(damaged_packets_are_dropped_and_the_next_one_counts),
        TEST(an_overlong_packet_is_dropped_and_touches_nothing),
        TEST(a_request_may_be_repeated),
        TEST(slots_are_kept_apart_until_hello),
        TEST(an_injection_settles_before_it_is_sampled),
        TEST(values_are_the_means_of_scaled_codes),
        TEST(currents_that_are_not_measured_are_those_driven),
        TEST(number_and_clock_go_on_through_sessions),
        TEST(the_time_of_an_average_is_told),
        TEST(clipped_samples_are_infinite_and_flagged),
        TEST(many_pairs_of_an_injection_and_none_are_taken_in_batches),
        TEST(a_late_sample_is_flagged),
        TEST(a_full_ring_loses_bytes_and_nothing_else),
    };
    for (size_t k = 0; k < sizeof tests / sizeof *tests; k++) {
        test = tests[k].name;
        tests[k].run();
    }
    printf("%zu tests, %u checks, %u failures\n", sizeof tests / sizeof *tests, checks, failures);
    return failures > 0;
}
