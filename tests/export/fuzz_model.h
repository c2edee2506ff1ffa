/* For fuzz.c: model of the standards' states and of the importer's history; failure reports. */

/* Letters of the states: i instantiated, n initialization, s step, e event, c continuous-time,
   u intermediate update, t terminated. */
static const struct {
    char letter;
    State state;
    const char *name;
} states[] = {{'i', INSTANTIATED, "instantiated"},
              {'n', INITIALIZATION, "initialization mode"},
              {'s', STEP, "step mode"},
              {'e', EVENT, "event mode"},
              {'c', CONTINUOUS, "continuous-time mode"},
              {'u', INTERMEDIATE, "intermediate update mode"},
              {'t', TERMINATED, "terminated"}};

/* Known deviations of this FMU from the standards (FMI 2.0.5, 3.0.2). A `call` with a * is a
   prefix. A row without states is about arguments or about the definition of a state. Each row must
   occur in some sequence. Remove a row that does not occur. */
static struct {
    const char *call;
    const char *cs, *me; /* states, in co-simulation and in model exchange */
    enum { REJECTED, ALLOWED, ALLOWED_IF_EMPTY } instead;
    const char *clause;
    long met;
} deviations[] = {
    {"fmi2SetTime", "", "e", ALLOWED,
     "2.0: 3.2.3 table, condition 8: in event mode for purely discrete FMUs only", 0},
    {"fmi2SetReal", "t", "t", ALLOWED_IF_EMPTY,
     "2.0: 3.2.3, 4.2.4 tables: no setting; without references nothing is set", 0},
    {"fmi2SetInteger", "t", "ct", ALLOWED_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetBoolean", "t", "ct", ALLOWED_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetString", "t", "ct", ALLOWED_IF_EMPTY, "as fmi2SetReal", 0},
    {"fmi2SetRealInputDerivatives", "", "in", ALLOWED_IF_EMPTY,
     "2.0: 4.2.4 table: co-simulation only", 0},
    {"fmi2GetRealOutputDerivatives", "", "t", ALLOWED_IF_EMPTY,
     "2.0: 4.2.4 table: co-simulation only", 0},
    {"fmi2GetStatus", "", "t", ALLOWED, "2.0: 4.2.4 table: co-simulation only (and the other four)",
     0},
    {"fmi2GetRealStatus", "", "t", ALLOWED, "as fmi2GetStatus", 0},
    {"fmi2GetIntegerStatus", "", "t", ALLOWED, "as fmi2GetStatus", 0},
    {"fmi2GetBooleanStatus", "", "t", ALLOWED, "as fmi2GetStatus", 0},
    {"fmi2GetStringStatus", "", "t", ALLOWED, "as fmi2GetStatus", 0},
    {"fmi3GetFloat64", "i", "i", REJECTED,
     "3.0: 2.3.2 table of equations: start values may be read (not in its list of calls)", 0},
    {"fmi3GetInt64", "i", "i", REJECTED, "as fmi3GetFloat64", 0},
    {"fmi3GetBoolean", "i", "i", REJECTED, "as fmi3GetFloat64", 0},
    {"fmi3Set*", "t", "t", ALLOWED_IF_EMPTY,
     "3.0: 2.3.8: no setting; without references nothing is set", 0},
    {"fmi3EvaluateDiscreteStates", "n", "ne", ALLOWED,
     "3.0: 2.3.5: in event mode, if providesEvaluateDiscreteStates", 0},
    {"fmi3FreeFMUState", "u", "", ALLOWED, "3.0: 4.2.2: values only, during an intermediate update",
     0},
    {"fmi3GetNumberOfEventIndicators", "", "nct", ALLOWED,
     "3.0: 2.3.2, 2.3.5: when instantiated and in event mode", 0},
    {"fmi3GetNumberOfContinuousStates", "", "nct", ALLOWED, "as fmi3GetNumberOfEventIndicators", 0},
    {"fmi3GetOutputDerivatives", "", "t", ALLOWED_IF_EMPTY, "3.0: 2.3.8: not in model exchange", 0},
    {"clock functions", "insut", "inect", ALLOWED_IF_EMPTY,
     "3.0: 2.3.3, 2.3.5: clocks in some states only; without references nothing is done", 0},
    {"no error state", "", "", ALLOWED,
     "2.0: 2.1.3, 3.2.3, 4.2.4; 3.0: 2.2.3, 2.3.1: after an Error only reading, restoring, "
     "resetting and freeing",
     0},
    {"no set-up", "", "", ALLOWED,
     "2.0: 2.1.6: fmi2SetupExperiment before fmi2EnterInitializationMode", 0},
    {"reading after setting", "", "", ALLOWED,
     "2.0: 4.2.4, 3.0: 4.2.1: a step between setting and getting in co-simulation", 0},
    {"any variable", "", "", ALLOWED,
     "2.0: 3.2.3, 4.2.4, condition 2: in initialization mode outputs and initial unknowns only", 0},
    {"any intermediate variable", "", "", ALLOWED,
     "3.0: 4.2.2: those named at instantiation only, no reading after setting", 0},
    {"state set one by one", "", "", REJECTED,
     "2.0: 3.2.3, condition 5; 3.0: 2.3.5, 3.2.1: a state by fmiXSetReal/Float64 after "
     "initialization",
     0},
    {"step of no size", "", "", ALLOWED, "2.0: 4.2.2, 3.0: 4.2.1: a step's size is above 0", 0},
    {"time goes back", "", "", ALLOWED,
     "2.0: 3.2.1, 3.0: 3.2.1: not before the start, the last event or the second last completed "
     "step",
     0},
    {"any known", "", "", ALLOWED,
     "2.0: 2.1.9, 3.0: 2.2.11: derivatives by and of what a state's equations have only", 0},
    {"blank name", "", "", ALLOWED, "2.0: 2.1.5, 3.0: 2.3.1: an instance's name is not empty", 0},
    {"logged although logging is off", "", "", ALLOWED,
     "2.0: 2.1.5, 3.0: 2.3.1: no messages if logging is off, or of a category that is", 0},
    {"status without a message", "", "", ALLOWED,
     "3.0: 2.3.1, 2.0: 2.1.3: results other than OK are logged (not of fmi2GetXxxStatus)", 0},
    {"another instance's state", "", "", ALLOWED,
     "2.0: 2.1.8, 3.0: 2.2.4: a saved state is one of this instance", 0},
};

#define LATEST 2e9 /* s; latest valid time */
#define RUN 1000.0 /* s; duration if a stop time is set */

typedef struct {
    State state;
    double start, time;          /* of the importer */
    long samples;                /* of a sampled block */
    int set_up, failed, written; /* for the deviations */
    /* Extreme inputs were set; extreme parameters, states or times. Rejections are expected. */
    int wild_inputs, wild;
} Model;

typedef struct {
    void *c;
    int version, model_exchange, mute, silent, early, callback;
    Model m;
    double begin, end, seen; /* present step, and last intermediate update */
    int inner_sets, asked;
    void *before; /* a saved state for comparisons */
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

/* Kind of the present call's arguments, and the expected result. */
typedef struct {
    enum { GOOD, BAD, LACKED, OPEN, SILENT } given; /* SILENT: Discard or Error, no message */
    int empty;
    char named[200]; /* what the message must contain */
    Model after;
} Expected;

typedef struct {
    int count, status;
    char text[512];
} Logged;

static Expected expected;
static Logged logged;

/* Failure reports */

static char trace[1 << 17];
static size_t traced;
static unsigned long long seed, calls, rejected;

static void note(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int n = vsnprintf(trace + traced, sizeof trace - traced, format, arguments);
    va_end(arguments);
    if (n > 0 && traced + (size_t)n < sizeof trace)
        traced += (size_t)n;
}

static void print_trace(void)
{
    fprintf(stderr, "\nthe sequence with seed %llu:\n%s\n", seed, trace);
}

/* The undefined-behaviour sanitizer ends with a signal, the address sanitizer with its own call. */
const char *__ubsan_default_options(void);
const char *__ubsan_default_options(void) { return "abort_on_error=1:print_stacktrace=1"; }

static void aborted(int signal)
{
    (void)signal;
    print_trace();
    _Exit(1);
}

static void fail(const char *format, ...)
{
    va_list arguments;
    print_trace();
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fprintf(stderr, "\nlast message: %s\n", logged.text);
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

static void on_log(Slot *s, int status, const char *category, const char *text)
{
    logged.count++;
    logged.status = status;
    snprintf(logged.text, sizeof logged.text, "%s", text);
    LAW(category && (!strcmp(category, "logStatusError") || !strcmp(category, "logRequirement")),
        "category %s", category);
    LAW(strlen(text) > 10, "an empty message");
    for (const char *p = text; *p; p++)
        LAW(*p >= ' ' && *p <= '~', "an unreadable message: %s", text);
    for (const char *e = strchr(text, 'e'); e; e = strchr(e + 1, 'e'))
        LAW(!((e[1] == '-' || e[1] == '+') && e[2] >= '0' && e[2] <= '9') ||
                (e > text && e[-1] >= '0' && e[-1] <= '9'),
            "an unreadable number: %s", text);
    if (s && s->silent)
        deviates("logged although logging is off");
}

static void on_log2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status,
                    fmi2String category, fmi2String format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    LAW(name, "a message without the instance's name");
    on_log(e, (int)status, category, text);
}

static void on_log3(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category,
                    fmi3String text)
{
    on_log(e, (int)status, category, text);
}

/* Random numbers */

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
    static const double numbers[] = {1e308, -1e308, 5e-324, -1e-310, 1e200, -1e20, 0,
                                     -0.0,  1e-13,  3,      -7,      4e9,   1e160, 0.5};
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

static int is_in(State state, const char *letters)
{
    return strchr(letters, letter(state)) != NULL;
}

static int within(unsigned r, Range range)
{
    return (int)r >= range.first && (int)r < range.first + range.count;
}

static int doubtful(const Slot *s) { return s->m.wild || s->m.wild_inputs; }

/* The standards' conditions for setting a variable. */
static int settable(const Slot *s, unsigned r)
{
    int access = block.value[r].access, c = letter(s->m.state);
    if (access == START && (c == 'c' || (c == 'e' && s->version == 3)) &&
        !deviates("state set one by one"))
        return 1;
    return access == READ_ONLY    ? 0
           : c == 'i' || c == 'n' ? 1
           : c == 's' || c == 'e' ? access == INPUT || access == TUNABLE
                                  : (c == 'c' || c == 'u') && access == INPUT;
}

static void expect_failure(const char *name)
{
    if (expected.given == GOOD || expected.given == OPEN) {
        expected.given = BAD;
        snprintf(expected.named, sizeof expected.named, "%s", name);
    }
}

static double good_value(unsigned r)
{
    double start = block.start[r];
    return block.value[r].access == INPUT ? start + 1e-4 * ((double)below(2001) / 1000 - 1) : start;
}

static double period(void) { return block.start[block.period]; }

/* Returns the end of the longest step from the present time that passes over no sample. */
static double limit(const Model *m)
{
    int due = m->time >= m->start + (double)m->samples * period() - 1e-9;
    return m->start + (double)(m->samples + due) * period();
}

/* Functions of both FMI versions. */

static int get_state(Slot *s, void **state)
{
    return s->version == 2 ? (int)fmi2GetFMUstate(s->c, state) : (int)fmi3GetFMUState(s->c, state);
}

static int free_state(Slot *s, void **state)
{
    return s->version == 2 ? (int)fmi2FreeFMUstate(s->c, state)
                           : (int)fmi3FreeFMUState(s->c, state);
}

static void snapshot(Slot *s, unsigned char *bytes)
{
    int ok =
        get_state(s, &s->before) == 0 &&
        (s->version == 2 ? (int)fmi2SerializeFMUstate(s->c, s->before, (char *)bytes, memory_size)
                         : (int)fmi3SerializeFMUState(s->c, s->before, bytes, memory_size)) == 0;
    LAW(ok, "the state cannot be saved");
}

/* Compares two saved states without cached results. `inputs`: the importer has set inputs. */
static int same(const Slot *s, const unsigned char *a, const unsigned char *b, int inputs)
{
    const size_t values = offsetof(Memory, value);
    Memory x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    if (x.identity != y.identity || x.state != y.state || x.start != y.start ||
        x.next_sample != y.next_sample || memcmp(&x.clock, &y.clock, sizeof x.clock))
        return 0;
    for (unsigned r = 1; r < (unsigned)(block.values + block.states.count); r++) {
        /* Outputs are a sampled block's memory between samples. */
        int held = sampled && !is_in(s->m.state, "in");
        int computed = within(r, block.derivatives) || (within(r, block.outputs) && !held);
        if (!computed && !(inputs && within(r, block.inputs)) &&
            memcmp(a + values + r * sizeof(double), b + values + r * sizeof(double),
                   sizeof(double)))
            return 0;
    }
    return 1;
}

/* Reads all values one by one; NaN for unreadable ones. */

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
            status = (int)(kind == BOOLEAN ? fmi2GetBoolean(s->c, &r, 1, &number)
                                           : fmi2GetInteger(s->c, &r, 1, &number));
        else if (extent > 0 && kind == REAL)
            status = (int)fmi3GetFloat64(s->c, &r, 1, &value[r], (size_t)extent);
        else if (extent > 0)
            status = (int)(kind == BOOLEAN ? fmi3GetBoolean(s->c, &r, 1, &flag, 1)
                                           : fmi3GetInt64(s->c, &r, 1, &whole, 1));
        if (kind != REAL)
            value[r] = number + (double)whole + flag;
        LAW(status == 0 || doubtful(s) || (s->version == 3 && extent == 0), "%s cannot be read",
            block.value[r].name);
        if (s->version == 3 && extent > 1)
            r += (unsigned)extent - 1;
    }
}
