/* Small sizes, so that every limit is reached soon. */
#ifndef CONFIG_H
#define CONFIG_H

#define FIRMWARE_MAJOR 1
#define FIRMWARE_MINOR 2
#define FIRMWARE_PATCH 3

#define MAX_INJECTIONS 8
#define MAX_MEASUREMENTS 64
#define PATTERN_SLOTS 3

#endif
