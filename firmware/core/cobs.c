#include "cobs.h"

enum { LONGEST_RUN = 254 };

void cobs_start(cobs_decoder_t *decoder, uint8_t *data, size_t capacity)
{
    *decoder = (cobs_decoder_t){.data = data, .capacity = capacity};
}

static void append(cobs_decoder_t *decoder, uint8_t byte)
{
    if (decoder->size < decoder->capacity)
        decoder->data[decoder->size++] = byte;
    else
        decoder->dropping = true;
}

size_t cobs_take(cobs_decoder_t *decoder, uint8_t byte)
{
    if (byte == 0) {
        const size_t size = decoder->dropping || decoder->left > 0 ? 0 : decoder->size;
        cobs_start(decoder, decoder->data, decoder->capacity);
        return size;
    }
    if (decoder->dropping)
        return 0;
    if (decoder->left > 0) {
        append(decoder, byte);
        decoder->left--;
        return 0;
    }
    if (decoder->zero) /* not before another code has come: the last one stands for no zero */
        append(decoder, 0);
    decoder->left = (uint8_t)(byte - 1);
    decoder->zero = byte <= LONGEST_RUN;
    return 0;
}

void cobs_send(const uint8_t *data, size_t size, void (*put)(uint8_t byte))
{
    for (;;) {
        size_t run = 0;
        while (run < LONGEST_RUN && run < size && data[run] != 0)
            run++;
        put((uint8_t)(run + 1));
        for (size_t i = 0; i < run; i++)
            put(data[i]);
        data += run;
        size -= run;
        if (size == 0)
            break;
        if (run < LONGEST_RUN) { /* the code stands for this zero */
            data++;
            size--;
        }
    }
    put(0);
}
