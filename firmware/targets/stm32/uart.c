#include "uart.h"

#include "board.h"

void uart_start(uart_t *uart, uint32_t divider)
{
    uart->registers->BRR = divider;
    uart->registers->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    NVIC_ENABLE(uart->irq);
}

void uart_serve(uart_t *uart)
{
    usart_t *const registers = uart->registers;
    const uint32_t status = registers->SR;
    if (status & (USART_SR_RXNE | USART_SR_ORE)) /* reading DR after SR ends an overrun, too; the checksum tells the loss */
        ring_put(&uart->received, (uint8_t)registers->DR);
    if ((registers->CR1 & USART_CR1_TXEIE) && (status & USART_SR_TXE)) {
        const int byte = ring_take(&uart->waiting);
        if (byte >= 0)
            registers->DR = (uint32_t)byte;
        else
            registers->CR1 &= ~(uint32_t)USART_CR1_TXEIE;
    }
}

void uart_send(uart_t *uart, uint8_t byte)
{
    while (ring_after(&uart->waiting, uart->waiting.head) == uart->waiting.tail)
        board_kick();
    ring_put(&uart->waiting, byte);
    interrupts_off();
    uart->registers->CR1 |= USART_CR1_TXEIE;
    interrupts_on();
    NVIC_TRIGGER(uart->irq); /* QEMU 7 knows no transmit interrupt; on the real one this is once too often at most */
}

void uart_doze(const uart_t *uart)
{
    interrupts_off(); /* a byte that comes after the comparison still wakes the processor */
    if (uart->received.head == uart->received.tail)
        wait_for_interrupt();
    interrupts_on();
}
