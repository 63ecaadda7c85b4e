/* What main needs of a target beside board.h. */
#ifndef TARGET_H
#define TARGET_H

/* Clocks, pins, UART, converter, watchdog. */
void target_start(void);

/* The next byte of the host, or -1. */
int target_receive(void);

/* Sleep until something may have come. */
void target_wait(void);

#endif
