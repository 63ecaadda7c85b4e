/* Sizes for the 64 KiB of the STM32F107: all pairs of 16 electrodes in one scan. */
#ifndef CONFIG_H
#define CONFIG_H

#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 0
#define FIRMWARE_PATCH 0

#define MAX_INJECTIONS 120
#define MAX_MEASUREMENTS 1560
#define PATTERN_SLOTS 8

#endif
