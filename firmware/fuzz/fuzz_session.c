/*
 * Any bytes into a session: the sanitizers watch the memory, and every byte sent must belong to a packet that a decoder takes.
 * Most inputs would fail at the checksum and see nothing of the rest; so the first byte chooses whether the others are a raw
 * stream, or requests to be packed properly: kind and length, then the payload.
 */
#include <stdlib.h>
#include <string.h>

#include "crc32.h"
#include "fake_board.h"
#include "session.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static session_t session;

static void take(uint8_t byte) { session_take(&session, byte); }

static void require(int truth)
{
    if (!truth)
        abort();
}

static void check_replies(void)
{
    static uint8_t bytes[65536];
    cobs_decoder_t decoder;
    cobs_start(&decoder, bytes, sizeof bytes);
    for (size_t i = 0; i < fake.n_sent; i++) {
        const size_t got = cobs_take(&decoder, fake.sent[i]);
        if (fake.sent[i] != 0)
            continue;
        require(got >= HEADER_BYTES + CHECKSUM_BYTES);
        uint32_t told;
        memcpy(&told, bytes + got - CHECKSUM_BYTES, sizeof told);
        require(told == crc32_add(0, bytes, got - CHECKSUM_BYTES));
        require(bytes[0] == PROTOCOL_VERSION && bytes[1] >= 0x80);
    }
    require(fake.n_sent == 0 || fake.sent[fake.n_sent - 1] == 0);
}

/* Each request: sequence and kind in one byte, length, payload; the rest of the input ends the last one. */
static void take_requests(const uint8_t *data, size_t size)
{
    uint8_t packet[HEADER_BYTES + 255 + CHECKSUM_BYTES];
    while (size >= 2) {
        const size_t length = data[1] < size - 2 ? data[1] : size - 2;
        packet[0] = data[0] & 0x40 ? 2 : PROTOCOL_VERSION;
        packet[1] = data[0] & 0x3F;
        packet[2] = packet[3] = data[0];
        memcpy(packet + HEADER_BYTES, data + 2, length);
        const uint32_t checksum = crc32_add(0, packet, HEADER_BYTES + length);
        memcpy(packet + HEADER_BYTES + length, &checksum, sizeof checksum);
        cobs_send(packet, HEADER_BYTES + length + CHECKSUM_BYTES, take);
        data += 2 + length;
        size -= 2 + length;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (size == 0)
        return 0;
    fake_start();
    session_start(&session);
    fake.about.averages = 1 + (data[0] >> 6);
    fake.trouble = data[0] & 0x20 ? BOARD_CURRENT_LIMIT : 0;
    if (data[0] & 1)
        take_requests(data + 1, size - 1);
    else
        for (size_t i = 1; i < size; i++)
            take(data[i]);
    check_replies();

    /* Whatever came before, the session still answers. */
    static const uint8_t hello[] = {0x00, 0x04, 0x01, 0x01, 0x01, 0x05, 0x0F, 0xE3, 0x21, 0x81, 0x00};
    fake.n_sent = 0;
    for (size_t i = 0; i < sizeof hello; i++)
        take(hello[i]);
    require(fake.n_sent > 0);
    check_replies();
    return 0;
}
