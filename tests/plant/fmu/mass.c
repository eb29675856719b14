/* An FMU for the tests: a carriage on a lead screw, turned by a torque, and a spring that follows a speed.
 * Compiled with FMI=2 or FMI=3. The parameter `failure` makes it fail at `failure_at_s`: 1 it crashes, 2 it hangs,
 * 3 its step ends with an error, 4 it only says something. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { TIME, TORQUE, ANGLE, RATE, INERTIA, COULOMB, FAILURE, FAILURE_AT, TRAVEL_MM, SPEED, PULL, STIFFNESS, WINDUP, STEPS, COUNT };
enum { OK, WARNING, DISCARD, FAILED };
/* Nobody calls them; a slave has them all the same. */
#define NONE(NAME) int NAME(void) { return FAILED; }
typedef struct { double v[COUNT]; } State;
typedef struct { State state; void *callback, *environment; double fails; } Slave;

static void begin(Slave *c) {
    memset(&c->state, 0, sizeof c->state);
    c->state.v[INERTIA] = 0.01;
    c->state.v[STIFFNESS] = 2.0;
    c->state.v[FAILURE] = c->fails;
    c->state.v[FAILURE_AT] = 0.3;
}

/* Which failure it begins with, after 0.3 s, says its token. */
static void begin_with(Slave *c, const char *token) {
    begin(c);
    c->fails = c->state.v[FAILURE] = atof(token + 6); /* "{mass 2}" */
}

static void refresh(double *v) {
    v[TRAVEL_MM] = v[ANGLE] * 10.0 / (2.0 * 3.14159265358979323846); /* a lead of 10 mm */
    v[PULL] = -v[STIFFNESS] * v[WINDUP];
}

static void tell(Slave *c, int status, const char *text) {
#if FMI == 2
    typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
    ((Log)*(void **)c->callback)(NULL, "mass", status, "log", "%s", text);
#else
    ((void (*)(void *, int, const char *, const char *))c->callback)(c->environment, status, "log", text);
#endif
}

static int step(Slave *c, double time, double h) {
    double *v = c->state.v;
    if (v[FAILURE] > 0.0 && time + h > v[FAILURE_AT]) {
        if (v[FAILURE] == 1.0) *(volatile int *)NULL = 0;
        while (v[FAILURE] == 2.0) sleep(1);
        tell(c, v[FAILURE] == 3.0 ? FAILED : WARNING, "the screw is jammed");
        if (v[FAILURE] == 3.0) return FAILED;
        v[FAILURE] = 0.0;
    }
    double torque = v[TORQUE] - v[COULOMB] * tanh(v[RATE] / 0.01);
    double rate = v[RATE] + h * torque / v[INERTIA];
    v[ANGLE] += 0.5 * h * (v[RATE] + rate);
    v[RATE] = rate;
    v[WINDUP] += h * v[SPEED];
    v[TIME] = time + h;
    v[STEPS] += 1.0;
    return OK;
}

static int get(Slave *c, const unsigned *r, size_t n, double *value) {
    refresh(c->state.v);
    for (size_t i = 0; i < n; i++) value[i] = c->state.v[r[i]];
    return OK;
}
static int set(Slave *c, const unsigned *r, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++) c->state.v[r[i]] = value[i];
    return OK;
}
static int take(Slave *c, void **kept) {
    if (!*kept) *kept = malloc(sizeof(State));
    memcpy(*kept, &c->state, sizeof(State));
    return OK;
}
static int give(Slave *c, void *kept) { memcpy(&c->state, kept, sizeof(State)); return OK; }

#if FMI == 2
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
Slave *fmi2Instantiate(const char *name, int kind, const char *token, const char *folder, void *callbacks, int a, int b) {
    Slave *c = calloc(1, sizeof *c);
    c->callback = callbacks;
    begin_with(c, token);
    return c;
}
void fmi2FreeInstance(Slave *c) { free(c); }
int fmi2SetupExperiment(Slave *c, int a, double b, double time, int d, double e) { c->state.v[TIME] = time; return OK; }
int fmi2EnterInitializationMode(Slave *c) { return OK; }
int fmi2ExitInitializationMode(Slave *c) { return OK; }
int fmi2Terminate(Slave *c) { return OK; }
int fmi2Reset(Slave *c) {
    if (c->fails == 5.0) return FAILED; /* this one can't */
    begin(c);
    return OK;
}
int fmi2GetReal(Slave *c, const unsigned *r, size_t n, double *v) { return get(c, r, n, v); }
int fmi2SetReal(Slave *c, const unsigned *r, size_t n, const double *v) { return set(c, r, n, v); }
int fmi2GetFMUstate(Slave *c, void **kept) { return take(c, kept); }
int fmi2SetFMUstate(Slave *c, void *kept) { return give(c, kept); }
int fmi2FreeFMUstate(Slave *c, void **kept) { free(*kept); *kept = NULL; return OK; }
int fmi2DoStep(Slave *c, double time, double h, int final) { return step(c, time, h); }
NONE(fmi2SetDebugLogging) NONE(fmi2GetInteger) NONE(fmi2GetBoolean) NONE(fmi2GetString) NONE(fmi2SetInteger)
NONE(fmi2SetBoolean) NONE(fmi2SetString) NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate)
NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative) NONE(fmi2SetRealInputDerivatives)
NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep) NONE(fmi2GetStatus) NONE(fmi2GetRealStatus)
NONE(fmi2GetIntegerStatus) NONE(fmi2GetBooleanStatus) NONE(fmi2GetStringStatus)
#else
const char *fmi3GetVersion(void) { return "3.0"; }
Slave *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *folder, _Bool a, _Bool b, _Bool d,
                                   _Bool e, const unsigned r[], size_t n, void *environment, void *log, void *update) {
    Slave *c = calloc(1, sizeof *c);
    c->callback = log;
    c->environment = environment;
    begin_with(c, token);
    return c;
}
void fmi3FreeInstance(Slave *c) { free(c); }
int fmi3EnterInitializationMode(Slave *c, _Bool a, double b, double time, _Bool d, double e) { c->state.v[TIME] = time; return OK; }
int fmi3ExitInitializationMode(Slave *c) { return OK; }
int fmi3Terminate(Slave *c) { return OK; }
int fmi3Reset(Slave *c) { begin(c); return OK; }
int fmi3GetFloat64(Slave *c, const unsigned *r, size_t n, double *v, size_t nv) { return get(c, r, n, v); }
int fmi3SetFloat64(Slave *c, const unsigned *r, size_t n, const double *v, size_t nv) { return set(c, r, n, v); }
int fmi3GetFMUState(Slave *c, void **kept) { return take(c, kept); }
int fmi3SetFMUState(Slave *c, void *kept) { return give(c, kept); }
int fmi3FreeFMUState(Slave *c, void **kept) { free(*kept); *kept = NULL; return OK; }
int fmi3DoStep(Slave *c, double time, double h, _Bool final, _Bool *a, _Bool *b, _Bool *d, double *last) {
    *a = *b = *d = 0;
    *last = time + h;
    return step(c, time, h);
}
NONE(fmi3GetFloat32) NONE(fmi3GetInt8) NONE(fmi3GetUInt8) NONE(fmi3GetInt16) NONE(fmi3GetUInt16) NONE(fmi3GetInt32)
NONE(fmi3GetUInt32) NONE(fmi3GetInt64) NONE(fmi3GetUInt64) NONE(fmi3GetBoolean) NONE(fmi3GetString)
NONE(fmi3GetBinary) NONE(fmi3GetClock) NONE(fmi3SetFloat32) NONE(fmi3SetInt8) NONE(fmi3SetUInt8) NONE(fmi3SetInt16)
NONE(fmi3SetUInt16) NONE(fmi3SetInt32) NONE(fmi3SetUInt32) NONE(fmi3SetInt64) NONE(fmi3SetUInt64)
NONE(fmi3SetBoolean) NONE(fmi3SetString) NONE(fmi3SetBinary) NONE(fmi3SetClock)
NONE(fmi3GetNumberOfVariableDependencies) NONE(fmi3GetVariableDependencies) NONE(fmi3GetDirectionalDerivative)
NONE(fmi3GetAdjointDerivative) NONE(fmi3EnterConfigurationMode) NONE(fmi3ExitConfigurationMode)
NONE(fmi3GetIntervalDecimal) NONE(fmi3GetIntervalFraction) NONE(fmi3GetShiftDecimal) NONE(fmi3GetShiftFraction)
NONE(fmi3SetIntervalDecimal) NONE(fmi3SetIntervalFraction) NONE(fmi3SetShiftDecimal) NONE(fmi3SetShiftFraction)
NONE(fmi3EvaluateDiscreteStates) NONE(fmi3UpdateDiscreteStates) NONE(fmi3EnterEventMode)
NONE(fmi3EnterContinuousTimeMode) NONE(fmi3CompletedIntegratorStep) NONE(fmi3SetTime) NONE(fmi3SetContinuousStates)
NONE(fmi3GetContinuousStateDerivatives) NONE(fmi3GetEventIndicators) NONE(fmi3GetContinuousStates)
NONE(fmi3GetNominalsOfContinuousStates) NONE(fmi3GetNumberOfEventIndicators) NONE(fmi3GetNumberOfContinuousStates)
NONE(fmi3GetOutputDerivatives) NONE(fmi3ActivateModelPartition) NONE(fmi3SetDebugLogging)
NONE(fmi3InstantiateModelExchange) NONE(fmi3InstantiateScheduledExecution) NONE(fmi3EnterStepMode)
NONE(fmi3SerializedFMUStateSize) NONE(fmi3SerializeFMUState) NONE(fmi3DeserializeFMUState)
#endif
