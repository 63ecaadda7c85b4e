/* A plain stand-in for libFuzzer: mutates the files of a folder at random. Takes FOLDER and -max_total_time=SECONDS. */
#include <dirent.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { MOST_FILES = 256, LONGEST = 4096 };

static uint8_t seeds[MOST_FILES][LONGEST];
static size_t sizes[MOST_FILES];
static size_t n_seeds;

static void read_seeds(const char *folder)
{
    DIR *listing = opendir(folder);
    for (struct dirent *entry; listing && (entry = readdir(listing)) && n_seeds < MOST_FILES;) {
        char path[1024];
        snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        FILE *file = entry->d_name[0] == '.' ? NULL : fopen(path, "rb");
        if (file) {
            sizes[n_seeds] = fread(seeds[n_seeds], 1, LONGEST, file);
            n_seeds += sizes[n_seeds] > 0;
            fclose(file);
        }
    }
    if (listing)
        closedir(listing);
}

static size_t below(size_t limit) { return (size_t)rand() % limit; }

int main(int count, char **arguments)
{
    double seconds = 10;
    for (int i = 1; i < count; i++) {
        if (strncmp(arguments[i], "-max_total_time=", 16) == 0)
            seconds = atof(arguments[i] + 16);
        else if (arguments[i][0] != '-')
            read_seeds(arguments[i]);
    }
    srand(1);
    const time_t start = time(NULL);
    unsigned long runs = 0;
    uint8_t data[2 * LONGEST];
    while (difftime(time(NULL), start) < seconds) {
        size_t size = 0;
        for (size_t part = 0; part < 2 && n_seeds > 0; part++) { /* two seeds, the second without its first byte */
            const size_t chosen = below(n_seeds);
            memcpy(data + size, seeds[chosen] + (part > 0), sizes[chosen] - (part > 0));
            size += sizes[chosen] - (part > 0);
        }
        if (size == 0)
            data[size++] = (uint8_t)below(256);
        for (size_t changes = below(8); changes > 0; changes--) {
            const size_t at = below(size);
            if (below(4) == 0)
                data[at] = (uint8_t)below(256);
            else if (below(2) == 0)
                data[at] ^= (uint8_t)(1u << below(8));
            else
                size = at + 1;
        }
        LLVMFuzzerTestOneInput(data, size);
        runs++;
    }
    printf("Done %lu runs in %.0f second(s)\n", runs, seconds);
    return 0;
}
