/* A carriage on a servo axis with a loose load in it: the load slides with friction, and bounces between two walls.
 * All quantities at the motor's shaft. FMI 2, co-simulation, steps of any length: impacts are events within a step.
 *
 *     J·ω' = τ - b·ω - c·sign(ω) - s        s = f·sign(ω - u)        φ' = ω
 *     K·u' = s                              |ψ - φ| ≤ g              ψ' = u
 *
 * At a wall momentum is kept, and the relative speed turns round times the coefficient of restitution. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { TIME, TORQUE, ANGLE, RATE, LOAD, BOUNCES, INERTIA, COULOMB, VISCOUS, LOAD_INERTIA, LOAD_FRICTION, GAP, BOUNCE,
       LOAD_ANGLE, LOAD_RATE, COUNT };
enum { OK, FAILED = 3 };
typedef struct { double v[COUNT]; } Slave;

static const double AT_REST = 1e-3, SIGN = 0.05; /* rad/s: no bounce below; width of sign() */

static void begin(Slave *c) {
    memset(c, 0, sizeof *c);
    c->v[INERTIA] = 0.0395;
    c->v[COULOMB] = 0.05;
    c->v[VISCOUS] = 0.004;
    c->v[LOAD_INERTIA] = 0.0008;
    c->v[LOAD_FRICTION] = 0.02;
    c->v[GAP] = 2.0;
    c->v[BOUNCE] = 0.5;
}

/* When the load gets to wall k (1 or -1), within h; h + 1: not. */
static double impact(double k, double r, double w, double a, double g, double h) {
    double distance = g - k * r, speed = k * w, push = k * a;
    if (distance <= 0.0) return speed > AT_REST ? 0.0 : h + 1.0;
    double root = speed * speed + 2.0 * push * distance;
    double t = root < 0.0 || speed + sqrt(root) <= 0.0 ? h + 1.0 : 2.0 * distance / (speed + sqrt(root));
    return t <= h ? t : h + 1.0;
}

static void collide(double *v) {
    double whole = v[INERTIA] + v[LOAD_INERTIA], w = v[LOAD_RATE] - v[RATE];
    double common = (v[INERTIA] * v[RATE] + v[LOAD_INERTIA] * v[LOAD_RATE]) / whole;
    double left = fabs(w) < 100.0 * AT_REST ? 0.0 : v[BOUNCE] * w;
    v[RATE] = common + v[LOAD_INERTIA] / whole * left;
    v[LOAD_RATE] = common - v[INERTIA] / whole * left;
    v[BOUNCES] += left != 0.0;
}

static void advance(double *v, double h) {
    for (int events = 0; h > 0.0 && events < 1000; events++) {
        double r = v[LOAD_ANGLE] - v[ANGLE], w = v[LOAD_RATE] - v[RATE], g = v[GAP];
        double s = v[LOAD_FRICTION] * tanh(-w / SIGN);
        double box = v[TORQUE] - v[VISCOUS] * v[RATE] - v[COULOMB] * tanh(v[RATE] / SIGN) - s;
        double a = s / v[LOAD_INERTIA], b = box / v[INERTIA];
        double wall = r >= g ? 1.0 : r <= -g ? -1.0 : 0.0;
        if (wall * (a - b) > 0.0 && fabs(w) <= AT_REST) { /* the wall pushes it along */
            a = b = (box + s) / (v[INERTIA] + v[LOAD_INERTIA]);
            v[LOAD_RATE] = v[RATE];
            w = 0.0;
        }
        double up = impact(1.0, r, w, a - b, g, h), down = impact(-1.0, r, w, a - b, g, h);
        double t = fmin(h, fmin(up, down));
        v[ANGLE] += t * (v[RATE] + 0.5 * b * t);
        v[LOAD_ANGLE] += t * (v[LOAD_RATE] + 0.5 * a * t);
        v[RATE] += b * t;
        v[LOAD_RATE] += a * t;
        if (up <= h || down <= h) {
            v[LOAD_ANGLE] = v[ANGLE] + (up <= down ? g : -g);
            collide(v);
        }
        h -= t;
    }
    v[LOAD] = v[LOAD_ANGLE] - v[ANGLE];
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
Slave *fmi2Instantiate(const char *name, int kind, const char *guid, const char *folder, void *callbacks, int a, int b) {
    Slave *c = malloc(sizeof *c);
    if (c) begin(c);
    return c;
}
void fmi2FreeInstance(Slave *c) { free(c); }
int fmi2SetupExperiment(Slave *c, int a, double b, double time, int d, double e) { c->v[TIME] = time; return OK; }
int fmi2EnterInitializationMode(Slave *c) { return OK; }
int fmi2ExitInitializationMode(Slave *c) { return OK; }
int fmi2Terminate(Slave *c) { return OK; }
int fmi2Reset(Slave *c) { begin(c); return OK; }
int fmi2GetReal(Slave *c, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) v[i] = c->v[r[i]];
    return OK;
}
int fmi2SetReal(Slave *c, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) c->v[r[i]] = v[i];
    return OK;
}
int fmi2GetFMUstate(Slave *c, void **kept) {
    if (!*kept) *kept = malloc(sizeof *c);
    return *kept ? (memcpy(*kept, c, sizeof *c), OK) : FAILED;
}
int fmi2SetFMUstate(Slave *c, void *kept) { memcpy(c, kept, sizeof *c); return OK; }
int fmi2FreeFMUstate(Slave *c, void **kept) { free(*kept); *kept = NULL; return OK; }
int fmi2DoStep(Slave *c, double time, double h, int final) {
    advance(c->v, h);
    c->v[TIME] = time + h;
    return OK;
}

/* A slave has them all; nobody calls these of this one. */
#define NONE(NAME) int NAME(void) { return FAILED; }
NONE(fmi2SetDebugLogging) NONE(fmi2GetInteger) NONE(fmi2GetBoolean) NONE(fmi2GetString) NONE(fmi2SetInteger)
NONE(fmi2SetBoolean) NONE(fmi2SetString) NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate)
NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetDirectionalDerivative) NONE(fmi2SetRealInputDerivatives)
NONE(fmi2GetRealOutputDerivatives) NONE(fmi2CancelStep) NONE(fmi2GetStatus) NONE(fmi2GetRealStatus)
NONE(fmi2GetIntegerStatus) NONE(fmi2GetBooleanStatus) NONE(fmi2GetStringStatus)
