/* The robot as an FMU for co-simulation, FMI 2.0 and 3.0. Generated: robot.h, the numbers of one
 * robot, and kernels.h, the equations: the daemon's own kernels (hil_part). */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "robot.h"
#include "kernels.h"

#if FMI == 2
#include "fmi2FunctionTypes.h"
#define F(name) fmi2##name
#define Status fmi2Status
#define Handle fmi2Component
#define Reference fmi2ValueReference
#define Saved fmi2FMUstate
#define Logger fmi2CallbackLogger
#define OK fmi2OK
#define BAD fmi2Error
#else
#include "fmi3FunctionTypes.h"
#define F(name) fmi3##name
#define Status fmi3Status
#define Handle fmi3Instance
#define Reference fmi3ValueReference
#define Saved fmi3FMUState
#define Logger fmi3LogMessageCallback
#define OK fmi3OK
#define BAD fmi3Error
#endif

/* --- the robot ---------------------------------------------------------------------------------*/

typedef struct {
    uint64_t layout; /* of whom a serialised state is */
    int64_t tick;
    double start_s, v[N_V], p[N_P], next_p[N_P], x[N_X], u[N_U], y[N_Y];
    int64_t q[N_Y];
} State;

typedef struct {
    State now;
    void *environment;
    Logger log;
    bool is_up;
    char name[64];
} Robot;

static Status refuse(Robot *r, const char *format, ...) {
    char text[400];
    va_list more;
    va_start(more, format);
    vsnprintf(text, sizeof text, format, more);
    va_end(more);
    if (r->log != NULL) {
#if FMI == 2
        r->log(r->environment, r->name, BAD, "logStatusError", "%s", text);
#else
        r->log(r->environment, BAD, "logStatusError", text);
#endif
    }
    return BAD;
}

static void begin(Robot *r) {
    memset(&r->now, 0, sizeof r->now);
    r->now.layout = LAYOUT;
    memcpy(r->now.p, P_0, sizeof r->now.p);
    memcpy(r->now.next_p, P_0, sizeof r->now.p);
    memcpy(r->now.x, X_0, sizeof r->now.x);
    memcpy(r->now.u, U_0, sizeof r->now.u);
    memcpy(r->now.v, V_0, sizeof r->now.v);
    r->is_up = false;
}

static Robot *make(const char *name, const char *token, Logger log, void *environment) {
    Robot *r = calloc(1, sizeof *r);
    if (r == NULL) return NULL;
    r->log = log;
    r->environment = environment;
    snprintf(r->name, sizeof r->name, "%s", name == NULL ? "" : name);
    if (token == NULL || strcmp(token, TOKEN)) {
        refuse(r, "this library is of the FMU " TOKEN ", not of %s", token == NULL ? "none" : token);
        free(r);
        return NULL;
    }
    begin(r);
    return r;
}

static int64_t run_part(State *s, int64_t which, double *p, const double *more, int64_t n_more) {
    int64_t answer = 0;
    char *error;
    hil_part((char *)&answer, (char *)&error, which, (char *)p, (char *)s->x, (char *)s->u,
             (char *)s->y, (char *)s->q, (char *)more, n_more);
    return answer;
}

static void run_tick(State *s) {
    for (size_t i = 0; i < sizeof PARTS / sizeof *PARTS; i++)
        if (s->tick % PARTS[i].every == 0)
            run_part(s, PARTS[i].which, s->p, HALL, sizeof HALL / sizeof *HALL);
    s->tick++;
}

/* All that was tuned since the last step acts from now on, with the state carried over. */
static void take_parameters(State *s) {
    if (memcmp(s->p, s->next_p, sizeof s->p) == 0) return;
    run_part(s, CARRY, s->p, s->next_p, N_P);
    memcpy(s->p, s->next_p, sizeof s->p);
}

static Status step(Robot *r, double time_s, double step_s) {
    State *s = &r->now;
    double n = round(step_s / STEP_S), due_s = s->start_s + s->tick * STEP_S;
    if (!r->is_up) return refuse(r, "doStep before the initialisation has ended");
    if (!(fabs(time_s - due_s) <= 1e-3 * STEP_S + 1e-12 * fabs(due_s)))
        return refuse(r, "a step begins at %.17g s, the last one ended at %.17g s", time_s, due_s);
    if (!(n >= 1.0 && n <= 1e9 && fabs(step_s - n * STEP_S) <= 1e-6 * STEP_S))
        return refuse(r, "a communication step of %.17g s is no multiple of %.17g s", step_s, STEP_S);
    take_parameters(s);
    for (int64_t i = 0; i < (int64_t)n; i++) run_tick(s);
    return OK;
}

/* Return the number that a variable is if it can have a value, else say why not. */
static const Number *settable(Robot *r, Reference reference, double value) {
    const Number *about;
    if (reference >= FIRST_INPUT && reference < FIRST_INPUT + N_INPUT)
        about = &INPUTS[reference - FIRST_INPUT];
    else if (reference >= FIRST_TUNABLE && reference < FIRST_TUNABLE + N_TUNABLE)
        about = &TUNABLE[reference - FIRST_TUNABLE];
    else {
        refuse(r, "variable %u cannot be set", (unsigned)reference);
        return NULL;
    }
    if (about->is_flag && value != 0.0 && value != 1.0) {
        refuse(r, "%s: %g is neither 0 nor 1", about->name, value);
        return NULL;
    }
    if (value >= about->low && value <= about->high) return about;
    if (about->has_null && value == 0.0) return about;
    refuse(r, "%s: %g is outside %g .. %g", about->name, value, about->low, about->high);
    return NULL;
}

static Status get(Robot *r, Reference reference, double *value) {
    State *s = &r->now;
    if (reference == 0)
        *value = s->start_s + s->tick * STEP_S;
    else if (reference >= FIRST_INPUT && reference < FIRST_INPUT + N_INPUT)
        *value = s->u[INPUTS[reference - FIRST_INPUT].place];
    else if (reference >= FIRST_OUTPUT && reference < FIRST_OUTPUT + N_Y)
        *value = s->y[reference - FIRST_OUTPUT];
    else if (reference >= FIRST_TUNABLE && reference < FIRST_TUNABLE + N_TUNABLE) {
        const Number *about = &TUNABLE[reference - FIRST_TUNABLE];
        double own = s->v[about->place];
        *value = about->has_null && isnan(own) ? 0.0 : own;
    } else
        return refuse(r, "there is no variable %u", (unsigned)reference);
    return OK;
}

/* --- FMI, what both versions have --------------------------------------------------------------*/

/* All or nothing: parameters that fit each other only together come in one call. */
static Status set_all(Handle c, const Reference *vr, size_t n, const double *values) {
    State *s = &((Robot *)c)->now;
    double v[N_V], u[N_U], p[N_P];
    memcpy(v, s->v, sizeof v);
    memcpy(u, s->u, sizeof u);
    memcpy(p, s->next_p, sizeof p);
    for (size_t i = 0; i < n; i++) {
        const Number *about = settable(c, vr[i], values[i]);
        if (about == NULL) return BAD;
        int is_null = about->has_null && values[i] == 0.0;
        (vr[i] < FIRST_TUNABLE ? u : v)[about->place] = is_null ? NAN : values[i];
    }
    if (memcmp(v, s->v, sizeof v)) {
        int64_t why = run_part(s, PACK, p, v, N_V);
        if (why) return refuse(c, "%s", WHY[why]);
    }
    memcpy(s->v, v, sizeof v);
    memcpy(s->u, u, sizeof u);
    memcpy(s->next_p, p, sizeof p);
    return OK;
}

static Status get_all(Handle c, const Reference *vr, size_t n, double *values) {
    Status status = OK;
    for (size_t i = 0; i < n && status == OK; i++) status = get(c, vr[i], &values[i]);
    return status;
}

static Status begin_at(Handle c, double start_s) {
    ((Robot *)c)->now.start_s = start_s;
    return OK;
}

static Status save(Handle c, Saved *saved) {
    if (*saved == NULL) *saved = malloc(sizeof(State));
    if (*saved == NULL) return refuse(c, "no memory for a state");
    memcpy(*saved, &((Robot *)c)->now, sizeof(State));
    return OK;
}

static Status restore(Handle c, Saved saved) {
    memcpy(&((Robot *)c)->now, saved, sizeof(State));
    ((Robot *)c)->is_up = true;
    return OK;
}

static Status unpack(Handle c, const void *bytes, size_t size, Saved *saved) {
    State *s = malloc(sizeof *s);
    if (s == NULL) return refuse(c, "no memory for a state");
    if (size == sizeof *s) memcpy(s, bytes, sizeof *s);
    if (size != sizeof *s || s->layout != LAYOUT || s->tick < 0 || !is_sound(s->x)) {
        free(s);
        return refuse(c, "the serialised state is of another robot or damaged");
    }
    *saved = s;
    return OK;
}

const char *F(GetVersion)(void) { return FMI == 2 ? "2.0" : "3.0"; }
Status F(Terminate)(Handle c) { ((Robot *)c)->is_up = false; return OK; }
void F(FreeInstance)(Handle c) { free(c); }
Status F(Reset)(Handle c) { begin(c); return OK; }
Status F(ExitInitializationMode)(Handle c) {
    State *s = &((Robot *)c)->now;
    memcpy(s->p, s->next_p, sizeof s->p);
    ((Robot *)c)->is_up = true;
    return OK;
}

#if FMI == 2
#include "fmi2_calls.h"
#else
#include "fmi3_calls.h"
#endif
