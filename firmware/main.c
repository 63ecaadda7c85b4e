/* Bytes of the host to the session, for ever. */
#include "board.h"
#include "session.h"
#include "target.h"

static session_t session;

int main(void)
{
    target_start();
    session_start(&session);
    for (;;) {
        board_kick();
        const int byte = target_receive();
        if (byte >= 0)
            session_take(&session, (uint8_t)byte);
        else
            target_wait();
    }
}
