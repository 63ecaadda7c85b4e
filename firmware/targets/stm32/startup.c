/* What runs before main: the vector table, and memory as C expects it. */
#include <stdint.h>
#include <string.h>

#include "stm32f1.h"

extern uint32_t _stack_top, _data_start, _data_end, _data_load, _bss_start, _bss_end;

int main(void);
void reset_handler(void);
void before_memory(void);
void stop(void);
void systick_handler(void);
void usart1_handler(void);
void usart2_handler(void);

/* A target may look at the memory as it was. */
__attribute__((weak)) void before_memory(void) {}

/* A fault, or an interrupt that nobody asked for: stay here until the watchdog starts the firmware anew. */
void stop(void)
{
    for (;;) {
    }
}

__attribute__((weak, alias("stop"))) void usart2_handler(void);

__attribute__((noreturn)) void reset_handler(void)
{
    before_memory();
    memcpy(&_data_start, &_data_load, (size_t)((uintptr_t)&_data_end - (uintptr_t)&_data_start));
    memset(&_bss_start, 0, (size_t)((uintptr_t)&_bss_end - (uintptr_t)&_bss_start));
    main();
    for (;;) {
    }
}

typedef void (*handler_t)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    handler_t reset;
    handler_t faults[13];
    handler_t systick;
    handler_t before_usarts[USART1_IRQ];
    handler_t usart1;
    handler_t usart2;
    handler_t after_usarts[68 - USART2_IRQ - 1];
} vectors = {
    &_stack_top, reset_handler, {[0 ... 12] = stop}, systick_handler, {[0 ... USART1_IRQ - 1] = stop},
    usart1_handler, usart2_handler, {[0 ... 68 - USART2_IRQ - 2] = stop},
};
