/* An FMU for tests: a lag with gain, and what models of others do wrong on demand.
   Compile with -DFMI=2 or -DFMI=3; with -DSTATELESS it cannot store its state, with -DTOGETHER
   it takes gain and lag in one call only. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { OK, WARNING, DISCARD, ERROR };
enum { NONE, SLEEPS, DIVIDES, CRASHES, LOOPS, FAILS, EXITS };
enum { TIME, U, Y, GAIN, LAG, MISCHIEF, AT_STEP, POSITIVE, STEPS, V, SUM, SMALL };

#if FMI == 2
#define F(name) fmi2##name
#define BOOL int32_t
#define INTEGER int32_t
#define N_VALUES
typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Log log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void *step_finished, *environment;
} Callbacks;
#else
#define F(name) fmi3##name
#define BOOL bool
#define INTEGER int32_t
#define N_VALUES , size_t n_values
typedef void (*Log)(void *, int, const char *, const char *);
#endif

typedef struct {
    double time, u, y, gain, lag, v[2];
    float small;
    int32_t mischief, at_step, steps;
    bool is_up;
    Log log;
    void *environment;
} Model;

static Model *make(Log log, void *environment) {
    Model *m = calloc(1, sizeof *m);
    m->gain = 2.0;
    m->lag = 0.1;
    m->at_step = 100;
    m->v[0] = m->v[1] = 3.0;
    m->log = log;
    m->environment = environment;
    return m;
}

static void say(Model *m, const char *text) {
#if FMI == 2
    m->log(m->environment, "model", ERROR, "error", text);
#else
    m->log(m->environment, ERROR, "error", text);
#endif
}

static int misbehave(Model *m) {
    volatile int32_t zero = 0, *nowhere = NULL;
    struct timespec nap = {0, 5000000};
    switch (m->mischief) {
    case SLEEPS: nanosleep(&nap, NULL); return OK;
    case DIVIDES: m->steps = m->steps / zero; return OK;
    case CRASHES: *nowhere = 1; return OK;
    case LOOPS: for (;;) zero = 0;
    case FAILS: say(m, "the bearing is hot"); return ERROR;
    case EXITS: exit(7);
    }
    return OK;
}

#if FMI == 2
Model *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                       const Callbacks *callbacks, int visible, int logging) {
    return type == 1 && !strcmp(guid, "{lag}") ? make(callbacks->log, callbacks->environment) : NULL;
}
int fmi2SetupExperiment(Model *m, int d, double t, double start, int s, double stop) { return OK; }
int fmi2EnterInitializationMode(Model *m) { return OK; }
#else
Model *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                   bool visible, bool logging, bool events, bool early,
                                   const uint32_t *required, size_t n, void *environment, Log log,
                                   void *update) {
    if (events || early || strcmp(token, "{lag}")) {
        log(environment, ERROR, "error", "wrong token");
        return NULL;
    }
    return make(log, environment);
}
int fmi3EnterInitializationMode(Model *m, bool d, double t, double start, bool s, double stop) {
    return OK;
}
#endif
int F(ExitInitializationMode)(Model *m) {
    m->is_up = true;
    if (m->lag <= 0.0) say(m, "lag must be positive");
    return m->lag > 0.0 ? OK : ERROR;
}
int F(Terminate)(Model *m) { return OK; }
void F(FreeInstance)(Model *m) { free(m); }

static double *real(Model *m, uint32_t reference) {
    switch (reference) {
    case TIME: return &m->time;
    case U: return &m->u;
    case Y: return &m->y;
    case GAIN: return &m->gain;
    case LAG: return &m->lag;
    }
    return NULL;
}

static int set_real(Model *m, const uint32_t *vr, size_t n, const double *values) {
    bool gain = false, lag = false;
    for (size_t i = 0; i < n; i++) {
        double *place = real(m, vr[i]);
        gain |= vr[i] == GAIN;
        lag |= vr[i] == LAG;
        if (vr[i] == V) memcpy(m->v, values, sizeof m->v);
        else if (place == NULL) return ERROR;
        else *place = *values;
        values += vr[i] == V ? 2 : 1;
    }
#ifdef TOGETHER
    if (gain != lag) say(m, "gain and lag belong together");
    return gain == lag ? OK : ERROR;
#endif
    return OK;
}
static int get_real(Model *m, const uint32_t *vr, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) {
        double *place = real(m, vr[i]);
        if (vr[i] == SUM) values[i] = m->v[0] + 10.0 * m->v[1];
        else if (place == NULL) return ERROR;
        else values[i] = *place;
    }
    return OK;
}
static int set_integer(Model *m, const uint32_t *vr, size_t n, const int32_t *values) {
    for (size_t i = 0; i < n; i++) {
        if (vr[i] == MISCHIEF) m->mischief = values[i];
        else if (vr[i] == AT_STEP) m->at_step = values[i];
        else return ERROR;
    }
    return OK;
}
static int get_integer(Model *m, const uint32_t *vr, size_t n, int32_t *values) {
    for (size_t i = 0; i < n; i++) values[i] = -m->steps;
    return OK;
}
static int get_boolean(Model *m, const uint32_t *vr, size_t n, BOOL *values) {
    for (size_t i = 0; i < n; i++) values[i] = m->y > 0.0;
    return OK;
}

#if FMI == 2
int fmi2SetReal(Model *m, const uint32_t *vr, size_t n, const double *v) { return set_real(m, vr, n, v); }
int fmi2GetReal(Model *m, const uint32_t *vr, size_t n, double *v) { return get_real(m, vr, n, v); }
int fmi2SetInteger(Model *m, const uint32_t *vr, size_t n, const int32_t *v) { return set_integer(m, vr, n, v); }
int fmi2GetInteger(Model *m, const uint32_t *vr, size_t n, int32_t *v) { return get_integer(m, vr, n, v); }
int fmi2GetBoolean(Model *m, const uint32_t *vr, size_t n, BOOL *v) { return get_boolean(m, vr, n, v); }
#else
int fmi3SetFloat64(Model *m, const uint32_t *vr, size_t n, const double *v, size_t k) { return set_real(m, vr, n, v); }
int fmi3GetFloat64(Model *m, const uint32_t *vr, size_t n, double *v, size_t k) { return get_real(m, vr, n, v); }
int fmi3SetInt32(Model *m, const uint32_t *vr, size_t n, const int32_t *v, size_t k) { return set_integer(m, vr, n, v); }
int fmi3GetInt32(Model *m, const uint32_t *vr, size_t n, int32_t *v, size_t k) { return get_integer(m, vr, n, v); }
int fmi3GetBoolean(Model *m, const uint32_t *vr, size_t n, BOOL *v, size_t k) { return get_boolean(m, vr, n, v); }
int fmi3SetFloat32(Model *m, const uint32_t *vr, size_t n, const float *v, size_t k) { m->small = v[0]; return OK; }
int fmi3GetFloat32(Model *m, const uint32_t *vr, size_t n, float *v, size_t k) { v[0] = m->small; return OK; }
#endif

#ifndef LACKS_STEP
static int step(Model *m, double time, double dt) {
    if (!m->is_up || time < m->time - 1e-9 || time > m->time + 1e-9) {
        say(m, "the step does not begin where the last one ended");
        return ERROR;
    }
    m->y += dt / (m->lag + dt) * (m->gain * m->u - m->y);
    m->time = time + dt;
    m->steps++;
    return m->steps >= m->at_step ? misbehave(m) : OK;
}
#if FMI == 2
int fmi2DoStep(Model *m, double time, double dt, int no_set) { return step(m, time, dt); }
#else
int fmi3DoStep(Model *m, double time, double dt, bool no_set, bool *event, bool *terminate,
               bool *early, double *last) {
    int status = step(m, time, dt);
    *event = *terminate = *early = false;
    *last = m->time;
    return status;
}
#endif
#endif

#ifndef STATELESS
#if FMI == 2
#define S(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate
#else
#define S(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState
#endif
int S(Get, )(Model *m, void **state) {
    if (*state == NULL) *state = malloc(sizeof *m);
    memcpy(*state, m, sizeof *m);
    return OK;
}
int S(Set, )(Model *m, void *state) {
    Log log = m->log;
    void *environment = m->environment;
    memcpy(m, state, sizeof *m);
    m->log = log;
    m->environment = environment;
    return OK;
}
int S(Free, )(Model *m, void **state) {
    free(*state);
    *state = NULL;
    return OK;
}
int S(Serialized, Size)(Model *m, void *state, size_t *size) {
    *size = sizeof *m;
    return OK;
}
int S(Serialize, )(Model *m, void *state, uint8_t *bytes, size_t size) {
    memcpy(bytes, state, size);
    return OK;
}
int DESERIALIZE(Model *m, const uint8_t *bytes, size_t size, void **state) {
    *state = malloc(sizeof *m);
    memcpy(*state, bytes, sizeof *m);
    return OK;
}
#endif
