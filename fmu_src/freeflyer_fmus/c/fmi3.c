/* FMI 3.0 interface: translates FMI calls to calls of the functions in instance.h. */
#include "fmi3Functions.h"

#include <math.h>
#include <string.h>

#include "instance.h"

/* First line of every FMI function: checks the instance, the state and the arrays. */
#define ALLOW(states, given)                                                        \
    do {                                                                            \
        if (!c || instance_allow((Instance *)c, __func__, (states), (given)) != OK) \
            return fmi3Error;                                                       \
    } while (0)
#define ALIVE (INSTANTIATED | INITIALIZED)
#define BETWEEN (ALIVE & ~INTERMEDIATE) /* not during an intermediate update */

static fmi3Status status(Status s) { return (fmi3Status)s; }

static void send_log_message(Instance *c, Status s, const char *category, const char *text)
{
    fmi3LogMessageCallback logger;
    memcpy(&logger, &c->log_target[0], sizeof logger);
    if (logger)
        logger(c->environment, (fmi3Status)s, category, text);
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n,
                               const fmi3String categories[])
{
    (void)on; /* failures are always logged, because many importers never enable logging */
    ALLOW(BETWEEN, 1);
    if (instance_check_categories(c, categories, n) != OK)
        return fmi3Error;
    return fmi3OK;
}

static Instance *instantiate(fmi3String name, fmi3String token, int model_exchange,
                             fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    const char *rejection = instance_rejection(name, token, model_exchange);
    Instance *c = rejection ? NULL : instance_new(name, model_exchange);
    if (!c && logger)
        logger(environment, fmi3Error, "logStatusError", rejection ? rejection : NO_MEMORY);
    if (!c)
        return NULL;
    c->environment = environment;
    memcpy(&c->log_target[0], &logger, sizeof logger);
    c->log = send_log_message;
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger)
{
    (void)resources, (void)visible, (void)logging;
    return instantiate(name, token, 1, environment, logger);
}

static int update_importer(Instance *c, double time)
{
    fmi3IntermediateUpdateCallback callback;
    memcpy(&callback, &c->update_target[0], sizeof callback);
    fmi3Boolean early = false;
    fmi3Float64 early_time = time;
    callback(c->environment, time, true, true, true, c->may_return_early != 0, &early, &early_time);
    return early && c->may_return_early;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback callback)
{
    (void)resources, (void)visible, (void)logging, (void)intermediate, (void)n;
    if (event_mode) {
        if (logger)
            logger(environment, fmi3Error, "logStatusError",
                   "this FMU has no event mode in co-simulation");
        return NULL;
    }
    Instance *c = instantiate(name, token, 0, environment, logger);
    if (c && callback) {
        memcpy(&c->update_target[0], &callback, sizeof callback);
        c->intermediate_update = update_importer;
        c->may_return_early = early_return;
    }
    return c;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
    fmi3ClockUpdateCallback clock_update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)clock_update,
        (void)lock, (void)unlock;
    if (logger)
        logger(environment, fmi3Error, "logStatusError", "this FMU has no scheduled execution");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c)
{
    /* During an intermediate update, the instance is not freed, because the running step still uses
       it. */
    if (c && instance_allow((Instance *)c, __func__, BETWEEN, 1) == OK)
        instance_free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined,
                                       fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance;
    ALLOW(INSTANTIATED, 1);
    if (instance_set_up(c, start, stop_defined ? (isinf(stop) ? NAN : stop) : INFINITY) != OK)
        return fmi3Error;
    instance_enter_initialization(c);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    ALLOW(INITIALIZATION, 1);
    return status(instance_exit_initialization(c));
}

fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, 1);
    ((Instance *)c)->memory->state = EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    ALLOW(STEP | EVENT | CONTINUOUS, 1);
    ((Instance *)c)->memory->state = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    ALLOW(BETWEEN, 1);
    instance_reset(c);
    return fmi3OK;
}

/* Values. A value reference denotes a whole array. */

/* Returns OK if the variables with these value references have n elements in total. */
static Status check_elements(Instance *c, const fmi3ValueReference reference[], size_t nr, size_t n)
{
    size_t elements = 0;
    for (size_t i = 0; i < nr; i++) {
        int extent = instance_extent(reference[i]);
        elements += (size_t)extent;
        if (extent > 0)
            continue;
        message_begin(&c->message, "value reference ");
        message_add_number(&c->message, reference[i]);
        message_add(&c->message, " is not a variable of this FMU");
        return instance_report(c, ERROR, "logStatusError");
    }
    if (elements == n)
        return OK;
    message_begin(&c->message, "the variables have ");
    message_add_number(&c->message, (double)elements);
    message_add(&c->message, " elements in total, not ");
    message_add_number(&c->message, (double)n);
    return instance_report(c, ERROR, "logStatusError");
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference reference[], size_t nr,
                          fmi3Float64 value[], size_t n)
{
    ALLOW(INITIALIZED, (nr == 0 || reference) && (n == 0 || value));
    if (check_elements(c, reference, nr, n) != OK)
        return fmi3Error;
    References list = {reference, nr};
    return instance_get(c, list, 1, REAL, value) == OK ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference reference[], size_t nr,
                          const fmi3Float64 value[], size_t n)
{
    ALLOW(ALIVE, (nr == 0 || reference) && (n == 0 || value));
    if (check_elements(c, reference, nr, n) != OK)
        return fmi3Error;
    References list = {reference, nr};
    Status s = instance_check(c, list, 1, REAL, value);
    if (s == OK)
        instance_put(c, list, 1, value);
    return status(s);
}

/* Enumerations and Booleans are scalars in this runtime. */

#define SCALARS(Type, kind, FROM)                                                     \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, \
                             fmi3##Type value[], size_t n)                            \
    {                                                                                 \
        ALLOW(INITIALIZED, (nr == 0 || r) && (n == 0 || value));                      \
        if (check_elements(c, r, nr, n) != OK)                                        \
            return fmi3Error;                                                         \
        for (size_t i = 0; i < nr; i++) {                                             \
            double number;                                                            \
            References one = {&r[i], 1};                                              \
            if (instance_get(c, one, 1, kind, &number) != OK)                         \
                return fmi3Error;                                                     \
            value[i] = (fmi3##Type)number;                                            \
        }                                                                             \
        return fmi3OK;                                                                \
    }                                                                                 \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, \
                             const fmi3##Type value[], size_t n)                      \
    {                                                                                 \
        ALLOW(ALIVE, (nr == 0 || r) && (n == 0 || value));                            \
        if (check_elements(c, r, nr, n) != OK)                                        \
            return fmi3Error;                                                         \
        for (size_t i = 0; i < nr; i++) {                                             \
            double number = FROM(value[i]);                                           \
            References one = {&r[i], 1};                                              \
            Status s = instance_check(c, one, 1, kind, &number);                      \
            if (s != OK)                                                              \
                return status(s);                                                     \
        }                                                                             \
        for (size_t i = 0; i < nr; i++) {                                             \
            double number = FROM(value[i]);                                           \
            References one = {&r[i], 1};                                              \
            instance_put(c, one, 1, &number);                                         \
        }                                                                             \
        return fmi3OK;                                                                \
    }

#define FROM_INTEGER(value) (double)(value)
#define FROM_BOOLEAN(value) ((value) ? 1.0 : 0.0)
SCALARS(Int64, ENUMERATION, FROM_INTEGER)
SCALARS(Boolean, BOOLEAN, FROM_BOOLEAN)

/* Types and functions that are not supported. */

static fmi3Status none(fmi3Instance c, size_t n, const char *what)
{
    return n == 0 ? fmi3OK : status(instance_unsupported(c, what));
}

#define NO_TYPE(Type)                                                                 \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, \
                             fmi3##Type value[], size_t n)                            \
    {                                                                                 \
        (void)r, (void)value, (void)n;                                                \
        ALLOW(INITIALIZED, 1);                                                        \
        return none(c, nr, #Type " variables");                                       \
    }                                                                                 \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, \
                             const fmi3##Type value[], size_t n)                      \
    {                                                                                 \
        (void)r, (void)value, (void)n;                                                \
        ALLOW(ALIVE, 1);                                                              \
        return none(c, nr, #Type " variables");                                       \
    }

NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(UInt64)
NO_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t nr, size_t sizes[],
                         fmi3Binary value[], size_t n)
{
    (void)r, (void)sizes, (void)value, (void)n;
    ALLOW(INITIALIZED, 1);
    return none(c, nr, "Binary variables");
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t nr,
                         const size_t sizes[], const fmi3Binary value[], size_t n)
{
    (void)r, (void)sizes, (void)value, (void)n;
    ALLOW(ALIVE, 1);
    return none(c, nr, "Binary variables");
}

#define NO_CLOCK(Name, ...) \
    fmi3Status Name(fmi3Instance c, const fmi3ValueReference r[], size_t n, __VA_ARGS__)
#define NO_CLOCK_BODY(...)           \
    {                                \
        (void)r, __VA_ARGS__;        \
        ALLOW(ALIVE, 1);             \
        return none(c, n, "clocks"); \
    }

NO_CLOCK(fmi3GetClock, fmi3Clock a[])
NO_CLOCK_BODY((void)a)
NO_CLOCK(fmi3SetClock, const fmi3Clock a[])
NO_CLOCK_BODY((void)a)
NO_CLOCK(fmi3GetIntervalDecimal, fmi3Float64 a[], fmi3IntervalQualifier b[])
NO_CLOCK_BODY((void)a, (void)b)
NO_CLOCK(fmi3GetIntervalFraction, fmi3UInt64 a[], fmi3UInt64 b[], fmi3IntervalQualifier d[])
NO_CLOCK_BODY((void)a, (void)b, (void)d)
NO_CLOCK(fmi3GetShiftDecimal, fmi3Float64 a[])
NO_CLOCK_BODY((void)a)
NO_CLOCK(fmi3GetShiftFraction, fmi3UInt64 a[], fmi3UInt64 b[])
NO_CLOCK_BODY((void)a, (void)b)
NO_CLOCK(fmi3SetIntervalDecimal, const fmi3Float64 a[])
NO_CLOCK_BODY((void)a)
NO_CLOCK(fmi3SetIntervalFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
NO_CLOCK_BODY((void)a, (void)b)
NO_CLOCK(fmi3SetShiftDecimal, const fmi3Float64 a[])
NO_CLOCK_BODY((void)a)
NO_CLOCK(fmi3SetShiftFraction, const fmi3UInt64 a[], const fmi3UInt64 b[])
NO_CLOCK_BODY((void)a, (void)b)

/* Reports an unsupported feature. The call is allowed in every state. */
static fmi3Status absent(fmi3Instance c, const char *what)
{
    return c ? status(instance_unsupported(c, what)) : fmi3Error;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t *n)
{
    (void)r, (void)n;
    return absent(c, "variable dependencies at run time");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t rows[],
                                       fmi3ValueReference r[], size_t columns[],
                                       fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent, (void)rows, (void)r, (void)columns, (void)kinds, (void)n;
    return absent(c, "variable dependencies at run time");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c)
{
    return absent(c, "structural parameters to configure");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c)
{
    return absent(c, "structural parameters to configure");
}

fmi3Status fmi3EnterStepMode(fmi3Instance c) { return absent(c, "event mode in co-simulation"); }

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return absent(c, "scheduled execution");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference r[], size_t nr,
                                    const fmi3Int32 orders[], fmi3Float64 value[], size_t n)
{
    (void)r, (void)orders, (void)value, (void)n;
    ALLOW(STEP | INTERMEDIATE | TERMINATED, 1);
    return none(c, nr, "output derivatives");
}

/* Derivatives */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[],
                                        size_t nu, const fmi3ValueReference known[], size_t nk,
                                        const fmi3Float64 seed[], size_t ns,
                                        fmi3Float64 sensitivity[], size_t nv)
{
    ALLOW(INITIALIZED & ~INTERMEDIATE, (nu == 0 || unknown) && (nk == 0 || known) &&
                                           (ns == 0 || seed) && (nv == 0 || sensitivity));
    References unknowns = {unknown, nu}, knowns = {known, nk};
    return status(instance_sensitivity(c, unknowns, knowns, 1, 0, seed, ns, sensitivity, nv));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t nu,
                                    const fmi3ValueReference known[], size_t nk,
                                    const fmi3Float64 seed[], size_t ns, fmi3Float64 sensitivity[],
                                    size_t nv)
{
    ALLOW(INITIALIZED & ~INTERMEDIATE, (nu == 0 || unknown) && (nk == 0 || known) &&
                                           (ns == 0 || seed) && (nv == 0 || sensitivity));
    References unknowns = {unknown, nu}, knowns = {known, nk};
    return status(instance_sensitivity(c, unknowns, knowns, 1, 1, seed, ns, sensitivity, nv));
}

/* Saved states */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *saved)
{
    ALLOW(BETWEEN, saved != NULL);
    return status(instance_save(c, saved));
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState saved)
{
    ALLOW(BETWEEN, saved != NULL);
    return status(instance_restore(c, saved));
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *saved)
{
    ALLOW(ALIVE, 1);
    if (saved)
        instance_free_saved(saved);
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState saved, size_t *size)
{
    ALLOW(BETWEEN, saved && size);
    *size = instance_serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState saved, fmi3Byte bytes[], size_t size)
{
    ALLOW(BETWEEN, saved && bytes);
    return status(instance_serialize(c, saved, bytes, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState *saved)
{
    ALLOW(BETWEEN, bytes && saved);
    return status(instance_deserialize(c, bytes, size, saved));
}

/* Model exchange */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c)
{
    ALLOW(INITIALIZATION | EVENT, 1);
    return fmi3OK; /* this FMU has no discrete states to update */
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate,
                                    fmi3Boolean *nominals_changed, fmi3Boolean *states_changed,
                                    fmi3Boolean *next_event_defined, fmi3Float64 *next_event)
{
    ALLOW(EVENT | MODEL_EXCHANGE, again && terminate && nominals_changed && states_changed &&
                                      next_event_defined && next_event);
    *again = *terminate = *nominals_changed = *states_changed = *next_event_defined = false;
    *next_event = 0;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
    ALLOW(EVENT | MODEL_EXCHANGE, 1);
    ((Instance *)c)->memory->state = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set_state,
                                       fmi3Boolean *enter_event, fmi3Boolean *terminate)
{
    (void)no_set_state;
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, enter_event && terminate);
    *enter_event = *terminate = false;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, 1);
    return status(instance_set_time(c, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, n == 0 || x);
    return status(instance_set_states(c, x, n));
}

#define SOLVED (INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | MODEL_EXCHANGE)

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n)
{
    ALLOW(SOLVED, n == 0 || dx);
    return status(instance_get_rates(c, dx, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n)
{
    (void)indicators;
    ALLOW(SOLVED, 1);
    return none(c, n, "event indicators");
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n)
{
    ALLOW(SOLVED, n == 0 || x);
    return status(instance_get_states(c, x, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n)
{
    ALLOW(SOLVED, n == 0 || nominals);
    return status(instance_get_nominals(c, nominals, n));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    ALLOW(INSTANTIATED | SOLVED, n != NULL);
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    ALLOW(INSTANTIATED | SOLVED, n != NULL);
    *n = (size_t)block.states.count;
    return fmi3OK;
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set_state,
                      fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
                      fmi3Float64 *last_time)
{
    (void)no_set_state;
    ALLOW(STEP, event && terminate && early && last_time);
    Status s = instance_step(c, time, size);
    *event = *terminate = false;
    *last_time = ((Instance *)c)->memory->clock;
    *early = s == OK && *last_time < time + size;
    return status(s);
}
