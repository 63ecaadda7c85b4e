/* Sizes for the 8 KiB of the STM32F100. */
#ifndef CONFIG_H
#define CONFIG_H

#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 0
#define FIRMWARE_PATCH 0

#define MAX_INJECTIONS 24
#define MAX_MEASUREMENTS 224
#define PATTERN_SLOTS 4

#endif
