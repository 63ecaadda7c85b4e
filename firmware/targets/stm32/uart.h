/* A USART with a ring of bytes each way, served by its interrupt. */
#ifndef UART_H
#define UART_H

#include "ring.h"
#include "stm32f1.h"

typedef struct {
    usart_t *registers;
    uint32_t irq;
    ring_t received;
    ring_t waiting;
} uart_t;

/* 8N1; `divider` is the bus clock over the baud rate. */
void uart_start(uart_t *uart, uint32_t divider);

/* What its interrupt handler does. */
void uart_serve(uart_t *uart);

/* One byte; waits for room. */
void uart_send(uart_t *uart, uint8_t byte);

/* Sleeps until the next interrupt, unless a byte is there. */
void uart_doze(const uart_t *uart);

#endif
