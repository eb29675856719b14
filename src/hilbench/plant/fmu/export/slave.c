/* A machine of hilbench as a co-simulation slave, FMI 2.0.4 (HB_FMI 2) or 3.0.1 (HB_FMI 3).
 *
 * The physics is the kernel, compiled beside this file. "machine.h", made with it, has the machine: its vectors at the
 * start and a table that says where each variable stands in them. Declarations are those of the standard, as far as
 * they are needed here. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "machine.h"

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

enum { P, S, U, OUT, NONE };
enum { OK, WARNING, DISCARD, FAILED, FATAL };

typedef struct { double p[HB_P], s[HB_S], u[HB_U], out[HB_OUT], time; } State;
typedef struct Slave Slave;
typedef void (*Logger)(Slave *, int, const char *, const char *);
struct Slave {
    State state;
    double w[HB_W];
    char *name;
    Logger log;
    void *environment, *callback;
    int logging, stale;
};
/* Where variable k stands: its value is the number there, divided by scale. Several rows may have one reference. */
typedef struct { unsigned reference; int vector; int place; double scale; } Row;
static const Row rows[] = HB_ROWS;
static const double p0[HB_P] = HB_P0, s0[HB_S] = HB_S0, u0[HB_U] = HB_U0;

/* numba's calling convention: an array is meminfo, parent, items, item size, data, shape, stride. */
#define ARRAY_TYPE void *, void *, int64_t, int64_t, double *, int64_t, int64_t
#define ARRAY(x, n) NULL, NULL, (int64_t)(n), 8, (x), (int64_t)(n), 8
extern int32_t HB_KERNEL(void *, void **, ARRAY_TYPE, ARRAY_TYPE, ARRAY_TYPE, ARRAY_TYPE, ARRAY_TYPE, int64_t, double);

static int complain(Slave *c, int status, const char *text) {
    if (c->log && c->logging) c->log(c, status, "logStatusError", text);
    return status;
}

static int go(Slave *c, int64_t samples, double duration) {
    State *x = &c->state;
    void *result = NULL, *error = NULL;
    if (HB_KERNEL(&result, &error, ARRAY(x->p, HB_P), ARRAY(x->s, HB_S), ARRAY(x->u, HB_U), ARRAY(c->w, HB_W),
                  ARRAY(x->out, HB_OUT), samples, duration))
        return complain(c, FATAL, "the kernel has failed");
    c->stale = 0;
    return OK;
}

static void begin(Slave *c) {
    memcpy(c->state.p, p0, sizeof p0);
    memcpy(c->state.s, s0, sizeof s0);
    memcpy(c->state.u, u0, sizeof u0);
    memset(c->w, 0, sizeof c->w);
    c->state.time = 0.0;
    c->stale = 1;
}

static Slave *new_slave(const char *name, const char *token, int logging) {
    if (!token || strcmp(token, HB_TOKEN)) return NULL;
    Slave *c = calloc(1, sizeof *c);
    if (!c) return NULL;
    c->name = calloc(1, strlen(name) + 1);
    if (c->name) strcpy(c->name, name);
    c->logging = logging;
    begin(c);
    return c;
}

static void free_slave(Slave *c) {
    if (c) free(c->name);
    free(c);
}

static double *vector(Slave *c, int which) {
    State *x = &c->state;
    return which == P ? x->p : which == S ? x->s : which == U ? x->u : x->out;
}

static void start(Slave *c, double time) {
    c->state.time = time;
    c->state.s[HB_TIME_PLACE] = time * HB_TIME_SCALE;
}

static int get(Slave *c, const unsigned *reference, size_t count, double *value) {
    if (c->stale && go(c, 0, 0.0) != OK) return FATAL;
    for (size_t i = 0; i < count; i++) {
        size_t k = 0, n = sizeof rows / sizeof *rows;
        if (reference[i] == 0) { value[i] = c->state.time; continue; }
        while (k < n && rows[k].reference != reference[i]) k++;
        if (k == n) return complain(c, FAILED, "a value reference that there is not");
        value[i] = vector(c, rows[k].vector)[rows[k].place] / rows[k].scale;
    }
    return OK;
}

static int set(Slave *c, const unsigned *reference, size_t count, const double *value) {
    for (size_t i = 0; i < count; i++) {
        int found = 0;
        if (!isfinite(value[i])) return complain(c, FAILED, "a value that is not finite");
        for (size_t k = 0; k < sizeof rows / sizeof *rows; k++)
            if (rows[k].reference == reference[i] && rows[k].vector != OUT && rows[k].vector != S) {
                vector(c, rows[k].vector)[rows[k].place] = value[i] * rows[k].scale;
                found = 1;
            }
        if (!found) return complain(c, FAILED, "a value reference that can't be set");
    }
    c->stale = 1;
    return OK;
}

static int step(Slave *c, double time, double duration) {
    double samples = HB_SAMPLE_S > 0.0 ? floor(duration / HB_SAMPLE_S + 0.5) : 0.0;
    if (!(duration > 0.0)) return complain(c, FAILED, "a communication step that is not above 0");
    if (HB_SAMPLE_S > 0.0 && (samples < 1.0 || fabs(samples * HB_SAMPLE_S - duration) > 1e-6 * HB_SAMPLE_S))
        return complain(c, FAILED, "a communication step that is no multiple of the drives' sample time " HB_SAMPLE_TEXT);
    for (size_t k = 0; k < sizeof rows / sizeof *rows; k++)
        if (rows[k].vector == NONE) c->state.s[rows[k].place] = 0.0;
    c->state.time = time + duration;
    return go(c, (int64_t)samples, duration);
}

static int take(Slave *c, void **kept) {
    if (!*kept && !(*kept = malloc(sizeof(State)))) return FAILED;
    memcpy(*kept, &c->state, sizeof(State));
    return OK;
}

static int give(Slave *c, const void *kept) {
    if (!kept) return complain(c, FAILED, "no state");
    memcpy(&c->state, kept, sizeof(State));
    c->stale = 1;
    return OK;
}

#if HB_FMI == 2

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

static void tell2(Slave *c, int status, const char *category, const char *text) {
    Callbacks *callbacks = c->callback;
    callbacks->logger(callbacks->environment, c->name ? c->name : "", status, category, "%s", text);
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API int fmi2SetDebugLogging(Slave *c, int on, size_t n, const char *const category[]) {
    (void)n, (void)category;
    c->logging = on;
    return OK;
}
API Slave *fmi2Instantiate(const char *name, int kind, const char *token, const char *resources, Callbacks *callbacks,
                           int visible, int logging) {
    (void)resources, (void)visible;
    Slave *c = kind == 1 && name ? new_slave(name, token, logging) : NULL;
    if (c && callbacks) {
        c->callback = callbacks;
        c->log = callbacks->logger ? tell2 : NULL;
    }
    return c;
}
API void fmi2FreeInstance(Slave *c) { free_slave(c); }
API int fmi2SetupExperiment(Slave *c, int tolerance, double value, double begins, int ends, double stop) {
    (void)tolerance, (void)value, (void)ends, (void)stop;
    start(c, begins);
    return OK;
}
API int fmi2EnterInitializationMode(Slave *c) { (void)c; return OK; }
API int fmi2ExitInitializationMode(Slave *c) { (void)c; return OK; }
API int fmi2Terminate(Slave *c) { (void)c; return OK; }
API int fmi2Reset(Slave *c) { begin(c); return OK; }
API int fmi2GetReal(Slave *c, const unsigned *r, size_t n, double *v) { return get(c, r, n, v); }
API int fmi2SetReal(Slave *c, const unsigned *r, size_t n, const double *v) { return set(c, r, n, v); }
#define OTHER(NAME) \
    API int fmi2Get##NAME(Slave *c, const unsigned *r, size_t n, void *v) { (void)c, (void)r, (void)v; return n ? FAILED : OK; } \
    API int fmi2Set##NAME(Slave *c, const unsigned *r, size_t n, const void *v) { (void)c, (void)r, (void)v; return n ? FAILED : OK; }
OTHER(Integer)
OTHER(Boolean)
OTHER(String)
API int fmi2GetFMUstate(Slave *c, void **kept) { return take(c, kept); }
API int fmi2SetFMUstate(Slave *c, void *kept) { return give(c, kept); }
API int fmi2FreeFMUstate(Slave *c, void **kept) { (void)c; free(*kept); *kept = NULL; return OK; }
API int fmi2SerializedFMUstateSize(Slave *c, void *kept, size_t *size) { (void)c, (void)kept; *size = sizeof(State); return OK; }
API int fmi2SerializeFMUstate(Slave *c, void *kept, char bytes[], size_t size) {
    if (size < sizeof(State)) return complain(c, FAILED, "too few bytes for a state");
    memcpy(bytes, kept, sizeof(State));
    return OK;
}
API int fmi2DeSerializeFMUstate(Slave *c, const char bytes[], size_t size, void **kept) {
    if (size != sizeof(State)) return complain(c, FAILED, "a state of another size");
    if (!*kept && !(*kept = malloc(sizeof(State)))) return FAILED;
    memcpy(*kept, bytes, sizeof(State));
    return OK;
}
API int fmi2GetDirectionalDerivative(Slave *c, const unsigned *z, size_t nz, const unsigned *v, size_t nv, const double *dv, double *dz) {
    (void)z, (void)nz, (void)v, (void)nv, (void)dv, (void)dz;
    return complain(c, FAILED, "directional derivatives are not provided");
}
API int fmi2SetRealInputDerivatives(Slave *c, const unsigned *r, size_t n, const int *order, const double *v) {
    (void)r, (void)order, (void)v;
    return n ? complain(c, FAILED, "inputs are held") : OK;
}
API int fmi2GetRealOutputDerivatives(Slave *c, const unsigned *r, size_t n, const int *order, double *v) {
    (void)r, (void)order, (void)v;
    return n ? complain(c, FAILED, "derivatives of outputs are not provided") : OK;
}
API int fmi2DoStep(Slave *c, double time, double duration, int final) { (void)final; return step(c, time, duration); }
API int fmi2CancelStep(Slave *c) { (void)c; return FAILED; }
API int fmi2GetStatus(Slave *c, int kind, int *value) { (void)c, (void)kind, (void)value; return DISCARD; }
API int fmi2GetRealStatus(Slave *c, int kind, double *value) {
    if (kind != 2) return DISCARD;
    *value = c->state.time;
    return OK;
}
API int fmi2GetIntegerStatus(Slave *c, int kind, int *value) { (void)c, (void)kind, (void)value; return DISCARD; }
API int fmi2GetBooleanStatus(Slave *c, int kind, int *value) { (void)c, (void)kind; *value = 0; return OK; }
API int fmi2GetStringStatus(Slave *c, int kind, const char **value) { (void)c, (void)kind, (void)value; return DISCARD; }

#else

typedef void (*LogMessage)(void *, int, const char *, const char *);

static void tell3(Slave *c, int status, const char *category, const char *text) {
    ((LogMessage)c->callback)(c->environment, status, category, text);
}

API const char *fmi3GetVersion(void) { return "3.0"; }
API int fmi3SetDebugLogging(Slave *c, _Bool on, size_t n, const char *const category[]) {
    (void)n, (void)category;
    c->logging = on;
    return OK;
}
API Slave *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, _Bool visible,
                                       _Bool logging, _Bool events, _Bool early, const unsigned required[], size_t n,
                                       void *environment, LogMessage log, void *intermediate) {
    (void)resources, (void)visible, (void)events, (void)early, (void)required, (void)n, (void)intermediate;
    Slave *c = name ? new_slave(name, token, logging) : NULL;
    if (c) {
        c->environment = environment;
        c->callback = (void *)log;
        c->log = log ? tell3 : NULL;
    }
    return c;
}
API void *fmi3InstantiateModelExchange(void) { return NULL; }
API void *fmi3InstantiateScheduledExecution(void) { return NULL; }
API void fmi3FreeInstance(Slave *c) { free_slave(c); }
API int fmi3EnterInitializationMode(Slave *c, _Bool tolerance, double value, double begins, _Bool ends, double stop) {
    (void)tolerance, (void)value, (void)ends, (void)stop;
    start(c, begins);
    return OK;
}
API int fmi3ExitInitializationMode(Slave *c) { (void)c; return OK; }
API int fmi3EnterStepMode(Slave *c) { (void)c; return OK; }
API int fmi3Terminate(Slave *c) { (void)c; return OK; }
API int fmi3Reset(Slave *c) { begin(c); return OK; }
API int fmi3GetFloat64(Slave *c, const unsigned *r, size_t n, double *v, size_t nv) { return nv == n ? get(c, r, n, v) : FAILED; }
API int fmi3SetFloat64(Slave *c, const unsigned *r, size_t n, const double *v, size_t nv) { return nv == n ? set(c, r, n, v) : FAILED; }
API int fmi3GetFMUState(Slave *c, void **kept) { return take(c, kept); }
API int fmi3SetFMUState(Slave *c, void *kept) { return give(c, kept); }
API int fmi3FreeFMUState(Slave *c, void **kept) { (void)c; free(*kept); *kept = NULL; return OK; }
API int fmi3SerializedFMUStateSize(Slave *c, void *kept, size_t *size) { (void)c, (void)kept; *size = sizeof(State); return OK; }
API int fmi3SerializeFMUState(Slave *c, void *kept, unsigned char bytes[], size_t size) {
    if (size < sizeof(State)) return complain(c, FAILED, "too few bytes for a state");
    memcpy(bytes, kept, sizeof(State));
    return OK;
}
API int fmi3DeserializeFMUState(Slave *c, const unsigned char bytes[], size_t size, void **kept) {
    if (size != sizeof(State)) return complain(c, FAILED, "a state of another size");
    if (!*kept && !(*kept = malloc(sizeof(State)))) return FAILED;
    memcpy(*kept, bytes, sizeof(State));
    return OK;
}
API int fmi3DoStep(Slave *c, double time, double duration, _Bool final, _Bool *event, _Bool *terminate, _Bool *early,
                   double *last) {
    (void)final;
    int status = step(c, time, duration);
    *event = *terminate = *early = 0;
    *last = c->state.time;
    return status;
}
/* What a slave of this kind does not have; the standard wants the functions to be there. */
#define NONE3(NAME) API int fmi3##NAME(void) { return FAILED; }
NONE3(GetFloat32) NONE3(GetInt8) NONE3(GetUInt8) NONE3(GetInt16) NONE3(GetUInt16) NONE3(GetInt32) NONE3(GetUInt32)
NONE3(GetInt64) NONE3(GetUInt64) NONE3(GetBoolean) NONE3(GetString) NONE3(GetBinary) NONE3(GetClock)
NONE3(SetFloat32) NONE3(SetInt8) NONE3(SetUInt8) NONE3(SetInt16) NONE3(SetUInt16) NONE3(SetInt32) NONE3(SetUInt32)
NONE3(SetInt64) NONE3(SetUInt64) NONE3(SetBoolean) NONE3(SetString) NONE3(SetBinary) NONE3(SetClock)
NONE3(GetNumberOfVariableDependencies) NONE3(GetVariableDependencies) NONE3(GetDirectionalDerivative)
NONE3(GetAdjointDerivative) NONE3(EnterConfigurationMode) NONE3(ExitConfigurationMode) NONE3(GetIntervalDecimal)
NONE3(GetIntervalFraction) NONE3(GetShiftDecimal) NONE3(GetShiftFraction) NONE3(SetIntervalDecimal)
NONE3(SetIntervalFraction) NONE3(SetShiftDecimal) NONE3(SetShiftFraction) NONE3(EvaluateDiscreteStates)
NONE3(UpdateDiscreteStates) NONE3(EnterEventMode) NONE3(EnterContinuousTimeMode) NONE3(CompletedIntegratorStep)
NONE3(SetTime) NONE3(SetContinuousStates) NONE3(GetContinuousStateDerivatives) NONE3(GetEventIndicators)
NONE3(GetContinuousStates) NONE3(GetNominalsOfContinuousStates) NONE3(GetNumberOfEventIndicators)
NONE3(GetNumberOfContinuousStates) NONE3(GetOutputDerivatives) NONE3(ActivateModelPartition)

#endif
