/*
 * The emulated board: QEMU's stm32vldiscovery. It has no analogue pins, so its USART2 leads to an analogue side in Python
 * (ohmskin.device.analogue), which is asked for codes of a converter. USART1 leads to the host, as on the real board.
 */
#include "board.h"

#include <string.h>

#include "analogue_layout.h"
#include "clock.h"
#include "config.h"
#include "session.h"
#include "target.h"
#include "uart.h"

enum {
    CLOCK = 24000000,          /* Hz */
    PATIENCE = 1500000,        /* us until the analogue side counts as gone; a busy computer holds it up for half a second */
    RETRY = 100000,            /* us between questions who it is */
    ASK_HEAD = 2,              /* kind and tag */
    LONGEST_ANSWER = 128,
};

/* A host that sends a PATTERN and a SCAN ahead of their turn loses nothing: twice one byte of stuffing, and the zero bytes. */
enum { AHEAD = LONGEST_PATTERN + LONGEST_PATTERN / 254 + 2 + HEADER_BYTES + SCAN_BYTES + CHECKSUM_BYTES + 2 + 1 };

static uint8_t host_received[AHEAD], host_waiting[64], analogue_received[128], analogue_waiting[32];
static uart_t host = {USART1, USART1_IRQ, {host_received, sizeof host_received, 0, 0, 0}, {host_waiting, sizeof host_waiting, 0, 0, 0}};
static uart_t analogue = {
    USART2, USART2_IRQ, {analogue_received, sizeof analogue_received, 0, 0, 0}, {analogue_waiting, sizeof analogue_waiting, 0, 0, 0}};

static struct {
    cobs_decoder_t decoder;
    uint8_t answer[LONGEST_ANSWER + 1]; /* and the end of a text */
    uint8_t tag;
} line;
static board_t described;
static bool ready;
static uint64_t asked_at;

static struct {
    uint8_t source;
    uint8_t sink;
    uint64_t at;
} driven;

void usart1_handler(void);
void usart1_handler(void) { uart_serve(&host); }
void usart2_handler(void);
void usart2_handler(void) { uart_serve(&analogue); }

static void put(uint8_t byte) { uart_send(&analogue, byte); }

/* Sends a request of kind and payload; the answer must have its tag. */
static void ask(uint8_t kind, uint8_t *request, size_t payload_size)
{
    request[0] = kind;
    request[1] = ++line.tag;
    cobs_send(request, ASK_HEAD + payload_size, put);
}

/* What has come of the answer to the last request: the size of its payload, which then lies in line.answer, or -1. */
static int answered(uint8_t kind)
{
    int byte;
    while ((byte = ring_take(&analogue.received)) >= 0) {
        const size_t size = cobs_take(&line.decoder, (uint8_t)byte);
        if (size >= ASK_HEAD && line.answer[0] == (kind | ANALOGUE_REPLY) && line.answer[1] == line.tag)
            return (int)(size - ASK_HEAD);
    }
    return -1;
}

/* The same, as soon as it comes; -1 if it does not. */
static int wait_for(uint8_t kind)
{
    const uint64_t start = clock_micros();
    int size;
    while ((size = answered(kind)) < 0 && clock_micros() - start < PATIENCE)
        uart_doze(&analogue); /* which leaves the computer to the analogue side */
    return size;
}

void target_start(void)
{
    clock_start(CLOCK);
    uart_start(&host, CLOCK / 921600);
    uart_start(&analogue, CLOCK / 921600);
    cobs_start(&line.decoder, line.answer, LONGEST_ANSWER);
    put(0); /* ends what a reset has cut off */
}

int target_receive(void) { return ring_take(&host.received); }

void target_wait(void)
{
    board();
    uart_doze(&host);
}

const board_t *board(void)
{
    if (ready)
        return &described;
    const int size = answered(ANALOGUE_DESCRIBE);
    message_tell_describe_t told;
    if (size >= (int)sizeof told && size <= (int)(sizeof told + TELL_DESCRIBE_NAME_BYTES)) {
        memcpy(&told, line.answer + ASK_HEAD, sizeof told);
        described = (board_t){
            .serial = told.serial,
            .boot = told.boot,
            .features = told.features,
            .excitation = told.excitation,
            .full_scale = told.full_scale,
            .settle_time = told.settle_time,
            .conversion_time = told.conversion_time,
            .volts_per_code = told.volts_per_code,
            .amperes_per_code = told.amperes_per_code,
            .volts_zero = told.volts_zero,
            .amperes_zero = told.amperes_zero,
            .code_max = told.code_max,
            .averages = told.averages,
            .electrodes = told.electrodes,
        };
        memcpy(described.name, line.answer + ASK_HEAD + sizeof told, (size_t)size - sizeof told);
        ready = true;
        return &described;
    }
    const uint64_t now = clock_micros();
    if (asked_at == 0 || now - asked_at > RETRY) {
        uint8_t request[ASK_HEAD];
        asked_at = now;
        ask(ANALOGUE_DESCRIBE, request, 0);
    }
    return NULL;
}

/* The analogue side connects them when it is asked for a sample; all that counts is when they were connected. */
void board_drive(uint8_t source, uint8_t sink)
{
    driven.source = source;
    driven.sink = sink;
    driven.at = clock_micros();
}

void board_rest(void) {}

uint8_t board_sample(const pair_t *pairs, uint16_t count, uint16_t *codes, uint16_t *current)
{
    uint8_t request[ASK_HEAD + ASK_SAMPLE_BYTES + BOARD_BATCH * ASK_SAMPLE_PAIRS_BYTES];
    const uint64_t elapsed = clock_micros() - driven.at;
    const message_ask_sample_t sample = {
        (uint16_t)(elapsed < UINT16_MAX ? elapsed : UINT16_MAX), driven.source, driven.sink, (uint8_t)count};
    memcpy(request + ASK_HEAD, &sample, sizeof sample);
    memcpy(request + ASK_HEAD + sizeof sample, pairs, sizeof(pair_t) * count);
    ask(ANALOGUE_SAMPLE, request, sizeof sample + sizeof(pair_t) * count);
    message_tell_sample_t told;
    if (wait_for(ANALOGUE_SAMPLE) != (int)(sizeof told + sizeof(uint16_t) * count))
        return BOARD_FAILED;
    memcpy(&told, line.answer + ASK_HEAD, sizeof told);
    memcpy(codes, line.answer + ASK_HEAD + sizeof told, sizeof(uint16_t) * count);
    *current = told.current;
    return told.flags;
}

uint64_t board_micros(void) { return clock_micros(); }

void board_kick(void) {} /* QEMU has no watchdog here */

void board_send(uint8_t byte) { uart_send(&host, byte); }

const char *board_press(const message_press_t *press)
{
    uint8_t request[ASK_HEAD + sizeof *press];
    memcpy(request + ASK_HEAD, press, sizeof *press);
    ask(ANALOGUE_PRESS, request, sizeof *press);
    const int size = wait_for(ANALOGUE_PRESS);
    if (size < 0)
        return "the analogue side did not answer";
    line.answer[ASK_HEAD + size] = 0;
    return size > 0 ? (const char *)line.answer + ASK_HEAD : NULL;
}

void board_lift(void)
{
    uint8_t request[ASK_HEAD];
    ask(ANALOGUE_LIFT, request, 0);
    wait_for(ANALOGUE_LIFT);
}
