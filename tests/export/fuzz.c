/* Random legal and illegal FMI calls on one FMU, linked in, against a model of the standards' state machines.

   fuzz TOKEN SAMPLED FIRST COUNT: sequences of calls with the seeds FIRST, FIRST + 1, ... Whatever goes wrong, a sanitizer's
   finding included, is told with the seed and all calls of that sequence; `fuzz TOKEN SAMPLED SEED 1` makes them again.
   Laws, of every call:
   - in a state that does not permit it: Error, a message with its name and the state (or what the FMU has not);
   - permitted, with good arguments, on an instance that was given sensible values: OK;
   - with bad arguments: Error or Discard, a message with that status, which names the variable where a value is at fault;
   - not OK, or only reading: the saved state is as it was, and so is everything that can be read;
   - whatever it does: no other instance notices, and the state that is then saved can be read back from its bytes;
   - after any of it: a good step from good inputs is made. */
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <sanitizer/common_interface_defs.h>
#include <sanitizer/lsan_interface.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

/* Of the runtime only: names for the states, the table of the block's variables, and where a saved state keeps what. */
#include "instance.h"

/* Which calls a state permits is written in letters: i instantiated, n initialization, s step, e event, c continuous-time,
   u intermediate update, t terminated. */
static const struct {
    char letter;
    State state;
    const char *name;
} states[] = {{'i', INSTANTIATED, "instantiated"}, {'n', INITIALIZATION, "initialization mode"}, {'s', STEP, "step mode"},
              {'e', EVENT, "event mode"},          {'c', CONTINUOUS, "continuous-time mode"},
              {'u', INTERMEDIATE, "intermediate update mode"}, {'t', TERMINATED, "terminated"}};

/* Where this FMU knowingly does other than the standards (FMI 2.0.5, 3.0.2). `call` with a * stands for all that begin so; a
   row without states is about arguments or about what a state is. Each must be met, or it is no deviation any more. */
static struct {
    const char *call, *cs, *me; /* the states in question, of a co-simulation and of a model exchange instance */
    enum { REFUSED, MADE, MADE_IF_EMPTY } instead;
    const char *clause;
    long met;
} deviations[] = {
    {"fmi2SetTime", "", "e", MADE, "2.0: 3.2.3 table, condition 8: in event mode for purely discrete FMUs only", 0},
    {"fmi2SetReal", "t", "t", MADE_IF_EMPTY, "2.0: 3.2.3, 4.2.4 tables: no setting; without references nothing is set", 0},
    {"fmi2SetInteger", "t", "ct", MADE_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetBoolean", "t", "ct", MADE_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetString", "t", "ct", MADE_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetRealInputDerivatives", "", "in", MADE_IF_EMPTY, "2.0: 4.2.4 table: co-simulation only", 0},
    {"fmi2GetRealOutputDerivatives", "", "t", MADE_IF_EMPTY, "2.0: 4.2.4 table: co-simulation only", 0},
    {"fmi2GetStatus", "", "t", MADE, "2.0: 4.2.4 table: co-simulation only (and the other four)", 0},
    {"fmi2GetRealStatus", "", "t", MADE, "as fmi2GetStatus", 0},
    {"fmi2GetIntegerStatus", "", "t", MADE, "as fmi2GetStatus", 0},
    {"fmi2GetBooleanStatus", "", "t", MADE, "as fmi2GetStatus", 0},
    {"fmi2GetStringStatus", "", "t", MADE, "as fmi2GetStatus", 0},
    {"fmi3GetFloat64", "i", "i", REFUSED, "3.0: 2.3.2 table of equations: start values may be read (not in its list of calls)", 0},
    {"fmi3GetInt64", "i", "i", REFUSED, "as fmi3GetFloat64", 0},
    {"fmi3GetBoolean", "i", "i", REFUSED, "as fmi3GetFloat64", 0},
    {"fmi3Set*", "t", "t", MADE_IF_EMPTY, "3.0: 2.3.8: no setting; without references nothing is set", 0},
    {"fmi3EvaluateDiscreteStates", "n", "ne", MADE, "3.0: 2.3.5: in event mode, if providesEvaluateDiscreteStates", 0},
    {"fmi3FreeFMUState", "u", "", MADE, "3.0: 4.2.2: values only, during an intermediate update", 0},
    {"fmi3GetNumberOfEventIndicators", "", "nct", MADE, "3.0: 2.3.2, 2.3.5: when instantiated and in event mode", 0},
    {"fmi3GetNumberOfContinuousStates", "", "nct", MADE, "as fmi3GetNumberOfEventIndicators", 0},
    {"fmi3GetOutputDerivatives", "", "t", MADE_IF_EMPTY, "3.0: 2.3.8: not in model exchange", 0},
    {"clock functions", "insut", "inect", MADE_IF_EMPTY, "3.0: 2.3.3, 2.3.5: clocks in some states only; without references nothing is done", 0},
    {"no error state", "", "", MADE, "2.0: 2.1.3, 3.2.3, 4.2.4; 3.0: 2.2.3, 2.3.1: after an Error only reading, restoring, resetting and freeing", 0},
    {"no set-up", "", "", MADE, "2.0: 2.1.6: fmi2SetupExperiment before fmi2EnterInitializationMode", 0},
    {"reading after setting", "", "", MADE, "2.0: 4.2.4, 3.0: 4.2.1: a step between setting and getting in co-simulation", 0},
    {"any variable", "", "", MADE, "2.0: 3.2.3, 4.2.4, condition 2: in initialization mode outputs and initial unknowns only", 0},
    {"any intermediate variable", "", "", MADE, "3.0: 4.2.2: those named at instantiation only, no reading after setting", 0},
    {"state set one by one", "", "", REFUSED, "2.0: 3.2.3, condition 5; 3.0: 2.3.5, 3.2.1: a state by fmiXSetReal/Float64 after initialization", 0},
    {"step of no size", "", "", MADE, "2.0: 4.2.2, 3.0: 4.2.1: a step's size is above 0", 0},
    {"time goes back", "", "", MADE, "2.0: 3.2.1, 3.0: 3.2.1: not before the start, the last event or the second last completed step", 0},
    {"any known", "", "", MADE, "2.0: 2.1.9, 3.0: 2.2.11: derivatives by and of what a state's equations have only", 0},
    {"blank name", "", "", MADE, "2.0: 2.1.5, 3.0: 2.3.1: an instance's name is not empty", 0},
    {"told all the same", "", "", MADE, "2.0: 2.1.5, 3.0: 2.3.1: no messages if logging is off, or of a category that is", 0},
    {"status without a word", "", "", MADE, "3.0: 2.3.1, 2.0: 2.1.3: what is not OK is told (fmi2GetXxxStatus is not)", 0},
    {"another instance's state", "", "", MADE, "2.0: 2.1.8, 3.0: 2.2.4: a saved state is one of this instance", 0},
};

#define LATEST 2e9 /* s; no time beyond it */
#define RUN 1000.0 /* s; where a stop time is given */

typedef struct {
    State state;
    double start, time;  /* as the importer knows them */
    long samples;        /* taken by a sampled block */
    int set_up, failed, written; /* for the deviations */
    int wild_inputs, wild; /* inputs; parameters, states or times: were given senseless values, so that a refusal is no surprise */
} Model;

typedef struct {
    void *c;
    int version, model_exchange, mute, silent, early, callback;
    Model m;
    double begin, end, seen; /* the step that is being made, and the intermediate updates so far */
    int inner_sets, asked;
    void *before;            /* a saved state, only to compare */
    unsigned char *bytes;
} Slot;

static Slot slots[3];
static int slot_count;
static struct {
    void *state;
    Model m;
    Slot *from;
    int model_exchange;
} stash[4];
static struct {
    unsigned char *bytes;
    Model m;
    int model_exchange;
} written;
static size_t memory_size;
static const char *token;
static int sampled, rough, forced;

/* What the call under way was given: what must come of it. */
typedef struct {
    enum { GOOD, BAD, LACKED, OPEN, UNSAID } given; /* UNSAID: Discard or Error without a message */
    int empty;
    char named[200]; /* what the message must contain */
    Model after;
} Want;

typedef struct {
    int count, status;
    char text[512];
} Said;

static Want want;
static Said said;

/* Telling */

static char trace[1 << 17];
static size_t traced;
static unsigned long long seed, calls, refused;

static void note(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int n = vsnprintf(trace + traced, sizeof trace - traced, format, arguments);
    va_end(arguments);
    if (n > 0 && traced + (size_t)n < sizeof trace)
        traced += (size_t)n;
}

static void tell(void) { fprintf(stderr, "\nthe sequence with seed %llu:\n%s\n", seed, trace); }

/* The undefined-behaviour sanitizer ends with a signal, the address sanitizer with its own call. */
const char *__ubsan_default_options(void);
const char *__ubsan_default_options(void) { return "abort_on_error=1:print_stacktrace=1"; }

static void aborted(int signal)
{
    (void)signal;
    tell();
    _Exit(1);
}

static void fail(const char *format, ...)
{
    va_list arguments;
    tell();
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fprintf(stderr, "\nlast message: %s\n", said.text);
    _Exit(1);
}

#define LAW(condition, ...)    \
    do {                       \
        if (!(condition))      \
            fail(__VA_ARGS__); \
    } while (0)

static int deviates(const char *call)
{
    for (size_t i = 0; i < sizeof deviations / sizeof *deviations; i++)
        if (!strcmp(deviations[i].call, call))
            return (int)++deviations[i].met;
    fail("no deviation %s", call);
    return 0;
}

static void hear(Slot *s, int status, const char *category, const char *text)
{
    said.count++;
    said.status = status;
    snprintf(said.text, sizeof said.text, "%s", text);
    LAW(category && (!strcmp(category, "logStatusError") || !strcmp(category, "logRequirement")), "category %s", category);
    LAW(strlen(text) > 10, "an empty message");
    for (const char *p = text; *p; p++)
        LAW(*p >= ' ' && *p <= '~', "a message that cannot be read: %s", text);
    for (const char *e = strchr(text, 'e'); e; e = strchr(e + 1, 'e'))
        LAW(!((e[1] == '-' || e[1] == '+') && e[2] >= '0' && e[2] <= '9') || (e > text && e[-1] >= '0' && e[-1] <= '9'), "a number that cannot be read: %s", text);
    if (s && s->silent)
        deviates("told all the same");
}

static void hear2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    LAW(name, "a message without the instance's name");
    hear(e, (int)status, category, text);
}

static void hear3(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String text) { hear(e, (int)status, category, text); }

/* Chance */

static uint64_t chance;

static unsigned below(unsigned n) /* splitmix64 */
{
    uint64_t z = (chance += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return (unsigned)((z ^ (z >> 31)) >> 32) % n;
}

static int once_in(unsigned n) { return !forced && below(n) == 0; }

static double wild_number(void)
{
    static const double numbers[] = {1e308, -1e308, 5e-324, -1e-310, 1e200, -1e20, 0, -0.0, 1e-13, 3, -7, 4e9, 1e160, 0.5};
    return numbers[below(sizeof numbers / sizeof *numbers)];
}

static double not_finite(void) { return below(3) == 0 ? NAN : below(2) ? INFINITY : -INFINITY; }

/* The model */

static int letter(State state)
{
    for (size_t i = 0; i < sizeof states / sizeof *states; i++)
        if (states[i].state == state)
            return states[i].letter;
    fail("there is no state %d", (int)state);
    return 0;
}

static int is_in(State state, const char *letters) { return strchr(letters, letter(state)) != NULL; }

static int within(unsigned r, Range range) { return (int)r >= range.first && (int)r < range.first + range.count; }

static int doubtful(const Slot *s) { return s->m.wild || s->m.wild_inputs; }

/* The standards' conditions on what may be set where. */
static int settable(const Slot *s, unsigned r)
{
    int access = block.value[r].access, c = letter(s->m.state);
    if (access == START && (c == 'c' || (c == 'e' && s->version == 3)) && !deviates("state set one by one"))
        return 1;
    return access == READ_ONLY ? 0 : c == 'i' || c == 'n' ? 1 : c == 's' || c == 'e' ? access == INPUT || access == TUNABLE : (c == 'c' || c == 'u') && access == INPUT;
}

static void want_bad(const char *name)
{
    if (want.given == GOOD || want.given == OPEN) {
        want.given = BAD;
        snprintf(want.named, sizeof want.named, "%s", name);
    }
}

static double good_value(unsigned r)
{
    double start = block.start[r];
    return block.value[r].access == INPUT ? start + 1e-4 * ((double)below(2001) / 1000 - 1) : start;
}

static double period(void) { return block.start[block.period]; }

/* The end of the longest step from here that passes over no sample. */
static double limit(const Model *m)
{
    int due = m->time >= m->start + (double)m->samples * period() - 1e-9;
    return m->start + (double)(m->samples + due) * period();
}

/* Pointers into the interface, by version. */

static int get_state(Slot *s, void **state) { return s->version == 2 ? (int)fmi2GetFMUstate(s->c, state) : (int)fmi3GetFMUState(s->c, state); }

static int free_state(Slot *s, void **state) { return s->version == 2 ? (int)fmi2FreeFMUstate(s->c, state) : (int)fmi3FreeFMUState(s->c, state); }

static void snapshot(Slot *s, unsigned char *bytes)
{
    int ok = get_state(s, &s->before) == 0
             && (s->version == 2 ? (int)fmi2SerializeFMUstate(s->c, s->before, (char *)bytes, memory_size) : (int)fmi3SerializeFMUState(s->c, s->before, bytes, memory_size)) == 0;
    LAW(ok, "the state cannot be saved");
}

/* Whether two saved states are the same but for what is only kept to save a computation. `inputs`: the importer set them. */
static int same(const Slot *s, const unsigned char *a, const unsigned char *b, int inputs)
{
    const size_t values = offsetof(Memory, value);
    Memory x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    if (x.identity != y.identity || x.state != y.state || x.start != y.start || x.time != y.time || x.next_sample != y.next_sample || memcmp(&x.clock, &y.clock, sizeof x.clock))
        return 0;
    for (unsigned r = 1; r < (unsigned)(block.values + block.states.count); r++) {
        int held = sampled && !is_in(s->m.state, "in"); /* outputs are a sampled block's memory between samples */
        int computed = within(r, block.derivatives) || (within(r, block.outputs) && !held);
        if (!computed && !(inputs && within(r, block.inputs)) && memcmp(a + values + r * sizeof(double), b + values + r * sizeof(double), sizeof(double)))
            return 0;
    }
    return 1;
}

/* Everything that can be read, read one by one; NaN where it cannot. */
static void read_all(Slot *s, double *value)
{
    for (int r = 0; r < block.values; r++)
        value[r] = NAN;
    for (unsigned r = 0; r < (unsigned)block.values; r++) {
        int kind = block.value[r].kind, extent = block.value[r].extent, number = 0, status = 1;
        fmi3Int64 whole = 0;
        fmi3Boolean flag = 0;
        if (s->version == 2 && kind == REAL)
            status = (int)fmi2GetReal(s->c, &r, 1, &value[r]);
        else if (s->version == 2)
            status = (int)(kind == BOOLEAN ? fmi2GetBoolean(s->c, &r, 1, &number) : fmi2GetInteger(s->c, &r, 1, &number));
        else if (extent > 0 && kind == REAL)
            status = (int)fmi3GetFloat64(s->c, &r, 1, &value[r], (size_t)extent);
        else if (extent > 0)
            status = (int)(kind == BOOLEAN ? fmi3GetBoolean(s->c, &r, 1, &flag, 1) : fmi3GetInt64(s->c, &r, 1, &whole, 1));
        if (kind != REAL)
            value[r] = number + (double)whole + flag;
        LAW(status == 0 || doubtful(s) || (s->version == 3 && extent == 0), "%s cannot be read", block.value[r].name);
        if (s->version == 3 && extent > 1)
            r += (unsigned)extent - 1;
    }
}

/* Values */

/* One function of the interface: n values at nr references, got or set. Its arrays are as long as it was told. */
typedef int Transfer(void *c, const unsigned *r, size_t nr, double *v, size_t n);

#define TRANSFER(Function, Type, ...)                                              \
    static int transfer_##Function(void *c, const unsigned *r, size_t nr, double *v, size_t n) \
    {                                                                              \
        Type *x = v ? malloc(n * sizeof *x) : NULL;                                \
        for (size_t i = 0; v && i < n; i++)                                        \
            x[i] = (Type)v[i];                                                     \
        (void)n;                                                                   \
        int status = (int)Function(c, r, nr, __VA_ARGS__);                         \
        for (size_t i = 0; v && i < n && status == 0; i++)                         \
            v[i] = (double)x[i];                                                   \
        free(x);                                                                   \
        return status;                                                             \
    }
TRANSFER(fmi2GetReal, double, x)
TRANSFER(fmi2SetReal, double, x)
TRANSFER(fmi2GetInteger, int, x)
TRANSFER(fmi2SetInteger, int, x)
TRANSFER(fmi2GetBoolean, int, x)
TRANSFER(fmi2SetBoolean, int, x)
TRANSFER(fmi3GetFloat64, double, x, n)
TRANSFER(fmi3SetFloat64, double, x, n)
TRANSFER(fmi3GetInt64, fmi3Int64, x, n)
TRANSFER(fmi3SetInt64, fmi3Int64, x, n)
TRANSFER(fmi3GetBoolean, fmi3Boolean, x, n)
TRANSFER(fmi3SetBoolean, fmi3Boolean, x, n)

static int elements(const Slot *s, unsigned r) { return r >= (unsigned)block.values ? 0 : s->version == 2 ? 1 : block.value[r].extent; }

/* A reference; mostly one of this kind that `fits`. */
static unsigned reference(const Slot *s, int kind, int (*fits)(const Slot *, unsigned))
{
    for (int i = 0; i < 60 && !once_in(40); i++) {
        unsigned r = below((unsigned)block.values);
        if (elements(s, r) && block.value[r].kind == kind && (!fits || fits(s, r)))
            return r;
    }
    return forced ? 0 : below(3) ? below((unsigned)block.values + 3) : below(2) ? UINT32_MAX : 100000;
}

static int open_to_set(const Slot *s, unsigned r) { return block.value[r].access == INPUT || (!is_in(s->m.state, "suect") && block.value[r].access != READ_ONLY); }

static int values(Slot *s, Transfer *transfer, int kind, int set)
{
    unsigned r[6] = {0}, nr = below(5);
    double v[1200];
    size_t n = 0;
    int wrong = 0;
    for (unsigned i = 0; i < nr; i++) {
        r[i] = reference(s, kind, set ? open_to_set : NULL);
        wrong |= elements(s, r[i]) == 0 || block.value[r[i]].kind != kind;
        for (int k = 0; k < elements(s, r[i]); k++) {
            double good = good_value(r[i] + (unsigned)k);
            v[n++] = once_in(30) && kind == REAL ? not_finite() : rough && below(8) == 0 ? (kind == REAL ? wild_number() : (double)below(9) - 3) : good;
        }
    }
    size_t told = once_in(20) ? below(9) : s->version == 2 ? nr : n;
    int no_r = once_in(40), no_v = once_in(40), null = nr > 0 && (no_r || (no_v && (told > 0 || s->version == 2)));
    want.empty = nr == 0 && !(s->version == 3 && told > 0);
    if (s->version == 2)
        told = nr;
    if (null || wrong || told != n)
        want_bad(null ? "null pointer" : "");
    for (unsigned i = 0, at = 0; i < nr && want.given != BAD && set; i++)
        for (int k = 0; k < elements(s, r[i]); k++, at++) {
            unsigned e = r[i] + (unsigned)k;
            if (!settable(s, r[i]) || !isfinite(v[at]) || (kind == ENUMERATION && (v[at] < 1 || v[at] > block.value[e].maximum)))
                want_bad(settable(s, r[i]) ? block.value[e].name : block.value[r[i]].name);
            if (block.value[e].access == INPUT)
                want.after.wild_inputs |= fabs(v[at] - block.start[e]) > 2e-4;
            else
                want.after.wild |= v[at] != block.start[e] && !(kind == BOOLEAN && (v[at] != 0) == (block.start[e] != 0));
        }
    if (!set && doubtful(s) && want.given == GOOD)
        want.given = OPEN;
    if (!set && s->m.written && is_in(s->m.state, "s"))
        deviates("reading after setting");
    if (!set && s->version == 2 && is_in(s->m.state, "n"))
        deviates("any variable");
    if (is_in(s->m.state, "u"))
        deviates("any intermediate variable");
    want.after.written |= set;
    unsigned *exact = malloc(nr * sizeof *exact);
    double *given = malloc((told > n ? told : n) * sizeof *given);
    memcpy(exact, r, nr * sizeof *exact);
    memset(given, 0, (told > n ? told : n) * sizeof *given);
    memcpy(given, v, n * sizeof *given);
    for (unsigned i = 0; i < nr; i++)
        note("%s#%u", i ? " " : no_r ? "null " : "", r[i]);
    for (size_t i = 0; i < n && set && i < 8; i++)
        note("%s%g", i ? " " : no_v ? ": null " : ": ", v[i]);
    note("; %zu", told);
    int status = transfer(s->c, no_r ? NULL : exact, nr, no_v ? NULL : given, told);
    if (status == 0 && set && !no_v && want.given == GOOD && s->version == 2 && nr == 1 && !is_in(s->m.state, "i") && kind == REAL) {
        double back = NAN;
        LAW(within(r[0], block.states) || (fmi2GetReal(s->c, r, 1, &back) == fmi2OK && back == v[0]), "#%u is %g, set to %g", r[0], back, v[0]);
    }
    s->inner_sets += set && status == 0 && is_in(s->m.state, "u");
    free(exact);
    free(given);
    return status;
}

#define VALUES(Function, kind, set) \
    static int run_##Function(Slot *s) { return values(s, transfer_##Function, kind, set); }
VALUES(fmi2GetReal, REAL, 0)
VALUES(fmi2SetReal, REAL, 1)
VALUES(fmi2GetInteger, ENUMERATION, 0)
VALUES(fmi2SetInteger, ENUMERATION, 1)
VALUES(fmi2GetBoolean, BOOLEAN, 0)
VALUES(fmi2SetBoolean, BOOLEAN, 1)
VALUES(fmi3GetFloat64, REAL, 0)
VALUES(fmi3SetFloat64, REAL, 1)
VALUES(fmi3GetInt64, ENUMERATION, 0)
VALUES(fmi3SetInt64, ENUMERATION, 1)
VALUES(fmi3GetBoolean, BOOLEAN, 0)
VALUES(fmi3SetBoolean, BOOLEAN, 1)

/* What the FMU has not: an Error that says so, except for none of it. */
static size_t lacking(void)
{
    size_t n = below(3);
    want.empty = n == 0;
    if (n > 0)
        want.given = LACKED;
    note("%zu", n);
    return n;
}

static unsigned some[4] = {0, 1, 2, UINT32_MAX};
static double room[16]; /* for what no call may touch */
#define LACKING(Function, ...)                                          \
    static int run_##Function(Slot *s)                                  \
    {                                                                   \
        size_t n = lacking();                                           \
        void *x = below(2) ? room : NULL;                               \
        (void)x;                                                        \
        return (int)Function(s->c, below(2) ? some : NULL, n, __VA_ARGS__); \
    }
#define LACKING_TYPE(Type) LACKING(fmi3Get##Type, x, n) LACKING(fmi3Set##Type, x, n)
LACKING(fmi2GetString, x) LACKING(fmi2SetString, x)
LACKING(fmi2SetRealInputDerivatives, x, x) LACKING(fmi2GetRealOutputDerivatives, x, x)
LACKING_TYPE(Float32) LACKING_TYPE(Int8) LACKING_TYPE(UInt8) LACKING_TYPE(Int16) LACKING_TYPE(UInt16) LACKING_TYPE(Int32)
LACKING_TYPE(UInt32) LACKING_TYPE(UInt64) LACKING_TYPE(String)
LACKING(fmi3GetBinary, x, x, n) LACKING(fmi3SetBinary, x, x, n) LACKING(fmi3GetClock, x) LACKING(fmi3SetClock, x)
LACKING(fmi3GetIntervalDecimal, x, x) LACKING(fmi3GetIntervalFraction, x, x, x) LACKING(fmi3GetShiftDecimal, x)
LACKING(fmi3GetShiftFraction, x, x) LACKING(fmi3SetIntervalDecimal, x) LACKING(fmi3SetIntervalFraction, x, x)
LACKING(fmi3SetShiftDecimal, x) LACKING(fmi3SetShiftFraction, x, x) LACKING(fmi3GetOutputDerivatives, x, x, n)

#define CALL(Function, status) \
    static int run_##Function(Slot *s) { return (int)(status); }
#define PLAIN(Function) CALL(Function, Function(s->c))
#define ABSENT(Function, ...) CALL(Function, (want.given = LACKED, Function(s->c, __VA_ARGS__)))
PLAIN(fmi2Terminate) PLAIN(fmi2EnterEventMode) PLAIN(fmi2EnterContinuousTimeMode) PLAIN(fmi2CancelStep)
PLAIN(fmi3Terminate) PLAIN(fmi3EnterEventMode) PLAIN(fmi3EnterContinuousTimeMode) PLAIN(fmi3EvaluateDiscreteStates)
PLAIN(fmi3EnterStepMode) PLAIN(fmi3EnterConfigurationMode) PLAIN(fmi3ExitConfigurationMode)
ABSENT(fmi3ActivateModelPartition, 1, 0.0) ABSENT(fmi3GetNumberOfVariableDependencies, 1, NULL)
ABSENT(fmi3GetVariableDependencies, 1, NULL, NULL, NULL, NULL, 0)

static int run_reset(Slot *s)
{
    memset(&want.after, 0, sizeof want.after);
    want.after.state = INSTANTIATED;
    return s->version == 2 ? (int)fmi2Reset(s->c) : (int)fmi3Reset(s->c);
}

static int run_logging(Slot *s)
{
    const char *names[] = {"logStatusError", "logRequirement", below(4) ? "logStatusError" : below(2) ? "unknown" : NULL};
    size_t n = below(4);
    int on = (int)below(2), null = once_in(20);
    if (n > 0 && (null || (n == 3 && (!names[2] || *names[2] == 'u'))))
        want_bad("log category");
    note("%d, %zu", on, n);
    int status = s->version == 2 ? (int)fmi2SetDebugLogging(s->c, on, n, null ? NULL : names) : (int)fmi3SetDebugLogging(s->c, on, n, null ? NULL : names);
    s->silent = status == 0 ? !on : s->silent;
    return status;
}

/* Sets the start time: FMI 2.0 apart, FMI 3.0 with the entry into initialization mode. */
static int run_start(Slot *s)
{
    static const double good[] = {0, 5, -3, 0.125, 1000}, far[] = {1.9e9, -1.9e9, 1e7}, bad[] = {LATEST, -1e308, 9.1e9};
    double start = once_in(8) ? not_finite() : once_in(8) ? bad[below(3)] : rough && once_in(4) ? far[below(3)] : good[below(5)];
    int stop = (int)below(2);
    note("%g", start);
    if (!(fabs(start) < LATEST))
        want_bad("start time");
    want.after.start = want.after.time = start;
    want.after.samples = 0;
    want.after.set_up = stop ? 2 : 1;
    want.after.wild |= fabs(start) > 1e5;
    if (s->version == 2)
        return (int)fmi2SetupExperiment(s->c, 0, 0, start, stop, start + RUN);
    return (int)fmi3EnterInitializationMode(s->c, 0, 0, start, stop, start + RUN);
}

static int run_initialize2(Slot *s)
{
    if (!s->m.set_up && is_in(s->m.state, "i"))
        deviates("no set-up");
    return (int)fmi2EnterInitializationMode(s->c);
}

static int run_initialized(Slot *s)
{
    want.given = doubtful(s) ? OPEN : GOOD;
    want.after.written = 0;
    return s->version == 2 ? (int)fmi2ExitInitializationMode(s->c) : (int)fmi3ExitInitializationMode(s->c);
}

/* Saved states */

static int run_save(Slot *s)
{
    unsigned j = below(4), null = once_in(30);
    note(null ? "null" : "state %u", j);
    if (null)
        want_bad("null pointer");
    int status = get_state(s, null ? NULL : &stash[j].state);
    if (status == 0) {
        stash[j].m = s->m;
        stash[j].from = s;
        stash[j].model_exchange = s->model_exchange;
    }
    return status;
}

static int run_restore(Slot *s)
{
    unsigned j = below(4);
    note("state %u%s", j, stash[j].state ? "" : ", null");
    if (!stash[j].state)
        want_bad("null pointer");
    else if (stash[j].model_exchange != s->model_exchange)
        want_bad("refused");
    else if (stash[j].from != s)
        deviates("another instance's state");
    want.after = stash[j].m;
    return s->version == 2 ? (int)fmi2SetFMUstate(s->c, stash[j].state) : (int)fmi3SetFMUState(s->c, stash[j].state);
}

static int run_free_state(Slot *s)
{
    unsigned j = below(4);
    note("state %u", j);
    int status = free_state(s, once_in(20) ? NULL : &stash[j].state);
    return status;
}

static int run_size(Slot *s)
{
    unsigned j = below(4), null = once_in(20);
    size_t size = memory_size;
    if (null || !stash[j].state)
        want_bad("null pointer");
    int status = s->version == 2 ? (int)fmi2SerializedFMUstateSize(s->c, stash[j].state, null ? NULL : &size) : (int)fmi3SerializedFMUStateSize(s->c, stash[j].state, null ? NULL : &size);
    LAW(size == memory_size, "a state has another size");
    return status;
}

static int run_serialize(Slot *s)
{
    unsigned j = below(4);
    size_t size = once_in(6) ? below(2 * (unsigned)memory_size) : memory_size;
    unsigned char *bytes = once_in(20) ? NULL : malloc(size);
    note("state %u, %zu bytes", j, size);
    if (!bytes || !stash[j].state || size != memory_size)
        want_bad(bytes && stash[j].state ? "size" : "null pointer");
    int status = s->version == 2 ? (int)fmi2SerializeFMUstate(s->c, stash[j].state, (char *)bytes, size) : (int)fmi3SerializeFMUState(s->c, stash[j].state, bytes, size);
    if (status == 0) {
        free(written.bytes);
        written.bytes = bytes;
        written.m = stash[j].m;
        written.model_exchange = stash[j].model_exchange;
    } else
        free(bytes);
    return status;
}

static int run_deserialize(Slot *s)
{
    unsigned j = below(4), how = below(5), flips = how == 1 ? 1 + below(3) : 0;
    size_t size = how == 2 ? below(2 * (unsigned)memory_size) : memory_size;
    unsigned char *bytes = once_in(20) ? NULL : malloc(size);
    for (size_t i = 0; bytes && i < size; i++)
        bytes[i] = how != 3 && written.bytes && i < memory_size ? written.bytes[i] : (unsigned char)below(256);
    for (unsigned k = 0; bytes && k < flips; k++)
        bytes[below(2) ? below((unsigned)size) : below(sizeof(Memory))] ^= (unsigned char)(1u << below(8));
    note("state %u, %zu bytes, %s", j, size, !bytes ? "null" : flips ? "flipped" : how == 3 ? "random" : "as written");
    if (!bytes || size != memory_size)
        want_bad(bytes ? "size" : "null pointer");
    else if (how == 3 || !written.bytes || written.model_exchange != s->model_exchange)
        want_bad("refused");
    else if (flips)
        want.given = OPEN;
    void *old = stash[j].state, **state = &stash[j].state;
    int status = s->version == 2 ? (int)fmi2DeSerializeFMUstate(s->c, (char *)bytes, size, state) : (int)fmi3DeserializeFMUState(s->c, bytes, size, state);
    LAW(status == 0 || old == *state, "a state that was refused is there");
    if (status == 0) {
        Memory peek; /* a flipped bit may have made another state of it, a good one as far as anybody can tell */
        memcpy(&peek, bytes, sizeof peek);
        stash[j].m = written.m;
        stash[j].from = s;
        stash[j].model_exchange = s->model_exchange;
        if (flips) {
            stash[j].m.state = peek.state;
            stash[j].m.time = peek.clock;
            stash[j].m.wild = 2;
        }
    }
    free(bytes);
    return status;
}

/* Derivatives */

static int is_unknown(const Slot *s, unsigned r) { return (void)s, within(r, block.outputs) || within(r, block.derivatives) || within(r, block.states); }

static int is_known(const Slot *s, unsigned r) { return (void)s, r == 0 || within(r, block.inputs) || within(r, block.states) || within(r, block.parameters); }

static int sensitivity(Slot *s, int adjoint)
{
    size_t nu = below(4), nk = below(4), n[2] = {0, 0};
    unsigned *r[2] = {malloc(nu * sizeof(unsigned)), malloc(nk * sizeof(unsigned))};
    for (size_t i = 0; i < nu + nk; i++) {
        int known = i >= nu;
        unsigned x = r[known][known ? i - nu : i] = reference(s, REAL, known ? is_known : is_unknown);
        if (!elements(s, x) || !(known ? is_known(s, x) && block.value[x].kind == REAL : is_unknown(s, x)))
            want_bad("value reference");
        n[known] += (size_t)elements(s, x);
        note("%s#%u", i == nu ? " by " : " ", x);
    }
    size_t seeds = s->version == 2 ? nk : n[!adjoint], results = s->version == 2 ? nu : n[adjoint];
    if (s->version == 3 && once_in(20))
        results = below(40);
    if (s->version == 3 && results != n[adjoint])
        want_bad("");
    double *v = malloc(seeds * sizeof *v), *result = once_in(40) ? NULL : malloc(results * sizeof *result);
    for (size_t i = 0; i < seeds; i++) {
        v[i] = once_in(30) ? not_finite() : once_in(10) ? wild_number() : (double)below(5) - 2;
        want.given = want.given == GOOD && fabs(v[i]) <= 2 ? GOOD : want.given == BAD ? BAD : OPEN;
    }
    if (!result && results > 0) {
        want.given = GOOD;
        want_bad("null pointer");
    }
    if (doubtful(s) && want.given == GOOD)
        want.given = OPEN;
    deviates("any known");
    int status = s->version == 2 ? (int)fmi2GetDirectionalDerivative(s->c, r[0], nu, r[1], nk, v, result)
                 : adjoint       ? (int)fmi3GetAdjointDerivative(s->c, r[0], nu, r[1], nk, v, seeds, result, results)
                                 : (int)fmi3GetDirectionalDerivative(s->c, r[0], nu, r[1], nk, v, seeds, result, results);
    for (size_t i = 0; result && i < results && status == 0; i++)
        LAW(isfinite(result[i]), "a derivative is %g", result[i]);
    free(r[0]), free(r[1]), free(v), free(result);
    return status;
}

CALL(fmi2GetDirectionalDerivative, sensitivity(s, 0))
CALL(fmi3GetDirectionalDerivative, sensitivity(s, 0))
CALL(fmi3GetAdjointDerivative, sensitivity(s, 1))

/* Model exchange */

typedef int Vector(void *c, double *x, size_t n);

static int vector(Slot *s, Vector *function, int set)
{
    size_t count = (size_t)block.states.count, n = once_in(8) ? (below(2) ? below(40) : count + ((size_t)1 << 32)) : count;
    double *x = n > 0xffff ? calloc(count, sizeof *x) : once_in(12) ? NULL : calloc(n, sizeof *x);
    note("%zu%s", n, x ? "" : ", null");
    if ((!x && n > 0) || n != count)
        want_bad(!x && n > 0 ? "null pointer" : "continuous states");
    if (set && x && want.given == GOOD && s->version == 2 && fmi2GetContinuousStates(s->c, x, n) != fmi2OK)
        want.empty = 0;
    if (set && x && want.given == GOOD && s->version == 3 && fmi3GetContinuousStates(s->c, x, n) != fmi3OK)
        want.empty = 0;
    if (set && x && want.given == GOOD && n > 0 && once_in(4)) {
        unsigned i = below((unsigned)n);
        x[i] = once_in(3) ? not_finite() : rough ? wild_number() : x[i];
        want.after.wild |= rough;
        if (!isfinite(x[i]))
            want_bad(block.value[block.states.first + (int)i].name);
    }
    if (want.given == GOOD && !set && doubtful(s))
        want.given = OPEN;
    said.count = 0;
    int status = function(s->c, x, n);
    free(x);
    return status;
}

#define VECTOR(Function, set)                                                               \
    static int vector_##Function(void *c, double *x, size_t n) { return (int)Function(c, x, n); } \
    static int run_##Function(Slot *s) { return vector(s, vector_##Function, set); }
VECTOR(fmi2SetContinuousStates, 1) VECTOR(fmi2GetContinuousStates, 0) VECTOR(fmi2GetDerivatives, 0)
VECTOR(fmi2GetNominalsOfContinuousStates, 0) VECTOR(fmi3SetContinuousStates, 1) VECTOR(fmi3GetContinuousStates, 0)
VECTOR(fmi3GetContinuousStateDerivatives, 0) VECTOR(fmi3GetNominalsOfContinuousStates, 0)
CALL(fmi2GetEventIndicators, fmi2GetEventIndicators(s->c, room, lacking()))
CALL(fmi3GetEventIndicators, fmi3GetEventIndicators(s->c, room, lacking()))

static int run_time(Slot *s)
{
    double time = once_in(6) ? not_finite() : once_in(6) ? LATEST : s->m.start + (double)below(1000) / 100;
    note("%g", time);
    if (!(fabs(time) < LATEST))
        want_bad("time");
    if (time < s->m.time)
        deviates("time goes back");
    want.after.time = time;
    return s->version == 2 ? (int)fmi2SetTime(s->c, time) : (int)fmi3SetTime(s->c, time);
}

/* A place for a result, or NULL once in a while. */
static void *place(void)
{
    if (!once_in(40))
        return room;
    want_bad("null pointer");
    note("null");
    return NULL;
}

CALL(fmi2NewDiscreteStates, fmi2NewDiscreteStates(s->c, place()))
CALL(fmi2CompletedIntegratorStep, fmi2CompletedIntegratorStep(s->c, 1, place(), place()))
CALL(fmi3CompletedIntegratorStep, fmi3CompletedIntegratorStep(s->c, 1, place(), place()))
CALL(fmi3UpdateDiscreteStates, fmi3UpdateDiscreteStates(s->c, place(), place(), place(), place(), place(), place()))
CALL(fmi3GetNumberOfEventIndicators, fmi3GetNumberOfEventIndicators(s->c, place()))
CALL(fmi3GetNumberOfContinuousStates, fmi3GetNumberOfContinuousStates(s->c, place()))

/* Co-simulation */

static fmi2StatusKind inquiry(fmi2StatusKind known)
{
    fmi2StatusKind kind = (fmi2StatusKind)below(4);
    note("%d ", (int)kind);
    if (kind != known) {
        want.given = UNSAID;
        deviates("status without a word");
    }
    return kind;
}
#define NONE_KNOWN ((fmi2StatusKind)4)

static int run_fmi2GetRealStatus(Slot *s)
{
    double time = s->m.time;
    fmi2StatusKind kind = inquiry(fmi2LastSuccessfulTime);
    int status = (int)fmi2GetRealStatus(s->c, kind, &time);
    LAW(time == s->m.time || s->m.wild, "the last successful time is %.17g, not %.17g", time, s->m.time);
    return status;
}

CALL(fmi2GetBooleanStatus, fmi2GetBooleanStatus(s->c, inquiry(fmi2Terminated), (fmi2Boolean *)room))
CALL(fmi2GetStatus, fmi2GetStatus(s->c, inquiry(NONE_KNOWN), (fmi2Status *)room))
CALL(fmi2GetIntegerStatus, fmi2GetIntegerStatus(s->c, inquiry(NONE_KNOWN), (fmi2Integer *)room))
CALL(fmi2GetStringStatus, fmi2GetStringStatus(s->c, inquiry(NONE_KNOWN), (void *)room))

static int run_step(Slot *s)
{
    static const double sizes[] = {0.001, 0.0004, 0.003, 0.01}, odd[] = {0, -0.0, -0.001, NAN, INFINITY, -INFINITY, 1e308, 2e10, 1e-13, 5e-324, 5e4, 2e5};
    double at = s->m.time, rest = sampled ? limit(&s->m) - at : 0, size = sampled ? rest / (1 + below(2)) : sizes[below(4)];
    double misfits[] = {at + 1e-6, at - 0.001, NAN, INFINITY, -1.9e9, 1.9e9, 1e308, at + 4e-10, at - 4e-10}, time = once_in(12) ? misfits[below(9)] : at;
    size = once_in(5) ? odd[below(12)] : sampled && once_in(8) ? rest + period() * (0.1 + below(3)) : size;
    note("%.17g, %.17g", time, size);
    int null = s->version == 3 && once_in(40);
    if (null)
        want_bad("null pointer");
    else if (!(size >= 0) || !(fabs(time) < LATEST) || !(fabs(time + size) < LATEST) || !(fabs(time - at) < 2e-9 || s->m.wild))
        want_bad("");
    else if (s->m.set_up == 2 && time + size > s->m.start + RUN + size / 50)
        want_bad(fabs(time - at) < 2e-9 ? "beyond the stop time" : "");
    else if (doubtful(s))
        want.given = OPEN;
    else if (sampled && size > rest + 2e-9)
        want_bad("passes over a sample");
    else if (!sampled && size > 1e7 * block.step)
        want_bad("integration steps");
    if (size == 0)
        deviates("step of no size");
    fmi3Boolean event = 0, terminate = 0, early = 0;
    fmi3Float64 last = 0;
    if (s->m.state != INTERMEDIATE) {
        s->begin = s->seen = time;
        s->end = time + size;
        s->inner_sets = s->asked = 0;
    }
    int status = s->version == 2 ? (int)fmi2DoStep(s->c, time, size, 1) : (int)fmi3DoStep(s->c, time, size, 1, &event, &terminate, &early, null ? NULL : &last);
    LAW(!event && !terminate && (!early || (s->asked && s->early)), "what the step reports");
    LAW(status != 0 || s->version == 2 || s->m.wild || (early ? last < s->end && last == s->seen : last == s->end), "last successful time %.17g", last);
    want.after = s->m; /* an intermediate update may have set inputs */
    want.after.time = early ? last : s->end;
    want.after.samples += sampled && at >= s->m.start + (double)s->m.samples * period() - 1e-9;
    want.after.wild |= s->m.wild_inputs && block.states.count > 0;
    want.after.written = 0;
    want.given = want.given == GOOD && doubtful(s) ? OPEN : want.given;
    return status;
}

/* The table of the standards: 2.0.5, 3.2.3 and 4.2.4; 3.0.2, 2.3, 3.2 and 4.2. */

typedef struct {
    const char *name;
    int (*run)(Slot *);
    const char *cs, *me; /* states that permit it in co-simulation and in model exchange */
    State next;          /* after OK; 0: as before, or as the call itself says */
} Call;

#define ROW(Function, ...) {#Function, run_##Function, __VA_ARGS__}
#define TYPE_ROWS(Type) ROW(fmi3Get##Type, "nsut", "nect", 0), ROW(fmi3Set##Type, "insu", "inec", 0)
static const Call table2[] = {
    {"fmi2SetDebugLogging", run_logging, "inst", "inect", 0}, {"fmi2SetupExperiment", run_start, "i", "i", 0},
    {"fmi2EnterInitializationMode", run_initialize2, "i", "i", INITIALIZATION}, {"fmi2ExitInitializationMode", run_initialized, "n", "n", STEP},
    ROW(fmi2Terminate, "s", "ec", TERMINATED), {"fmi2Reset", run_reset, "inst", "inect", 0},
    ROW(fmi2GetReal, "nst", "nect", 0), ROW(fmi2GetInteger, "nst", "nect", 0), ROW(fmi2GetBoolean, "nst", "nect", 0), ROW(fmi2GetString, "nst", "nect", 0),
    ROW(fmi2SetReal, "ins", "inec", 0), ROW(fmi2SetInteger, "ins", "ine", 0), ROW(fmi2SetBoolean, "ins", "ine", 0), ROW(fmi2SetString, "ins", "ine", 0),
    {"fmi2GetFMUstate", run_save, "inst", "inect", 0}, {"fmi2SetFMUstate", run_restore, "inst", "inect", 0}, {"fmi2FreeFMUstate", run_free_state, "inst", "inect", 0},
    {"fmi2SerializedFMUstateSize", run_size, "inst", "inect", 0}, {"fmi2SerializeFMUstate", run_serialize, "inst", "inect", 0},
    {"fmi2DeSerializeFMUstate", run_deserialize, "inst", "inect", 0}, ROW(fmi2GetDirectionalDerivative, "nst", "nect", 0),
    ROW(fmi2EnterEventMode, "", "ec", EVENT), ROW(fmi2NewDiscreteStates, "", "e", 0), ROW(fmi2EnterContinuousTimeMode, "", "e", CONTINUOUS),
    ROW(fmi2CompletedIntegratorStep, "", "c", 0), {"fmi2SetTime", run_time, "", "c", 0}, ROW(fmi2SetContinuousStates, "", "c", 0),
    ROW(fmi2GetEventIndicators, "", "nect", 0), ROW(fmi2GetContinuousStates, "", "nect", 0), ROW(fmi2GetDerivatives, "", "nect", 0),
    ROW(fmi2GetNominalsOfContinuousStates, "", "inect", 0), ROW(fmi2SetRealInputDerivatives, "ins", "", 0), ROW(fmi2GetRealOutputDerivatives, "st", "", 0),
    {"fmi2DoStep", run_step, "s", "", 0}, ROW(fmi2CancelStep, "", "", 0), ROW(fmi2GetStatus, "st", "", 0), ROW(fmi2GetRealStatus, "st", "", 0),
    ROW(fmi2GetIntegerStatus, "st", "", 0), ROW(fmi2GetBooleanStatus, "st", "", 0), ROW(fmi2GetStringStatus, "st", "", 0),
};
static const Call table3[] = {
    {"fmi3SetDebugLogging", run_logging, "inst", "inect", 0}, {"fmi3EnterInitializationMode", run_start, "i", "i", INITIALIZATION},
    {"fmi3ExitInitializationMode", run_initialized, "n", "n", STEP}, ROW(fmi3EnterEventMode, "", "c", EVENT), ROW(fmi3Terminate, "s", "ec", TERMINATED),
    {"fmi3Reset", run_reset, "inst", "inect", 0}, ROW(fmi3GetFloat64, "insut", "inect", 0), ROW(fmi3GetInt64, "insut", "inect", 0),
    ROW(fmi3GetBoolean, "insut", "inect", 0), ROW(fmi3SetFloat64, "insu", "inec", 0), ROW(fmi3SetInt64, "insu", "inec", 0), ROW(fmi3SetBoolean, "insu", "inec", 0),
    TYPE_ROWS(Float32), TYPE_ROWS(Int8), TYPE_ROWS(UInt8), TYPE_ROWS(Int16), TYPE_ROWS(UInt16), TYPE_ROWS(Int32), TYPE_ROWS(UInt32), TYPE_ROWS(UInt64),
    TYPE_ROWS(String), TYPE_ROWS(Binary), ROW(fmi3GetClock, "", "e", 0), ROW(fmi3SetClock, "", "e", 0), ROW(fmi3GetIntervalDecimal, "n", "ne", 0),
    ROW(fmi3GetIntervalFraction, "n", "ne", 0), ROW(fmi3GetShiftDecimal, "n", "n", 0), ROW(fmi3GetShiftFraction, "n", "n", 0),
    ROW(fmi3SetIntervalDecimal, "n", "n", 0), ROW(fmi3SetIntervalFraction, "n", "n", 0), ROW(fmi3SetShiftDecimal, "n", "n", 0), ROW(fmi3SetShiftFraction, "n", "n", 0),
    {"fmi3GetFMUState", run_save, "inst", "inect", 0}, {"fmi3SetFMUState", run_restore, "inst", "inect", 0}, {"fmi3FreeFMUState", run_free_state, "inst", "inect", 0},
    {"fmi3SerializedFMUStateSize", run_size, "inst", "inect", 0}, {"fmi3SerializeFMUState", run_serialize, "inst", "inect", 0},
    {"fmi3DeserializeFMUState", run_deserialize, "inst", "inect", 0}, ROW(fmi3GetDirectionalDerivative, "nst", "nect", 0), ROW(fmi3GetAdjointDerivative, "nst", "nect", 0),
    ROW(fmi3EnterConfigurationMode, "", "", 0), ROW(fmi3ExitConfigurationMode, "", "", 0), ROW(fmi3EvaluateDiscreteStates, "", "", 0),
    ROW(fmi3UpdateDiscreteStates, "", "e", 0), ROW(fmi3EnterContinuousTimeMode, "", "e", CONTINUOUS), ROW(fmi3CompletedIntegratorStep, "", "c", 0),
    {"fmi3SetTime", run_time, "", "c", 0}, ROW(fmi3SetContinuousStates, "", "c", 0), ROW(fmi3GetContinuousStateDerivatives, "", "nect", 0),
    ROW(fmi3GetEventIndicators, "", "nect", 0), ROW(fmi3GetContinuousStates, "", "nect", 0), ROW(fmi3GetNominalsOfContinuousStates, "", "nect", 0),
    ROW(fmi3GetNumberOfEventIndicators, "", "ie", 0), ROW(fmi3GetNumberOfContinuousStates, "", "ie", 0), ROW(fmi3EnterStepMode, "", "", 0),
    ROW(fmi3GetOutputDerivatives, "sut", "", 0), {"fmi3DoStep", run_step, "s", "", 0}, ROW(fmi3ActivateModelPartition, "", "", 0),
    ROW(fmi3GetNumberOfVariableDependencies, "", "", 0), ROW(fmi3GetVariableDependencies, "", "", 0),
};

static int permitted(const Slot *s, const Call *call)
{
    int allowed = is_in(s->m.state, s->model_exchange ? call->me : call->cs);
    for (size_t i = 0; i < sizeof deviations / sizeof *deviations; i++) {
        const char *pattern = deviations[i].call;
        size_t n = strcspn(pattern, "*");
        int clock = !strcmp(pattern, "clock functions") && (strstr(call->name, "Clock") || strstr(call->name, "Interval") || strstr(call->name, "Shift"));
        if (!clock && strncmp(pattern, call->name, pattern[n] ? n : strlen(call->name) + 1))
            continue;
        int other = deviations[i].instead == MADE || (deviations[i].instead == MADE_IF_EMPTY && want.empty);
        if (is_in(s->m.state, s->model_exchange ? deviations[i].me : deviations[i].cs) && allowed != other && (other || deviations[i].instead == REFUSED)) {
            deviations[i].met++;
            return other;
        }
    }
    return allowed;
}

static void judge(Slot *s, const Call *call, int status)
{
    const char *state = "";
    for (size_t i = 0; i < sizeof states / sizeof *states; i++)
        state = states[i].state == s->m.state ? states[i].name : state;
    LAW(status == 0 || status == 2 || status == 3, "status %d", status);
    LAW(status == 0 || s->mute || want.given == UNSAID || (said.count == 1 && said.status == status), "%d messages, the last with status %d", said.count, said.status);
    int about_fmu = s->mute || strstr(said.text, "this FMU has no ") || strstr(said.text, "belongs to model exchange");
    if (!permitted(s, call)) {
        refused++;
        LAW(status == 3, "%s in %s is not refused", call->name, state);
        int about_variable = want.given == BAD && strstr(call->name, "Set") && strstr(said.text, want.named);
        LAW(about_fmu || about_variable || (strstr(said.text, call->name) && strstr(said.text, state)), "the message does not name %s and %s", call->name, state);
        return;
    }
    LAW(want.given != GOOD || status == 0, "a good call fails");
    LAW(want.given != UNSAID || status == 2, "there is no such status");
    LAW((want.given != BAD && want.given != LACKED) || status != 0, "a bad call succeeds");
    LAW(want.given != LACKED || (status == 3 && about_fmu), "the message does not say what is lacking");
    LAW(want.given != BAD || s->mute || strstr(said.text, want.named), "the message does not say %s", want.named);
    if (s->m.failed && status == 0 && !strstr(call->name, "Get") && !strstr(call->name, "Reset") && !strstr(call->name, "State") && !strstr(call->name, "state"))
        deviates("no error state");
}

static void perform(Slot *s, const Call *call)
{
    static unsigned char *after;
    static double seen[2][4096];
    const int inner = s->m.state == INTERMEDIATE, none = once_in(100), watched = !inner && !is_in(s->m.state, "i") && once_in(8);
    const Model m = s->m;
    calls++;
    note("%*s%td.%s%s(", inner ? 4 : 0, "", s - slots, none ? "null." : "", call->name);
    if (watched)
        read_all(s, seen[0]);
    for (int i = 0; i < slot_count && !inner; i++)
        snapshot(&slots[i], slots[i].bytes);
    memset(&want, 0, sizeof want);
    memset(&said, 0, sizeof said);
    want.after = s->m;
    void *c = s->c;
    s->c = none ? NULL : c;
    int status = call->run(s);
    s->c = c;
    note(") = %d  %s\n", status, said.text);
    if (none)
        LAW(status == 3 && said.count == 0, "a call without an instance");
    else
        judge(s, call, status);
    if (status == 0) {
        s->m = want.after;
        s->m.state = strstr(call->name, "ExitInit") && s->model_exchange ? EVENT : call->next ? call->next : s->m.state;
    }
    s->m.failed |= status == 3;
    after = realloc(after, memory_size);
    for (int i = 0; i < slot_count && !inner; i++) {
        snapshot(&slots[i], after);
        int may_change = &slots[i] == s && status == 0 && !strstr(call->name, "Get");
        void *again = NULL; /* what was saved can be read back */
        if (&slots[i] == s && !(s->m.wild & 2))
            LAW((s->version == 2 ? (int)fmi2DeSerializeFMUstate(s->c, (char *)after, memory_size, &again) : (int)fmi3DeserializeFMUState(s->c, after, memory_size, &again)) == 0, "a saved state cannot be read back");
        free_state(&slots[i], &again);
        LAW(may_change || same(&slots[i], slots[i].bytes, after, &slots[i] == s && s->inner_sets), "instance %d has changed", i);
    }
    if (watched && (status != 0 || strstr(call->name, "Get")) && !s->inner_sets && m.state == s->m.state) {
        read_all(s, seen[1]);
        LAW(!memcmp(seen[0], seen[1], (size_t)block.values * sizeof(double)), "what can be read has changed");
    }
    s->inner_sets = inner ? s->inner_sets : 0;
}

static const Call *named(const Slot *s, const char *name)
{
    const Call *table = s->version == 2 ? table2 : table3;
    while (strcmp(table->name + 4, name))
        table++;
    return table;
}

static void on_update(fmi3InstanceEnvironment e, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get, fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early, fmi3Float64 *early_time)
{
    Slot *s = e;
    LAW(set && get && finished && can_return == s->early, "the flags of an intermediate update");
    LAW(time > s->begin && time < s->end && time >= s->seen, "an intermediate update at %.17g", time);
    s->seen = time;
    s->m.state = INTERMEDIATE;
    note("\n    update at %.17g\n", time);
    for (unsigned n = below(4) ? 0 : 1 + below(2); n > 0; n--) {
        Want outer_want = want;
        Said outer_said = said;
        perform(s, below(3) ? &table3[below(sizeof table3 / sizeof *table3)] : named(s, below(2) ? "GetFloat64" : "SetFloat64"));
        want = outer_want;
        said = outer_said;
    }
    s->m.state = STEP;
    if (below(6) == 0) {
        s->asked = 1;
        *early = true;
        *early_time = time + (s->end - time) * below(3) / 2;
    }
}

/* Sequences */

static void *instantiate(Slot *s, const char *name, const char *key)
{
    static fmi2CallbackFunctions callbacks = {hear2, calloc, free, NULL, NULL};
    int logging = (int)below(2);
    callbacks.componentEnvironment = s;
    s->silent = !logging && !s->mute;
    if (name && !*name)
        deviates("blank name");
    note("%td = %s of FMI %d, %s, %s%s\n", s - slots, s->model_exchange ? "model exchange" : "co-simulation", s->version, s->mute ? "mute" : "", s->early ? "early return" : "", s->callback ? ", updates" : "");
    if (s->version == 2)
        return fmi2Instantiate(name, s->model_exchange ? fmi2ModelExchange : fmi2CoSimulation, key, "", s->mute ? NULL : &callbacks, 0, logging);
    if (s->model_exchange)
        return fmi3InstantiateModelExchange(name, key, NULL, 0, logging, s, s->mute ? NULL : hear3);
    return fmi3InstantiateCoSimulation(name, key, NULL, 0, logging, 0, s->early, some, below(3), s, s->mute ? NULL : hear3, s->callback ? on_update : NULL);
}

static void begin(Slot *s, int version)
{
    *s = (Slot){.version = version, .model_exchange = !sampled && below(2), .mute = once_in(12), .early = (int)below(2), .callback = below(3) > 0, .before = s->before, .bytes = s->bytes};
    s->m.state = INSTANTIATED;
    if (once_in(8)) {
        int mute = s->mute, what = (int)below(3), kind = s->model_exchange;
        s->mute = 0;
        said.count = 0;
        s->model_exchange |= what == 2 && sampled;
        if (what < 2 || sampled)
            LAW(!instantiate(s, what == 0 ? NULL : "x", what == 1 ? "wrong" : token) && said.count == 1 && said.status == 3, "a bad instance");
        s->mute = mute;
        s->model_exchange = kind;
    }
    s->c = instantiate(s, once_in(30) ? "" : "an instance", token);
    LAW(s->c, "no instance");
}

static void end(Slot *s)
{
    if (s->before)
        free_state(s, &s->before);
    note("free %td\n", s - slots);
    if (s->version == 2)
        fmi2FreeInstance(s->c);
    else
        fmi3FreeInstance(s->c);
}

/* What a master would do next. */
static const char *usual(const Slot *s)
{
    static const char *const event[] = {"EnterContinuousTimeMode", "EnterContinuousTimeMode", "SetContinuousStates"};
    static const char *const continuous[] = {"SetTime", "SetContinuousStates", "EnterEventMode"};
    switch (s->m.state) {
    case INSTANTIATED: return s->version == 2 && !s->m.set_up ? "SetupExperiment" : "EnterInitializationMode";
    case INITIALIZATION: return "ExitInitializationMode";
    case STEP: return "DoStep";
    case EVENT: return event[below(3)];
    case CONTINUOUS: return continuous[below(3)];
    default: return "Reset";
    }
}

/* Good inputs, and then a step or a derivative goes through, whatever was refused before. */
static void recover(Slot *s)
{
    if (s->m.wild || !is_in(s->m.state, "s"))
        return;
    note("good inputs, ");
    for (unsigned r = (unsigned)block.inputs.first; within(r, block.inputs); r++) {
        double good[1200];
        int n = s->version == 2 ? 1 : block.value[r].extent;
        for (int k = 0; k < n; k++)
            good[k] = block.start[r + (unsigned)k];
        LAW(n == 0 || (s->version == 2 ? (int)fmi2SetReal(s->c, &r, 1, good) : (int)fmi3SetFloat64(s->c, &r, 1, good, (size_t)n)) == 0, "#%u", r);
    }
    s->m.wild_inputs = 0;
    forced = 1;
    perform(s, named(s, "DoStep"));
    forced = 0;
}

static void sequence(void)
{
    int version = below(2) ? 2 : 3;
    traced = 0;
    trace[0] = '\0';
    chance = seed * 0x2545f4914f6cdd1dULL;
    rough = (int)below(2);
    slot_count = 1 + (int)below(3);
    for (int i = 0; i < slot_count; i++)
        begin(&slots[i], version);
    for (unsigned n = 20 + below(41); n > 0; n--) {
        Slot *s = &slots[below((unsigned)slot_count)];
        unsigned what = below(100);
        if (what < 35)
            perform(s, named(s, usual(s)));
        else if (what < 40)
            recover(s);
        else if (what < 42) {
            end(s);
            begin(s, version);
        } else if (what < 50)
            perform(s, named(s, version == 2 ? "SetReal" : "SetFloat64"));
        else if (what < 60) {
            static const char *const two[] = {"GetFMUstate", "SerializeFMUstate", "DeSerializeFMUstate", "SetFMUstate"};
            static const char *const three[] = {"GetFMUState", "SerializeFMUState", "DeserializeFMUState", "SetFMUState"};
            perform(s, named(s, version == 2 ? two[below(4)] : three[below(4)]));
        } else if (what < 62)
            perform(s, named(s, "Terminate"));
        else if (version == 2)
            perform(s, &table2[below(sizeof table2 / sizeof *table2)]);
        else
            perform(s, &table3[below(sizeof table3 / sizeof *table3)]);
    }
    for (int j = 0; j < 4; j++) {
        free_state(&slots[0], &stash[j].state);
        LAW(!stash[j].state, "a freed state's pointer is kept");
    }
    free(written.bytes);
    written.bytes = NULL;
    for (int i = 0; i < slot_count; i++)
        end(&slots[i]);
}

int main(int argc, char **argv)
{
    if (argc != 5)
        return 2;
    token = argv[1];
    sampled = argv[2][0] == '1';
    const unsigned long long first = strtoull(argv[3], NULL, 10), count = strtoull(argv[4], NULL, 10);
    void *c = fmi2Instantiate("size", fmi2CoSimulation, token, "", NULL, 0, 0), *state = NULL;
    LAW(c && fmi2GetFMUstate(c, &state) == fmi2OK && fmi2SerializedFMUstateSize(c, state, &memory_size) == fmi2OK, "no instance at all");
    fmi2FreeFMUstate(c, &state);
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
    fmi3FreeInstance(NULL);
    for (int i = 0; i < 3; i++)
        slots[i].bytes = malloc(memory_size);
    __sanitizer_set_death_callback(tell);
    signal(SIGABRT, aborted);
    for (seed = first; seed < first + count; seed++) {
        sequence();
        if (seed % 256 == 255 && __lsan_do_recoverable_leak_check())
            fail("a leak, within 256 sequences up to this one");
    }
    for (size_t i = 0; i < sizeof deviations / sizeof *deviations; i++)
        printf("deviation %ld: %s\n", deviations[i].met, deviations[i].call);
    printf("%llu sequences, %llu calls, %llu refused by the state\n", count, calls, refused);
    return 0;
}
