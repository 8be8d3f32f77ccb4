/* An importer of our own: LIBRARY TOKEN N_STEPS STEP_S N_ROWS ROWS OUTPUTS. ROWS holds step, value
   reference and value as doubles; the outputs 1000 .. 1048 of every step go to OUTPUTS. Says how long
   a step takes. Linked against libc alone. */
#ifdef _WIN32
#include <windows.h>
#define RTLD_NOW 0
#define dlopen(name, how) ((void *)LoadLibraryA(name))
#define dlsym(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#define dlerror() "the library cannot be loaded"
#else
#include <dlfcn.h>
#endif
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { N_OUT = 49 };

static double now_ns(void) {
#ifdef _WIN32
    return clock() * (1e9 / CLOCKS_PER_SEC);
#else
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1e9 + t.tv_nsec;
#endif
}

static void log_message(void *environment, int status, const char *category, const char *text) {
    fprintf(stderr, "%s\n", text);
}

int main(int argc, char **argv) {
    void *library = dlopen(argv[1], RTLD_NOW);
    if (library == NULL) return fprintf(stderr, "%s\n", dlerror()), 1;
    void *(*instantiate)() = dlsym(library, "fmi3InstantiateCoSimulation");
    int (*enter)() = dlsym(library, "fmi3EnterInitializationMode");
    int (*leave)() = dlsym(library, "fmi3ExitInitializationMode");
    int (*set)(void *, const uint32_t *, size_t, const double *, size_t) = dlsym(library, "fmi3SetFloat64");
    int (*get)(void *, const uint32_t *, size_t, double *, size_t) = dlsym(library, "fmi3GetFloat64");
    int (*step)(void *, double, double, bool, bool *, bool *, bool *, double *) = dlsym(library, "fmi3DoStep");
    long n = atol(argv[3]), n_rows = atol(argv[5]), row = 0;
    double spent_ns = 0.0, dt = atof(argv[4]), *rows = malloc(n_rows * 24), y[N_OUT], last;
    FILE *in = fopen(argv[6], "rb"), *out = fopen(argv[7], "wb");
    bool event, terminate, early;
    uint32_t shown[N_OUT];
    for (int i = 0; i < N_OUT; i++) shown[i] = 1000 + i;
    if (fread(rows, 24, n_rows, in) != (size_t)n_rows) return 2;
    void *fmu = instantiate("robot", argv[2], "", false, false, false, false, NULL, (size_t)0, NULL,
                            log_message, NULL);
    if (fmu == NULL) return 3;
    int (*enter_at)(void *, bool, double, double, bool, double) = (int (*)(void *, bool, double, double, bool, double))enter;
    if (enter_at(fmu, false, 0.0, 0.0, false, 0.0) || leave(fmu)) return 4;
    for (long k = 0; k < n; k++) {
        for (; row < n_rows && rows[3 * row] <= k; row++) {
            uint32_t reference = (uint32_t)rows[3 * row + 1];
            if (set(fmu, &reference, 1, &rows[3 * row + 2], 1)) return 5;
        }
        double began_ns = now_ns();
        int status = step(fmu, k * dt, dt, false, &event, &terminate, &early, &last);
        spent_ns += now_ns() - began_ns;
        if (status || get(fmu, shown, N_OUT, y, N_OUT)) return 6;
        fwrite(y, sizeof *y, N_OUT, out);
    }
    fclose(out);
    printf("%.1f ns per step\n", spent_ns / n);
    return 0;
}
