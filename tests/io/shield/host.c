/* A host of the extension shield, as a robot's driver is one: right, or with one known defect.
 *
 * usage: host LINE [key=value ...]      numbers; see `options`
 *
 * A right host opens the line raw, ends every request with EE, waits for the whole response with a
 * time-out, checks the echo, and asks anew after flushing when something is missing. At the end it
 * prints what it saw as one line of JSON. The numbers of the defects are those of docs/reference.
 */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { REQUEST = 11, RESPONSE = 32 };
enum { ENABLE = 0x01, IMU_RAW = 0x0A, UART_TIMEOUT = 0x0C, RPM = 0x11, FREQUENCY = 0x12, KP = 0x20 };

static struct { const char *name; double value; } options[] = {
    {"rate", 50}, {"count", 50}, {"rpm", 30}, {"blocking", 1}, {"defect", 0}, {"timeout_s", 0},
    {"raw", -1}, {"frequency", 0}, {"configure", 0}, {"lose_response", 0}, {"lose_request", 0},
    {"wait_ms", 60000}, {"enable", 1},
};

static double option(const char *name)
{
    for (size_t i = 0; i < sizeof options / sizeof *options; i++)
        if (strcmp(options[i].name, name) == 0)
            return options[i].value;
    fprintf(stderr, "no option %s\n", name);
    exit(2);
}

static int line, defect, asked, answered, wrong_echo, late, partial;
static double shortest_ms = 1e9, longest_ms;
static uint8_t tx[REQUEST], rx[RESPONSE];

static double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1e3 + t.tv_nsec * 1e-6;
}

static void open_line(const char *path)
{
    struct termios t;
    line = open(path, O_RDWR | O_NOCTTY | (option("blocking") ? 0 : O_NONBLOCK));
    if (line < 0 || tcgetattr(line, &t) != 0) {
        perror(path);
        exit(2);
    }
    cfmakeraw(&t);
    cfsetspeed(&t, B115200);
    t.c_cc[VMIN] = defect == 11;
    t.c_cc[VTIME] = defect == 11 ? 0 : 1;
    tcsetattr(line, TCSANOW, &t);
    tcflush(line, TCIOFLUSH);
    if (defect == 12)
        tcflow(line, TCIOFF); /* as a library's "no flow control" does it */
}

/* Read until `want` bytes are there or the time is over; a blocking read returns by itself. */
static int receive(uint8_t *to, int want)
{
    int got = 0;
    double end_ms = now_ms() + option("wait_ms");
    if (defect == 11)
        return read(line, to, want); /* once, for ever */
    while (got < want && now_ms() < end_ms) {
        struct pollfd p = {line, POLLIN, 0};
        if (!option("blocking") && poll(&p, 1, 10) <= 0)
            continue;
        ssize_t n = read(line, to + got, want - got);
        if (n > 0)
            got += n;
        else if (n < 0 && errno != EAGAIN && errno != EINTR)
            break;
    }
    return got;
}

static int ask_once(void)
{
    int lost = (int)option("lose_request") == ++asked;
    double start_ms = now_ms();
    if (write(line, tx, REQUEST - lost) != REQUEST - lost)
        return 0;
    int got = receive(rx, RESPONSE);
    double took_ms = now_ms() - start_ms;
    if (got < RESPONSE) {
        late++;
        return 0;
    }
    if ((int)option("lose_response") == asked) { /* the line lost its first byte */
        memmove(rx, rx + 1, RESPONSE - 1);
        partial = 1;
    } else if (partial && defect == 9) { /* reads on, one byte behind */
        memmove(rx, rx + 1, RESPONSE - 1);
    }
    answered++;
    if (took_ms < shortest_ms)
        shortest_ms = took_ms;
    if (took_ms > longest_ms)
        longest_ms = took_ms;
    if (rx[0] == tx[1])
        return 1;
    wrong_echo++;
    return 0;
}

static void ask(uint8_t command, const void *payload, size_t bytes)
{
    static int ends; /* defect 10: the end is unset until the first enable */
    tx[0] = 0xFF;
    tx[1] = command;
    memset(tx + 2, 0, 8);
    memcpy(tx + 2, payload, bytes);
    ends |= defect != 10 || command == ENABLE;
    tx[10] = ends ? 0xEE : 0x5A;
    for (int i = 0; i < 5 && !ask_once() && defect != 9; i++)
        tcflush(line, TCIFLUSH);
}

static void ask_float(uint8_t command, float value) { ask(command, &value, sizeof value); }

int main(int argc, char **argv)
{
    if (argc < 2)
        return 2;
    for (int i = 2; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        for (size_t k = 0; value && k < sizeof options / sizeof *options; k++)
            if (strncmp(options[k].name, argv[i], value - argv[i]) == 0)
                options[k].value = atof(value + 1);
    }
    defect = option("defect");
    open_line(argv[1]);

    for (int i = 0; i < option("configure"); i++)
        ask_float(KP + i % 6, 0.5f + i);
    if (option("timeout_s") > 0) {
        ask_float(UART_TIMEOUT, 1.0f);
        ask_float(UART_TIMEOUT, option("timeout_s") * (defect == 6 ? 1e6f : 1.0f));
    }
    if (option("frequency") > 0) {
        uint32_t hz = option("frequency");
        if (defect == 7)
            ask_float(FREQUENCY, option("frequency"));
        else
            ask(FREQUENCY, &hz, sizeof hz);
    }
    if (option("raw") >= 0) {
        uint8_t fused[2] = {0, 0}, flag[2] = {option("raw") ? 0xFF : 0, 0};
        if (defect == 8) {
            flag[1] = flag[0];
            flag[0] = 0;
        }
        ask(IMU_RAW, fused, 2);
        ask(IMU_RAW, flag, 2);
    }
    if (option("enable"))
        ask(ENABLE, "", 0);
    double hundredths = option("rpm") * 100.0, next_ms = now_ms();
    int16_t left = defect == 13 ? (int16_t)(hundredths + 0.5f) : lround(hundredths);
    int16_t right = defect == 13 ? (int16_t)(-hundredths + 0.5f) : lround(-hundredths);
    int16_t rpm[4] = {right, right, left, left}; /* rr fr rl fl */
    for (int i = 0; i < option("count"); i++) {
        ask(RPM, rpm, sizeof rpm);
        next_ms += 1e3 / option("rate");
        double rest_ms = next_ms - now_ms();
        if (rest_ms > 0)
            usleep(rest_ms * 1e3);
    }
    int16_t channel[4], field;
    memcpy(channel, rx + 1, sizeof channel);
    memcpy(&field, rx + 17, sizeof field);
    printf("{\"asked\": %d, \"answered\": %d, \"wrong_echo\": %d, \"late\": %d, "
           "\"shortest_ms\": %.6f, \"longest_ms\": %.6f, \"field_17\": %d, "
           "\"rpm\": [%d, %d, %d, %d]}\n",
           asked, answered, wrong_echo, late, shortest_ms, longest_ms, field,
           channel[0], channel[1], channel[2], channel[3]);
    return 0;
}
