/* Microseconds from the SysTick timer. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

/* Starts it; `hertz` is the processor's clock, a multiple of 1 MHz. */
void clock_start(uint32_t hertz);

uint64_t clock_micros(void);

#endif
