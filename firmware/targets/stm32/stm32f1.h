/*
 * The registers of the STM32F1 that the firmware uses (reference manuals RM0008: F107, RM0041: F100).
 * Our own few lines instead of the vendor's headers, so that nothing has to be downloaded.
 */
#ifndef STM32F1_H
#define STM32F1_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))

typedef struct {
    volatile uint32_t SR, DR, BRR, CR1, CR2, CR3, GTPR;
} usart_t;

#define USART1 ((usart_t *)0x40013800u)
#define USART2 ((usart_t *)0x40004400u)
enum {
    USART_SR_ORE = 1 << 3,
    USART_SR_RXNE = 1 << 5,
    USART_SR_TXE = 1 << 7,
    USART_CR1_RE = 1 << 2,
    USART_CR1_TE = 1 << 3,
    USART_CR1_RXNEIE = 1 << 5,
    USART_CR1_TXEIE = 1 << 7,
    USART_CR1_UE = 1 << 13,
};
enum { USART1_IRQ = 37, USART2_IRQ = 38 };

typedef struct {
    volatile uint32_t CRL, CRH, IDR, ODR, BSRR, BRR, LCKR;
} gpio_t;

#define GPIOA ((gpio_t *)0x40010800u)
#define GPIOC ((gpio_t *)0x40011000u)
#define GPIOD ((gpio_t *)0x40011400u)
#define GPIOE ((gpio_t *)0x40011800u)

typedef struct {
    volatile uint32_t CR, CFGR, CIR, APB2RSTR, APB1RSTR, AHBENR, APB2ENR, APB1ENR, BDCR, CSR, AHBRSTR, CFGR2;
} rcc_t;

#define RCC ((rcc_t *)0x40021000u)

typedef struct {
    volatile uint32_t SR, CR1, CR2, SMPR1, SMPR2, JOFR[4], HTR, LTR, SQR1, SQR2, SQR3, JSQR, JDR[4], DR;
} adc_t;

#define ADC1 ((adc_t *)0x40012400u)
#define ADC2 ((adc_t *)0x40012800u)

typedef struct {
    volatile uint32_t KR, PR, RLR, SR;
} iwdg_t;

#define IWDG ((iwdg_t *)0x40003000u)

#define FLASH_ACR REGISTER(0x40022000u)
#define PWR_CR REGISTER(0x40007000u)
#define BKP_DR1 REGISTER(0x40006C04u)
#define UNIQUE_ID ((const void *)0x1FFFF7E8u) /* 12 bytes */

#define NVIC_ENABLE(irq) (REGISTER(0xE000E100u + 4u * ((irq) / 32u)) = 1u << ((irq) % 32u))
#define NVIC_TRIGGER(irq) (REGISTER(0xE000EF00u) = (irq))
#define SYSTICK_CTRL REGISTER(0xE000E010u)
#define SYSTICK_LOAD REGISTER(0xE000E014u)
#define SYSTICK_VAL REGISTER(0xE000E018u)

/* For the main loop, when an interrupt handler changes the same register. */
static inline void interrupts_off(void) { __asm volatile("cpsid i" ::: "memory"); }
static inline void interrupts_on(void) { __asm volatile("cpsie i" ::: "memory"); }
/* Sleeps until the next interrupt; that of the clock comes every few seconds. */
static inline void wait_for_interrupt(void) { __asm volatile("wfi" ::: "memory"); }

#endif
