/*
 * The core on standard input and output, for comparison with the Python device: requests in, replies out.
 * The codes are those of the fake board, so that the other side can work them out.
 */
#include <stdio.h>

#include "fake_board.h"
#include "session.h"

static session_t session;

int main(void)
{
    int byte;
    fake_start();
    session_start(&session);
    while ((byte = getchar()) != EOF) {
        session_take(&session, (uint8_t)byte);
        if (byte == 0) {
            fwrite(fake.sent, 1, fake.n_sent, stdout);
            fflush(stdout);
            fake.n_sent = 0;
            fake.n_events = 0;
        }
    }
    return 0;
}
