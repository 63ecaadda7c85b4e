/*
 * The paper's microcontroller, STM32F107VC, with four MAX306 multiplexers (source, sink, plus, minus) and its own converters.
 * docs/firmware.md has the pin map. It compiles and links; no board was at hand to run it on.
 */
#include "board.h"

#include <stdbool.h>
#include <string.h>

#include "clock.h"
#include "crc32.h"
#include "session.h"
#include "stm32f1.h"
#include "target.h"
#include "uart.h"

enum {
    BAUD = 921600,
    DRIVE_ENABLE = 1 << 0,   /* PD0, high: the source's and the sink's multiplexers conduct */
    SENSE_ENABLE = 1 << 1,   /* PD1, likewise for plus and minus */
    CURRENT_LIMITED = 1 << 8, /* PD8, low: the source's comparator sees its limit */
    LET_GO = 1,              /* us until a multiplexer without EN has opened; data sheets say some 0.3 */
    SENSE_SETTLE = 10,       /* us after the plus and minus multiplexers were switched */
    WARM_UP = 20000,         /* us until the reference is settled */
    OSCILLATOR_TRIES = 100000,
    CONVERSION_TRIES = 1000,
};

/* A host that sends a PATTERN and a SCAN ahead of their turn loses nothing. */
enum { AHEAD = LONGEST_PATTERN + LONGEST_PATTERN / 254 + 2 + HEADER_BYTES + SCAN_BYTES + CHECKSUM_BYTES + 2 + 1 };

static uint8_t received[AHEAD], waiting[512];
static uart_t host = {USART1, USART1_IRQ, {received, sizeof received, 0, 0, 0}, {waiting, sizeof waiting, 0, 0, 0}};

/*
 * An instrumentation amplifier of gain 0.33 maps -5 V .. +5 V between the electrodes to the converter's 0 .. 3.3 V; the
 * current flows to ground through 100 ohms, whose voltage is converted at the same moment.
 */
static board_t about = {
    .name = "ohmskin F107",
    .features = FEATURE_CURRENT_MEASURED | FEATURE_VOLTAGE_SOURCE | FEATURE_DRIVEN_MEASURED,
    .excitation = 5.0f,
    .full_scale = 5.0f,
    .settle_time = 100e-6f,
    .conversion_time = 20e-6f,
    .volts_per_code = 10.0f / 4096.0f,
    .amperes_per_code = 3.3f / 4096.0f / 100.0f,
    .volts_zero = 2048,
    .amperes_zero = 0,
    .code_max = 4095,
    .averages = 16,
    .electrodes = 16,
};

extern uint8_t _ram_start;

/* Of the memory as the power left it: random after power-up. */
__attribute__((section(".noinit"))) static uint32_t memory_noise;

void before_memory(void);
void before_memory(void)
{
    memory_noise = crc32_add(0, &_ram_start, 32768);
}

void usart1_handler(void);
void usart1_handler(void) { uart_serve(&host); }

/* At least so long; the first microsecond of the clock may be a short one. */
static void wait_micros(uint32_t micros)
{
    for (const uint64_t start = clock_micros(); clock_micros() - start <= micros;) {
    }
}

static bool oscillator_is_up(uint32_t ready)
{
    for (uint32_t i = 0; i < OSCILLATOR_TRIES; i++)
        if (RCC->CR & ready)
            return true;
    return false;
}

/* 72 MHz from a crystal of 25 MHz (RM0008, 8.2); 36 MHz from the internal oscillator if the crystal does not start. */
static uint32_t start_clocks(void)
{
    enum { HSEON = 1 << 16, HSERDY = 1 << 17, PLLON = 1 << 24, PLLRDY = 1 << 25, PLL2ON = 1 << 26, PLL2RDY = 1 << 27 };
    enum { PREDIV1_BY_5 = 4, PREDIV2_BY_5 = 4 << 4, PLL2_TIMES_8 = 6 << 8, PREDIV1_FROM_PLL2 = 1 << 16 };
    enum { PLL_FROM_PREDIV1 = 1 << 16, PLL_TIMES_9 = 7 << 18, APB1_BY_2 = 4 << 8, ADC_BY_6 = 2 << 14, SWITCH_TO_PLL = 2 };
    uint32_t source = 0, hertz = 36000000;
    FLASH_ACR = 0x12; /* two wait states, prefetch */
    RCC->CR |= HSEON;
    if (oscillator_is_up(HSERDY)) {
        RCC->CFGR2 = PREDIV1_FROM_PLL2 | PREDIV1_BY_5 | PREDIV2_BY_5 | PLL2_TIMES_8; /* 25 / 5 * 8 / 5 = 8 MHz */
        RCC->CR |= PLL2ON;
        if (oscillator_is_up(PLL2RDY)) {
            source = PLL_FROM_PREDIV1;
            hertz = 72000000;
        }
    }
    RCC->CFGR = ADC_BY_6 | APB1_BY_2 | PLL_TIMES_9 | source;
    RCC->CR |= PLLON;
    while (!oscillator_is_up(PLLRDY)) {
    }
    RCC->CFGR |= SWITCH_TO_PLL;
    while ((RCC->CFGR >> 2 & 3u) != SWITCH_TO_PLL) {
    }
    return hertz;
}

static void start_pins(void)
{
    enum { AFIO = 1 << 0, A = 1 << 2, C = 1 << 4, D = 1 << 5, E = 1 << 6, CONVERTER1 = 1 << 9, CONVERTER2 = 1 << 10, UART = 1 << 14 };
    RCC->APB2ENR |= AFIO | A | C | D | E | CONVERTER1 | CONVERTER2 | UART;
    GPIOD->BRR = DRIVE_ENABLE | SENSE_ENABLE; /* before they become outputs */
    GPIOA->CRH = (GPIOA->CRH & ~0xFF0u) | 0x4B0u; /* PA9 alternate output, PA10 input */
    GPIOC->CRL &= ~0xFFu;                         /* PC0, PC1 analogue */
    GPIOD->CRL = (GPIOD->CRL & ~0xFFu) | 0x22u;   /* PD0, PD1 output */
    GPIOD->CRH = (GPIOD->CRH & ~0xFu) | 0x8u;     /* PD8 input with pull-up */
    GPIOD->BSRR = CURRENT_LIMITED;
    GPIOE->CRL = 0x22222222u; /* all addresses */
    GPIOE->CRH = 0x22222222u;
}

/* Both converters start together: ADC1 takes the voltage (PC0, channel 10), ADC2 the current (PC1, channel 11). */
static void start_converters(void)
{
    enum { ON = 1 << 0, CALIBRATE = 1 << 2, RESET_CALIBRATION = 1 << 3, BY_SOFTWARE = 7 << 17 | 1 << 20, SIMULTANEOUS = 6 << 16 };
    ADC1->CR1 = SIMULTANEOUS;
    adc_t *const both[2] = {ADC1, ADC2};
    for (uint32_t i = 0; i < 2; i++) {
        both[i]->SMPR1 = 3u << 3 * i; /* 28.5 cycles of 12 MHz */
        both[i]->SQR3 = 10 + i;
        both[i]->CR2 = BY_SOFTWARE | ON;
        wait_micros(10);
        both[i]->CR2 |= RESET_CALIBRATION;
        while (both[i]->CR2 & RESET_CALIBRATION) {
        }
        both[i]->CR2 |= CALIBRATE;
        while (both[i]->CR2 & CALIBRATE) {
        }
    }
}

/* Backup registers survive a reset, and with a battery the power; without one, the noise of the memory makes the difference. */
static uint32_t boot_number(void)
{
    enum { BACKUP = 1 << 27, POWER = 1 << 28, BACKUP_WRITABLE = 1 << 8 };
    RCC->APB1ENR |= BACKUP | POWER;
    PWR_CR |= BACKUP_WRITABLE;
    const uint16_t count = (uint16_t)(BKP_DR1 + 1u);
    BKP_DR1 = count;
    return crc32_add_u16(memory_noise, count);
}

static void start_watchdog(void)
{
    IWDG->KR = 0x5555; /* writable */
    IWDG->PR = 4;      /* 40 kHz / 64 */
    IWDG->RLR = 4095;  /* 4.4 s at its fastest, 60 kHz: the clock wakes the main loop every 1.9 s, or 3.7 s without a crystal */
    IWDG->KR = 0xCCCC; /* on, for good */
}

void target_start(void)
{
    const uint32_t hertz = start_clocks();
    clock_start(hertz);
    start_pins();
    start_converters();
    about.serial = crc32_add(0, UNIQUE_ID, 12);
    about.boot = boot_number();
    uart_start(&host, (hertz + BAUD / 2) / BAUD);
    start_watchdog();
}

int target_receive(void) { return ring_take(&host.received); }

void target_wait(void) { uart_doze(&host); }

const board_t *board(void) { return clock_micros() < WARM_UP ? NULL : &about; }

void board_drive(uint8_t source, uint8_t sink)
{
    GPIOD->BRR = DRIVE_ENABLE; /* break before make: no two electrodes are ever shorted */
    wait_micros(LET_GO);
    GPIOE->ODR = (GPIOE->ODR & 0xFF00u) | (uint32_t)sink << 4 | source;
    GPIOD->BSRR = DRIVE_ENABLE;
}

void board_rest(void) { GPIOD->BRR = DRIVE_ENABLE | SENSE_ENABLE; }

static void connect_sense(pair_t pair)
{
    GPIOD->BRR = SENSE_ENABLE;
    GPIOE->ODR = (GPIOE->ODR & 0x00FFu) | (uint32_t)pair.minus << 12 | (uint32_t)pair.plus << 8;
    GPIOD->BSRR = SENSE_ENABLE;
    wait_micros(SENSE_SETTLE);
}

/* Voltage in the lower half, current in the upper one; false if the converters do not answer. */
static bool convert(uint32_t *both)
{
    enum { START = 1 << 22, END_OF_CONVERSION = 1 << 1 };
    ADC1->CR2 |= START;
    for (uint32_t i = 0; i < CONVERSION_TRIES; i++) {
        if (ADC1->SR & END_OF_CONVERSION) {
            *both = ADC1->DR;
            return true;
        }
    }
    return false;
}

uint8_t board_sample(const pair_t *pairs, uint16_t count, uint16_t *codes, uint16_t *current)
{
    uint32_t both;
    for (uint16_t i = 0; i < count; i++) {
        connect_sense(pairs[i]);
        if (!convert(&both))
            return BOARD_FAILED;
        codes[i] = (uint16_t)(both & 0xFFFu);
    }
    if (!convert(&both))
        return BOARD_FAILED;
    *current = (uint16_t)(both >> 16);
    return GPIOD->IDR & CURRENT_LIMITED ? 0 : BOARD_CURRENT_LIMIT;
}

uint64_t board_micros(void) { return clock_micros(); }

void board_kick(void) { IWDG->KR = 0xAAAA; }

void board_send(uint8_t byte) { uart_send(&host, byte); }

const char *board_press(const message_press_t *press)
{
    (void)press;
    return "this skin is real; press it with a finger";
}

void board_lift(void) {}
