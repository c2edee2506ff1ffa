/* For fuzz.c: every function of both interfaces with random arguments, and its expected result. */

/* Values */

/* One function of the interface that gets or sets n values at nr references. */
typedef int Transfer(void *c, const unsigned *r, size_t nr, double *v, size_t n);

#define TRANSFER(Function, Type, ...)                                                          \
    static int transfer_##Function(void *c, const unsigned *r, size_t nr, double *v, size_t n) \
    {                                                                                          \
        Type *x = v ? malloc(n * sizeof *x) : NULL;                                            \
        for (size_t i = 0; v && i < n; i++)                                                    \
            x[i] = (Type)v[i];                                                                 \
        (void)n;                                                                               \
        int status = (int)Function(c, r, nr, __VA_ARGS__);                                     \
        for (size_t i = 0; v && i < n && status == 0; i++)                                     \
            v[i] = (double)x[i];                                                               \
        free(x);                                                                               \
        return status;                                                                         \
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

static int elements(const Slot *s, unsigned r)
{
    return r >= (unsigned)block.values ? 0 : s->version == 2 ? 1 : block.value[r].extent;
}

/* Returns a random reference, usually one of this kind that `fits`. */
static unsigned reference(const Slot *s, int kind, int (*fits)(const Slot *, unsigned))
{
    for (int i = 0; i < 60 && !once_in(40); i++) {
        unsigned r = below((unsigned)block.values);
        if (elements(s, r) && block.value[r].kind == kind && (!fits || fits(s, r)))
            return r;
    }
    return forced     ? 0
           : below(3) ? below((unsigned)block.values + 3)
           : below(2) ? UINT32_MAX
                      : 100000;
}

static int open_to_set(const Slot *s, unsigned r)
{
    return block.value[r].access == INPUT ||
           (!is_in(s->m.state, "suect") && block.value[r].access != READ_ONLY);
}

static int values(Slot *s, Transfer *transfer, int kind, int set)
{
    unsigned r[6] = {0}, nr = below(5);
    double v[1200];
    size_t n = 0;
    int wrong = 0;
    /* Choose references and values. Some of them are invalid. */
    for (unsigned i = 0; i < nr; i++) {
        r[i] = reference(s, kind, set ? open_to_set : NULL);
        wrong |= elements(s, r[i]) == 0 || block.value[r[i]].kind != kind;
        for (int k = 0; k < elements(s, r[i]); k++) {
            double good = good_value(r[i] + (unsigned)k);
            v[n++] = once_in(30) && kind == REAL ? not_finite()
                     : rough && below(8) == 0
                         ? (kind == REAL ? wild_number() : (double)below(9) - 3)
                         : good;
        }
    }
    /* Wrong sizes and null pointers. */
    size_t passed = once_in(20) ? below(9) : s->version == 2 ? nr : n;
    int no_r = once_in(40), no_v = once_in(40),
        null = nr > 0 && (no_r || (no_v && (passed > 0 || s->version == 2)));
    expected.empty = nr == 0 && !(s->version == 3 && passed > 0);
    if (s->version == 2)
        passed = nr;
    if (null || wrong || passed != n)
        expect_failure(null ? "null pointer" : "");
    /* The expected result. */
    for (unsigned i = 0, at = 0; i < nr && expected.given != BAD && set; i++)
        for (int k = 0; k < elements(s, r[i]); k++, at++) {
            unsigned e = r[i] + (unsigned)k;
            if (!settable(s, r[i]) || !isfinite(v[at]) ||
                (kind == ENUMERATION && (v[at] < 1 || v[at] > block.value[e].maximum)))
                expect_failure(settable(s, r[i]) ? block.value[e].name : block.value[r[i]].name);
            if (block.value[e].access == INPUT)
                expected.after.wild_inputs |= fabs(v[at] - block.start[e]) > 2e-4;
            else
                expected.after.wild |= v[at] != block.start[e] &&
                                       !(kind == BOOLEAN && (v[at] != 0) == (block.start[e] != 0));
        }
    if (!set && doubtful(s) && expected.given == GOOD)
        expected.given = OPEN;
    if (!set && s->m.written && is_in(s->m.state, "s"))
        deviates("reading after setting");
    if (!set && s->version == 2 && is_in(s->m.state, "n"))
        deviates("any variable");
    if (is_in(s->m.state, "u"))
        deviates("any intermediate variable");
    expected.after.written |= set;
    /* Make the call. The arrays have exactly the passed sizes. Then a sanitizer finds overruns. */
    unsigned *exact = malloc(nr * sizeof *exact);
    double *given = malloc((passed > n ? passed : n) * sizeof *given);
    memcpy(exact, r, nr * sizeof *exact);
    memset(given, 0, (passed > n ? passed : n) * sizeof *given);
    memcpy(given, v, n * sizeof *given);
    for (unsigned i = 0; i < nr; i++)
        note("%s#%u", i ? " " : no_r ? "null " : "", r[i]);
    for (size_t i = 0; i < n && set && i < 8; i++)
        note("%s%g", i ? " " : no_v ? ": null " : ": ", v[i]);
    note("; %zu", passed);
    int status = transfer(s->c, no_r ? NULL : exact, nr, no_v ? NULL : given, passed);
    if (status == 0 && set && !no_v && expected.given == GOOD && s->version == 2 && nr == 1 &&
        !is_in(s->m.state, "i") && kind == REAL) {
        double back = NAN;
        LAW(within(r[0], block.states) ||
                (fmi2GetReal(s->c, r, 1, &back) == fmi2OK && back == v[0]),
            "#%u is %g, set to %g", r[0], back, v[0]);
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

/* Returns a number n of unsupported variables. If n > 0, an Error that names them is expected. */
static size_t lacking(void)
{
    size_t n = below(3);
    expected.empty = n == 0;
    if (n > 0)
        expected.given = LACKED;
    note("%zu", n);
    return n;
}

static unsigned some[4] = {0, 1, 2, UINT32_MAX};
static double room[16]; /* target of results that must not be written */
#define LACKING(Function, ...)                                              \
    static int run_##Function(Slot *s)                                      \
    {                                                                       \
        size_t n = lacking();                                               \
        void *x = below(2) ? room : NULL;                                   \
        (void)x;                                                            \
        return (int)Function(s->c, below(2) ? some : NULL, n, __VA_ARGS__); \
    }
#define LACKING_TYPE(Type)       \
    LACKING(fmi3Get##Type, x, n) \
    LACKING(fmi3Set##Type, x, n)
LACKING(fmi2GetString, x)
LACKING(fmi2SetString, x)
LACKING(fmi2SetRealInputDerivatives, x, x)
LACKING(fmi2GetRealOutputDerivatives, x, x)
LACKING_TYPE(Float32)
LACKING_TYPE(Int8)
LACKING_TYPE(UInt8)
LACKING_TYPE(Int16)
LACKING_TYPE(UInt16)
LACKING_TYPE(Int32)
LACKING_TYPE(UInt32)
LACKING_TYPE(UInt64)
LACKING_TYPE(String)
LACKING(fmi3GetBinary, x, x, n)
LACKING(fmi3SetBinary, x, x, n)
LACKING(fmi3GetClock, x)
LACKING(fmi3SetClock, x)
LACKING(fmi3GetIntervalDecimal, x, x)
LACKING(fmi3GetIntervalFraction, x, x, x)
LACKING(fmi3GetShiftDecimal, x)
LACKING(fmi3GetShiftFraction, x, x)
LACKING(fmi3SetIntervalDecimal, x)
LACKING(fmi3SetIntervalFraction, x, x)
LACKING(fmi3SetShiftDecimal, x)
LACKING(fmi3SetShiftFraction, x, x)
LACKING(fmi3GetOutputDerivatives, x, x, n)

#define CALL(Function, status) \
    static int run_##Function(Slot *s) { return (int)(status); }
#define PLAIN(Function) CALL(Function, Function(s->c))
#define ABSENT(Function, ...) CALL(Function, (expected.given = LACKED, Function(s->c, __VA_ARGS__)))
PLAIN(fmi2Terminate)
PLAIN(fmi2EnterEventMode)
PLAIN(fmi2EnterContinuousTimeMode)
PLAIN(fmi2CancelStep)
PLAIN(fmi3Terminate)
PLAIN(fmi3EnterEventMode)
PLAIN(fmi3EnterContinuousTimeMode)
PLAIN(fmi3EvaluateDiscreteStates)
PLAIN(fmi3EnterStepMode)
PLAIN(fmi3EnterConfigurationMode)
PLAIN(fmi3ExitConfigurationMode)
ABSENT(fmi3ActivateModelPartition, 1, 0.0)
ABSENT(fmi3GetNumberOfVariableDependencies, 1, NULL)
ABSENT(fmi3GetVariableDependencies, 1, NULL, NULL, NULL, NULL, 0)

static int run_reset(Slot *s)
{
    memset(&expected.after, 0, sizeof expected.after);
    expected.after.state = INSTANTIATED;
    return s->version == 2 ? (int)fmi2Reset(s->c) : (int)fmi3Reset(s->c);
}

static int run_logging(Slot *s)
{
    const char *names[] = {"logStatusError", "logRequirement",
                           below(4)   ? "logStatusError"
                           : below(2) ? "unknown"
                                      : NULL};
    size_t n = below(4);
    int on = (int)below(2), null = once_in(20);
    if (n > 0 && (null || (n == 3 && (!names[2] || *names[2] == 'u'))))
        expect_failure("log category");
    note("%d, %zu", on, n);
    int status = s->version == 2 ? (int)fmi2SetDebugLogging(s->c, on, n, null ? NULL : names)
                                 : (int)fmi3SetDebugLogging(s->c, on, n, null ? NULL : names);
    s->silent = status == 0 ? !on : s->silent;
    return status;
}

/* Sets the start time: with a separate call in FMI 2.0, with EnterInitializationMode in 3.0. */
static int run_start(Slot *s)
{
    static const double good[] = {0, 5, -3, 0.125, 1000}, far[] = {1.9e9, -1.9e9, 1e7},
                        bad[] = {LATEST, -1e308, 9.1e9};
    double start = once_in(8)            ? not_finite()
                   : once_in(8)          ? bad[below(3)]
                   : rough && once_in(4) ? far[below(3)]
                                         : good[below(5)];
    int stop = (int)below(2);
    note("%g", start);
    if (!(fabs(start) < LATEST))
        expect_failure("start time");
    expected.after.start = expected.after.time = start;
    expected.after.samples = 0;
    expected.after.set_up = stop ? 2 : 1;
    expected.after.wild |= fabs(start) > 1e5;
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
    expected.given = doubtful(s) ? OPEN : GOOD;
    expected.after.written = 0;
    return s->version == 2 ? (int)fmi2ExitInitializationMode(s->c)
                           : (int)fmi3ExitInitializationMode(s->c);
}

/* Saved states */

static int run_save(Slot *s)
{
    unsigned j = below(4), null = once_in(30);
    note(null ? "null" : "state %u", j);
    if (null)
        expect_failure("null pointer");
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
        expect_failure("null pointer");
    else if (stash[j].model_exchange != s->model_exchange)
        expect_failure("rejected");
    else if (stash[j].from != s)
        deviates("another instance's state");
    expected.after = stash[j].m;
    return s->version == 2 ? (int)fmi2SetFMUstate(s->c, stash[j].state)
                           : (int)fmi3SetFMUState(s->c, stash[j].state);
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
        expect_failure("null pointer");
    int status = s->version == 2
                     ? (int)fmi2SerializedFMUstateSize(s->c, stash[j].state, null ? NULL : &size)
                     : (int)fmi3SerializedFMUStateSize(s->c, stash[j].state, null ? NULL : &size);
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
        expect_failure(bytes && stash[j].state ? "size" : "null pointer");
    int status = s->version == 2
                     ? (int)fmi2SerializeFMUstate(s->c, stash[j].state, (char *)bytes, size)
                     : (int)fmi3SerializeFMUState(s->c, stash[j].state, bytes, size);
    if (status == 0) {
        free(written.bytes);
        written.bytes = bytes;
        written.m = stash[j].m;
        written.model_exchange = stash[j].model_exchange;
    } else
        free(bytes);
    return status;
}

/* Writes the runtime's checksum (FNV-1a) after `size` bytes. */
static void sum_up(unsigned char *bytes, size_t size)
{
    uint64_t sum = 14695981039346656037ULL;
    for (size_t i = 0; i < size; i++)
        sum = (sum ^ bytes[i]) * 1099511628211ULL;
    memcpy(bytes + size, &sum, sizeof sum);
}

static int run_deserialize(Slot *s)
{
    unsigned j = below(4), how = below(5), flips = how == 1 ? 1 + below(3) : 0;
    size_t size = how == 2 ? below(2 * (unsigned)memory_size) : memory_size;
    unsigned char *bytes = once_in(20) ? NULL : malloc(size);
    for (size_t i = 0; bytes && i < size; i++)
        bytes[i] = how != 3 && written.bytes && i < memory_size ? written.bytes[i]
                                                                : (unsigned char)below(256);
    for (unsigned k = 0; bytes && k < flips; k++)
        bytes[below(2) ? below((unsigned)size) : below(sizeof(Memory))] ^=
            (unsigned char)(1u << below(8));
    flips = flips && bytes && size == memory_size && written.bytes &&
            memcmp(bytes, written.bytes, size) != 0;
    int agreed = flips && below(2); /* a forged state with a matching checksum */
    if (agreed)
        sum_up(bytes, size - sizeof(uint64_t));
    note("state %u, %zu bytes, %s", j, size,
         !bytes     ? "null"
         : agreed   ? "forged"
         : flips    ? "flipped"
         : how == 3 ? "random"
                    : "as written");
    if (!bytes || size != memory_size)
        expect_failure(bytes ? "size" : "null pointer");
    else if (how == 3 || !written.bytes || written.model_exchange != s->model_exchange)
        expect_failure("rejected");
    else if (flips && !agreed)
        expect_failure("damaged");
    else if (flips)
        expected.given = OPEN;
    void *old = stash[j].state, **state = &stash[j].state;
    int status = s->version == 2 ? (int)fmi2DeSerializeFMUstate(s->c, (char *)bytes, size, state)
                                 : (int)fmi3DeserializeFMUState(s->c, bytes, size, state);
    LAW(status == 0 || old == *state, "a rejected state was stored");
    if (status == 0) {
        Memory peek; /* a flipped bit may have resulted in another valid state */
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

static int is_unknown(const Slot *s, unsigned r)
{
    return (void)s,
           within(r, block.outputs) || within(r, block.derivatives) || within(r, block.states);
}

static int is_known(const Slot *s, unsigned r)
{
    return (void)s, r == 0 || within(r, block.inputs) || within(r, block.states) ||
                        within(r, block.parameters);
}

static int sensitivity(Slot *s, int adjoint)
{
    size_t nu = below(4), nk = below(4), n[2] = {0, 0};
    unsigned *r[2] = {malloc(nu * sizeof(unsigned)), malloc(nk * sizeof(unsigned))};
    for (size_t i = 0; i < nu + nk; i++) {
        int known = i >= nu;
        unsigned x = r[known][known ? i - nu : i] =
            reference(s, REAL, known ? is_known : is_unknown);
        if (!elements(s, x) ||
            !(known ? is_known(s, x) && block.value[x].kind == REAL : is_unknown(s, x)))
            expect_failure("value reference");
        n[known] += (size_t)elements(s, x);
        note("%s#%u", i == nu ? " by " : " ", x);
    }
    size_t seeds = s->version == 2 ? nk : n[!adjoint], results = s->version == 2 ? nu : n[adjoint];
    if (s->version == 3 && once_in(20))
        results = below(40);
    if (s->version == 3 && results != n[adjoint])
        expect_failure("");
    double *v = malloc(seeds * sizeof *v),
           *result = once_in(40) ? NULL : malloc(results * sizeof *result);
    for (size_t i = 0; i < seeds; i++) {
        v[i] = once_in(30) ? not_finite() : once_in(10) ? wild_number() : (double)below(5) - 2;
        expected.given = expected.given == GOOD && fabs(v[i]) <= 2 ? GOOD
                         : expected.given == BAD                   ? BAD
                                                                   : OPEN;
    }
    if (!result && results > 0) {
        expected.given = GOOD;
        expect_failure("null pointer");
    }
    if (doubtful(s) && expected.given == GOOD)
        expected.given = OPEN;
    deviates("any known");
    int status =
        s->version == 2 ? (int)fmi2GetDirectionalDerivative(s->c, r[0], nu, r[1], nk, v, result)
        : adjoint
            ? (int)fmi3GetAdjointDerivative(s->c, r[0], nu, r[1], nk, v, seeds, result, results)
            : (int)fmi3GetDirectionalDerivative(s->c, r[0], nu, r[1], nk, v, seeds, result,
                                                results);
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
    size_t count = (size_t)block.states.count,
           n = once_in(8) ? (below(2) ? below(40) : count + ((size_t)1 << 32)) : count;
    double *x = n > 0xffff ? calloc(count, sizeof *x) : once_in(12) ? NULL : calloc(n, sizeof *x);
    note("%zu%s", n, x ? "" : ", null");
    if ((!x && n > 0) || n != count)
        expect_failure(!x && n > 0 ? "null pointer" : "continuous states");
    if (set && x && expected.given == GOOD && s->version == 2 &&
        fmi2GetContinuousStates(s->c, x, n) != fmi2OK)
        expected.empty = 0;
    if (set && x && expected.given == GOOD && s->version == 3 &&
        fmi3GetContinuousStates(s->c, x, n) != fmi3OK)
        expected.empty = 0;
    if (set && x && expected.given == GOOD && n > 0 && once_in(4)) {
        unsigned i = below((unsigned)n);
        x[i] = once_in(3) ? not_finite() : rough ? wild_number() : x[i];
        expected.after.wild |= rough;
        if (!isfinite(x[i]))
            expect_failure(block.value[block.states.first + (int)i].name);
    }
    if (expected.given == GOOD && !set && doubtful(s))
        expected.given = OPEN;
    logged.count = 0;
    int status = function(s->c, x, n);
    free(x);
    return status;
}

#define VECTOR(Function, set)                                                                     \
    static int vector_##Function(void *c, double *x, size_t n) { return (int)Function(c, x, n); } \
    static int run_##Function(Slot *s) { return vector(s, vector_##Function, set); }
VECTOR(fmi2SetContinuousStates, 1)
VECTOR(fmi2GetContinuousStates, 0)
VECTOR(fmi2GetDerivatives, 0)
VECTOR(fmi2GetNominalsOfContinuousStates, 0)
VECTOR(fmi3SetContinuousStates, 1)
VECTOR(fmi3GetContinuousStates, 0)
VECTOR(fmi3GetContinuousStateDerivatives, 0)
VECTOR(fmi3GetNominalsOfContinuousStates, 0)
CALL(fmi2GetEventIndicators, fmi2GetEventIndicators(s->c, room, lacking()))
CALL(fmi3GetEventIndicators, fmi3GetEventIndicators(s->c, room, lacking()))

static int run_time(Slot *s)
{
    double time = once_in(6)   ? not_finite()
                  : once_in(6) ? LATEST
                               : s->m.start + (double)below(1000) / 100;
    note("%g", time);
    if (!(fabs(time) < LATEST))
        expect_failure("time");
    if (time < s->m.time)
        deviates("time goes back");
    expected.after.time = time;
    return s->version == 2 ? (int)fmi2SetTime(s->c, time) : (int)fmi3SetTime(s->c, time);
}

/* Returns a target for a result, sometimes NULL. */
static void *place(void)
{
    if (!once_in(40))
        return room;
    expect_failure("null pointer");
    note("null");
    return NULL;
}

CALL(fmi2NewDiscreteStates, fmi2NewDiscreteStates(s->c, place()))
CALL(fmi2CompletedIntegratorStep, fmi2CompletedIntegratorStep(s->c, 1, place(), place()))
CALL(fmi3CompletedIntegratorStep, fmi3CompletedIntegratorStep(s->c, 1, place(), place()))
CALL(fmi3UpdateDiscreteStates,
     fmi3UpdateDiscreteStates(s->c, place(), place(), place(), place(), place(), place()))
CALL(fmi3GetNumberOfEventIndicators, fmi3GetNumberOfEventIndicators(s->c, place()))
CALL(fmi3GetNumberOfContinuousStates, fmi3GetNumberOfContinuousStates(s->c, place()))

/* Co-simulation */

static fmi2StatusKind inquiry(fmi2StatusKind known)
{
    fmi2StatusKind kind = (fmi2StatusKind)below(4);
    note("%d ", (int)kind);
    if (kind != known) {
        expected.given = SILENT;
        deviates("status without a message");
    }
    return kind;
}
#define NONE_KNOWN ((fmi2StatusKind)4)

static int run_fmi2GetRealStatus(Slot *s)
{
    double time = s->m.time;
    fmi2StatusKind kind = inquiry(fmi2LastSuccessfulTime);
    int status = (int)fmi2GetRealStatus(s->c, kind, &time);
    LAW(time == s->m.time || s->m.wild, "the last successful time is %.17g, not %.17g", time,
        s->m.time);
    return status;
}

CALL(fmi2GetBooleanStatus, fmi2GetBooleanStatus(s->c, inquiry(fmi2Terminated), (fmi2Boolean *)room))
CALL(fmi2GetStatus, fmi2GetStatus(s->c, inquiry(NONE_KNOWN), (fmi2Status *)room))
CALL(fmi2GetIntegerStatus, fmi2GetIntegerStatus(s->c, inquiry(NONE_KNOWN), (fmi2Integer *)room))
CALL(fmi2GetStringStatus, fmi2GetStringStatus(s->c, inquiry(NONE_KNOWN), (void *)room))

static int run_step(Slot *s)
{
    static const double sizes[] = {0.001, 0.0004, 0.003, 0.01},
                        odd[] = {0,     -0.0, -0.001, NAN,    INFINITY, -INFINITY,
                                 1e308, 2e10, 1e-13,  5e-324, 5e4,      2e5};
    double at = s->m.time, rest = sampled ? limit(&s->m) - at : 0,
           size = sampled ? rest / (1 + below(2)) : sizes[below(4)];
    double misfits[] = {at + 1e-6, at - 0.001, NAN,        INFINITY,  -1.9e9,
                        1.9e9,     1e308,      at + 4e-10, at - 4e-10},
           time = once_in(12) ? misfits[below(9)] : at;
    size = once_in(5)              ? odd[below(12)]
           : sampled && once_in(8) ? rest + period() * (0.1 + below(3))
                                   : size;
    note("%.17g, %.17g", time, size);
    int null = s->version == 3 && once_in(40);
    if (null)
        expect_failure("null pointer");
    else if (!(size >= 0) || !(fabs(time) < LATEST) || !(fabs(time + size) < LATEST) ||
             !(fabs(time - at) < 2e-9 || s->m.wild))
        expect_failure("");
    else if (s->m.set_up == 2 && time + size > s->m.start + RUN + size / 50)
        expect_failure(fabs(time - at) < 2e-9 ? "beyond the stop time" : "");
    else if (doubtful(s))
        expected.given = OPEN;
    else if (sampled && size > rest + 2e-9)
        expect_failure("passes over a sample");
    else if (!sampled && size > 1e7 * block.step)
        expect_failure("integration steps");
    if (size == 0)
        deviates("step of no size");
    fmi3Boolean event = 0, terminate = 0, early = 0;
    fmi3Float64 last = 0;
    if (s->m.state != INTERMEDIATE) {
        s->begin = s->seen = time;
        s->end = time + size;
        s->inner_sets = s->asked = 0;
    }
    int status = s->version == 2 ? (int)fmi2DoStep(s->c, time, size, 1)
                                 : (int)fmi3DoStep(s->c, time, size, 1, &event, &terminate, &early,
                                                   null ? NULL : &last);
    LAW(!event && !terminate && (!early || (s->asked && s->early)), "what the step reports");
    LAW(status != 0 || s->version == 2 || s->m.wild ||
            (early ? last < s->end && last == s->seen : last == s->end),
        "last successful time %.17g", last);
    expected.after = s->m; /* an intermediate update may have set inputs */
    expected.after.time = early ? last : s->end;
    expected.after.samples += sampled && at >= s->m.start + (double)s->m.samples * period() - 1e-9;
    expected.after.wild |= s->m.wild_inputs && block.states.count > 0;
    expected.after.written = 0;
    expected.given = expected.given == GOOD && doubtful(s) ? OPEN : expected.given;
    return status;
}
