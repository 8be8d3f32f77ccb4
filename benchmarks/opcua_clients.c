/* Clients that cost little: each socket is a subscribed OPC UA session without security. What comes
 * in is counted, and every Publish response is answered by the next Publish request.
 *
 * usage: opcua_clients SECONDS TOKEN_BYTES FD...
 * Standard input has, per socket: channel, token, next sequence number (uint32 each), then the
 * encoded authentication token. Standard output gets: values, messages, connections lost. */
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { BUFFER = 1 << 20, HEAD = 24, PUBLISH = 826, PUBLISH_RESPONSE = 829, DATA_CHANGE = 811 };

struct client {
    uint32_t numbers[3]; /* channel, token, sequence */
    uint8_t token[64];
    uint8_t *buffer;
    size_t filled;
};

static size_t token_bytes;
static long long values, messages, lost;

static uint32_t u32(const uint8_t *p) { uint32_t v; memcpy(&v, p, 4); return v; }

static uint8_t *put(uint8_t *p, const void *from, size_t n) { memcpy(p, from, n); return p + n; }

static uint8_t *put32(uint8_t *p, uint32_t v) { return put(p, &v, 4); }

static void ask(int fd, struct client *c, uint32_t subscription, uint32_t acknowledged) {
    static const uint8_t type[4] = {1, 0, PUBLISH & 255, PUBLISH >> 8};
    uint8_t message[256] = "MSGF", *p = message + 8;
    /* 100 ns since 1601: open62541 answers no request from another time */
    int64_t stamp = ((int64_t)time(NULL) + 11644473600) * 10000000;
    p = put(p, c->numbers, 12);
    p = put32(p, c->numbers[2]++); /* request id */
    p = put(p, type, 4);
    p = put(p, c->token, token_bytes);
    p = put(p, &stamp, 8);
    p = put32(put32(put32(p, 1), 0), 0xFFFFFFFF);     /* handle, diagnostics, audit id */
    p = put(put32(p, 0), "\0\0\0", 3);                /* time-out, no more header */
    p = put32(put32(put32(p, 1), subscription), acknowledged);
    put32(message + 4, (uint32_t)(p - message));
    if (write(fd, message, (size_t)(p - message)) < 0) lost++;
}

/* Sequence number of a Publish response; adds up its values. */
static uint32_t count(const uint8_t *body) {
    const uint8_t *p = body + 4 + 8 + 4 + 4 + 1; /* type, time stamp, handle, status, diagnostics */
    uint32_t sequence, parts;
    p += 4 + 3 + 4;                              /* string table, more header, subscription */
    p += 4 + 4 * u32(p) + 1;                     /* available numbers, more notifications */
    sequence = u32(p);
    parts = u32(p + 12);
    p += 16;
    for (uint32_t i = 0; i < parts && i < 4; i++) {
        if (p[2] == (DATA_CHANGE & 255) && p[3] == DATA_CHANGE >> 8) values += u32(p + 9);
        p += 9 + u32(p + 5);
    }
    return sequence;
}

static void receive(int fd, struct client *c) {
    ssize_t n = read(fd, c->buffer + c->filled, BUFFER - c->filled);
    size_t at = 0;
    if (n <= 0) { lost++; close(fd); return; }
    c->filled += (size_t)n;
    while (c->filled - at >= 8 && c->filled - at >= u32(c->buffer + at + 4)) {
        const uint8_t *frame = c->buffer + at, *body = frame + HEAD;
        if (body[2] == (PUBLISH_RESPONSE & 255) && body[3] == PUBLISH_RESPONSE >> 8) {
            messages++;
            ask(fd, c, u32(body + 28), count(body));
        }
        at += u32(frame + 4);
    }
    memmove(c->buffer, c->buffer + at, c->filled -= at);
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

int main(int argc, char **argv) {
    double end = now() + atof(argv[1]);
    int n = argc - 3;
    struct client *clients = calloc((size_t)n, sizeof *clients);
    struct pollfd *polled = calloc((size_t)n, sizeof *polled);
    token_bytes = (size_t)atoi(argv[2]);
    for (int i = 0; i < n; i++) {
        clients[i].buffer = malloc(BUFFER);
        polled[i] = (struct pollfd){.fd = atoi(argv[i + 3]), .events = POLLIN};
        if (fread(clients[i].numbers, 1, 12, stdin) != 12) return 1;
        if (fread(clients[i].token, 1, token_bytes, stdin) != token_bytes) return 1;
    }
    while (now() < end) {
        if (poll(polled, (nfds_t)n, 100) <= 0) continue;
        for (int i = 0; i < n; i++)
            if (polled[i].revents) {
                long long before = lost;
                receive(polled[i].fd, &clients[i]);
                if (lost > before) polled[i].fd = -1;
            }
    }
    printf("%lld %lld %lld\n", values, messages, lost);
    return 0;
}
