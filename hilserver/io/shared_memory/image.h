/*
 * The robot's shared memory for C programs on the computer of the daemon (Linux, GCC or Clang).
 *
 * Made by `hilserver signals --format c`; it fits the configuration it was made with, which
 * hil_attach checks. Reading never delays the robot, and a half-written frame is never returned.
 */
#ifndef HILSERVER_H
#define HILSERVER_H

#include <fcntl.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#define HIL_IMAGE "@IMAGE@"
#define HIL_INPUTS "@INPUTS@"
#define HIL_LAYOUT INT64_C(@LAYOUT@)

/* Every signal in its unit; in: written to the robot. */
struct hil_values {
@VALUES@
};

/* Their status, an OPC UA status code; 0 is Good. */
struct hil_status {
@STATUS@
};

/* One tick of the robot. */
struct hil_frame {
    int64_t sequence;    /* 2 n + 2 for frame n */
    int64_t tick;        /* that computed the values */
    int64_t planned_ns;  /* its planned start, CLOCK_MONOTONIC */
    int64_t latched;     /* input rows taken over so far */
    struct hil_values values;
    struct hil_status status;
};

/* What a program writes (shared_memory.grants); NaN: left to others. */
struct hil_inputs {
    int64_t layout;
    int64_t counter;  /* odd while the program writes; it has to grow, or the values become stale */
@WRITTEN@
};

enum { HIL_SLOTS = @SLOTS@, HIL_WRITTEN = @N_WRITTEN@ };
_Static_assert(sizeof(struct hil_frame) == 8 * (4 + 2 * HIL_SLOTS), "no gaps between members");
_Static_assert(sizeof(struct hil_inputs) == 8 * (2 + HIL_WRITTEN), "no gaps between members");

/* Words of the head of the image. */
enum {
    HIL_MAGIC_WORD = 0, HIL_VERSION_WORD = 1, HIL_TEXT_BYTES = 2, HIL_RING_LENGTH = 5,
    HIL_RING_STRIDE = 6, HIL_RING_BASE = 7, HIL_RING_HEAD = 8, HIL_TEXT = 64
};

static inline void *hil_map(const char *path, int writes, size_t least, const char **why)
{
    struct stat found;
    int file = open(path, (writes ? O_RDWR : O_RDONLY) | O_CLOEXEC);
    if (file < 0) {
        *why = writes ? "no daemon lets a program write here: see shared_memory.grants"
                      : "no daemon runs under this image.name";
        return NULL;
    }
    void *memory = MAP_FAILED;
    if (fstat(file, &found) == 0 && (size_t)found.st_size >= least)
        memory = mmap(NULL, (size_t)found.st_size, writes ? PROT_READ | PROT_WRITE : PROT_READ,
                      MAP_SHARED, file, 0);
    close(file);
    *why = memory == MAP_FAILED ? "the daemon has not begun yet: try again" : NULL;
    return memory == MAP_FAILED ? NULL : memory;
}

/* Open the process image of a running daemon. NULL: *why says what to do. */
static inline const int64_t *hil_attach(const char *path, const char **why)
{
    const int64_t *image = hil_map(path, 0, 8 * HIL_TEXT, why);
    if (image == NULL)
        return NULL;
    if (image[HIL_MAGIC_WORD] != INT64_C(0x48494C5345525652) || image[HIL_VERSION_WORD] != @VERSION@) {
        *why = "another version of hilserver runs";
        return NULL;
    }
    static const char end[] = "@HEAD_END@";
    const char *text = (const char *)(image + HIL_TEXT);
    int64_t length = image[HIL_TEXT_BYTES] - (int64_t)(sizeof end - 1);
    uint64_t number = UINT64_C(0xcbf29ce484222325);
    for (int64_t i = 0; i < length && memcmp(text + i, end, sizeof end - 1) != 0; i++)
        number = (number ^ (unsigned char)text[i]) * UINT64_C(0x100000001b3);
    if ((int64_t)(number >> 1) != HIL_LAYOUT) {
        *why = "the robot has other signals: make this file again, with its configuration";
        return NULL;
    }
    return image;
}

/* Copy the newest frame; 0 if there is none yet. */
static inline int hil_read(const int64_t *image, struct hil_frame *out)
{
    for (int tries = 0; tries < 8; tries++) {
        int64_t head = __atomic_load_n(image + HIL_RING_HEAD, __ATOMIC_ACQUIRE);
        if (head == 0)
            return 0;
        int64_t place = (head - 1) & (image[HIL_RING_LENGTH] - 1);
        const int64_t *row = image + image[HIL_RING_BASE] + place * image[HIL_RING_STRIDE];
        int64_t begun = __atomic_load_n(row, __ATOMIC_ACQUIRE);
        memcpy(out, row, sizeof *out);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (begun == 2 * head && __atomic_load_n(row, __ATOMIC_RELAXED) == begun)
            return 1;
    }
    return 0;
}

/* Open the inputs, and set *mine to writing nothing. NULL: *why says what to do. */
static inline struct hil_inputs *hil_open_inputs(
    const char *path, struct hil_inputs *mine, const char **why)
{
    struct hil_inputs *shared = hil_map(path, 1, sizeof *shared, why);
    if (shared != NULL && shared->layout != HIL_LAYOUT) {
        *why = "the robot has other signals: make this file again, with its configuration";
        return NULL;
    }
    double *values = (double *)((int64_t *)mine + 2);
    for (int i = 0; i < HIL_WRITTEN; i++)
        values[i] = NAN;
    return shared;
}

/* Write all inputs together; one program at a time. Call it in every cycle, also without news. */
static inline void hil_write(struct hil_inputs *shared, const struct hil_inputs *mine)
{
    int64_t counter = shared->counter | 1;
    __atomic_store_n(&shared->counter, counter, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_RELEASE);
    memcpy((int64_t *)shared + 2, (const int64_t *)mine + 2, 8 * HIL_WRITTEN);
    __atomic_store_n(&shared->counter, counter + 1, __ATOMIC_RELEASE);
}

#endif
