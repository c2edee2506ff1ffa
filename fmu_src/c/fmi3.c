/* FMI 3.0: the binary interface, and nothing else. */
#include "fmi3Functions.h"

#include <stdlib.h>
#include <string.h>

#include "instance.h"

#define ANY_MODE (INITIALIZATION | STEP | EVENT | CONTINUOUS | TERMINATED | FAILED)
#define ALLOW(instance, states)                                                \
    do {                                                                       \
        if (!(instance))                                                       \
            return fmi3Error;                                                  \
        if (instance_allow((instance), __func__, (states)) != OK)              \
            return fmi3Error;                                                  \
    } while (0)

static fmi3Status status(Status s) { return (fmi3Status)s; }

static void say(Instance *c, Status s, const char *category, const char *text)
{
    fmi3LogMessageCallback logger;
    memcpy(&logger, &c->log_target[0], sizeof logger);
    if (logger && (c->logging || s != OK))
        logger(c->environment, (fmi3Status)s, category, text);
}

static fmi3Status absent(fmi3Instance c, const char *what)
{
    if (!c)
        return fmi3Error;
    message_begin(&((Instance *)c)->message, "this FMU has no ");
    message_add(&((Instance *)c)->message, what);
    return status(instance_say(c, ERROR, "logStatusError"));
}

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)n, (void)categories;
    if (!c)
        return fmi3Error;
    ((Instance *)c)->logging = on;
    return fmi3OK;
}

static Instance *instantiate(fmi3String name, fmi3String token, int model_exchange, fmi3Boolean logging,
                             fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    if (model_exchange && block.period >= 0)
        return NULL;
    Instance *c = instance_new(name, token, model_exchange);
    if (!c && logger)
        logger(environment, fmi3Error, "logStatusError", INSTANCE_NOT_MADE);
    if (!c)
        return NULL;
    c->logging = logging;
    c->environment = environment;
    memcpy(&c->log_target[0], &logger, sizeof logger);
    c->log = say;
    return c;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger)
{
    (void)resources, (void)visible;
    return instantiate(name, token, 1, logging, environment, logger);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate[], size_t n, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback logger, fmi3IntermediateUpdateCallback update)
{
    (void)resources, (void)visible, (void)event_mode, (void)early_return, (void)intermediate, (void)n, (void)update;
    return instantiate(name, token, 0, logging, environment, logger);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                               fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback logger, fmi3ClockUpdateCallback clock_update,
                                               fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging;
    (void)environment, (void)logger, (void)clock_update, (void)lock, (void)unlock;
    return NULL;
}

void fmi3FreeInstance(fmi3Instance c) { instance_free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ALLOW((Instance *)c, INSTANTIATED);
    return status(instance_enter_initialization(c, start));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    ALLOW((Instance *)c, INITIALIZATION);
    return status(instance_exit_initialization(c));
}

fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    ALLOW((Instance *)c, CONTINUOUS | EVENT);
    ((Instance *)c)->memory->state = EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance c)
{
    ALLOW((Instance *)c, STEP | EVENT | CONTINUOUS | FAILED);
    ((Instance *)c)->memory->state = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
    if (!c)
        return fmi3Error;
    instance_reset(c);
    return fmi3OK;
}

/* The elements of the variable that begins at `reference`, if they still fit into the caller's array. */
static Status elements(Instance *c, fmi3ValueReference reference, size_t room, int *n)
{
    *n = instance_extent(reference);
    if (*n > 0 && (size_t)*n <= room)
        return OK;
    message_begin(&c->message, "value reference ");
    message_add_number(&c->message, reference);
    message_add(&c->message, *n > 0 ? " has more elements than there are values" : " is not a variable of this FMU");
    return instance_say(c, ERROR, "logStatusError");
}

static Status all_used(Instance *c, size_t used, size_t n)
{
    if (used == n)
        return OK;
    message_begin(&c->message, "the variables have ");
    message_add_number(&c->message, (double)used);
    message_add(&c->message, " elements in all, not ");
    message_add_number(&c->message, (double)n);
    return instance_say(c, ERROR, "logStatusError");
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference reference[], size_t nr, fmi3Float64 value[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    size_t used = 0;
    for (size_t i = 0; i < nr; i++) {
        int count;
        if (elements(c, reference[i], n - used, &count) != OK || instance_get(c, reference[i], REAL, count, value + used) != OK)
            return fmi3Error;
        used += (size_t)count;
    }
    return status(all_used(c, used, n));
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference reference[], size_t nr, const fmi3Float64 value[], size_t n)
{
    if (!c)
        return fmi3Error;
    size_t used = 0;
    for (size_t i = 0; i < nr; i++) {
        int count;
        if (elements(c, reference[i], n - used, &count) != OK)
            return fmi3Error;
        Status s = instance_set(c, reference[i], REAL, count, value + used);
        if (s != OK)
            return status(s);
        used += (size_t)count;
    }
    return status(all_used(c, used, n));
}

/* Enumerations and Booleans of this runtime are scalars. */

#define SCALARS(Type, kind, FROM)                                                                                              \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, fmi3##Type value[], size_t n)            \
    {                                                                                                                          \
        ALLOW((Instance *)c, ANY_MODE);                                                                                        \
        for (size_t i = 0; i < nr && i < n; i++) {                                                                             \
            double number;                                                                                                     \
            if (instance_get(c, r[i], kind, 1, &number) != OK)                                                                 \
                return fmi3Error;                                                                                              \
            value[i] = (fmi3##Type)number;                                                                                     \
        }                                                                                                                      \
        return status(all_used(c, nr, n));                                                                                     \
    }                                                                                                                          \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, const fmi3##Type value[], size_t n)      \
    {                                                                                                                          \
        if (!c)                                                                                                                \
            return fmi3Error;                                                                                                  \
        for (size_t i = 0; i < nr && i < n; i++) {                                                                             \
            double number = FROM(value[i]);                                                                                    \
            Status s = instance_set(c, r[i], kind, 1, &number);                                                                \
            if (s != OK)                                                                                                       \
                return status(s);                                                                                              \
        }                                                                                                                      \
        return status(all_used(c, nr, n));                                                                                     \
    }

#define FROM_INTEGER(value) (double)(value)
#define FROM_BOOLEAN(value) ((value) ? 1.0 : 0.0)
SCALARS(Int64, ENUMERATION, FROM_INTEGER)
SCALARS(Boolean, BOOLEAN, FROM_BOOLEAN)

/* Types and functions that no block has. */

#define NO_TYPE(Type)                                                                                                          \
    fmi3Status fmi3Get##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, fmi3##Type value[], size_t n)            \
    {                                                                                                                          \
        (void)r, (void)value, (void)n;                                                                                         \
        return nr == 0 ? fmi3OK : absent(c, #Type " variables");                                                               \
    }                                                                                                                          \
    fmi3Status fmi3Set##Type(fmi3Instance c, const fmi3ValueReference r[], size_t nr, const fmi3##Type value[], size_t n)      \
    {                                                                                                                          \
        (void)r, (void)value, (void)n;                                                                                         \
        return nr == 0 ? fmi3OK : absent(c, #Type " variables");                                                               \
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

fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t nr, size_t sizes[], fmi3Binary value[], size_t n)
{
    (void)r, (void)sizes, (void)value, (void)n;
    return nr == 0 ? fmi3OK : absent(c, "Binary variables");
}

fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t nr, const size_t sizes[], const fmi3Binary value[],
                         size_t n)
{
    (void)r, (void)sizes, (void)value, (void)n;
    return nr == 0 ? fmi3OK : absent(c, "Binary variables");
}

fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t nr, fmi3Clock value[])
{
    (void)r, (void)value;
    return nr == 0 ? fmi3OK : absent(c, "clocks");
}

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t nr, const fmi3Clock value[])
{
    (void)r, (void)value;
    return nr == 0 ? fmi3OK : absent(c, "clocks");
}

#define NO_CLOCK_2(Name, A, B)                                                                                                 \
    fmi3Status Name(fmi3Instance c, const fmi3ValueReference r[], size_t n, A a[], B b[])                                      \
    {                                                                                                                          \
        (void)r, (void)n, (void)a, (void)b;                                                                                    \
        return absent(c, "clocks");                                                                                            \
    }
#define NO_CLOCK_1(Name, A)                                                                                                    \
    fmi3Status Name(fmi3Instance c, const fmi3ValueReference r[], size_t n, A a[])                                             \
    {                                                                                                                          \
        (void)r, (void)n, (void)a;                                                                                             \
        return absent(c, "clocks");                                                                                            \
    }

NO_CLOCK_2(fmi3GetIntervalDecimal, fmi3Float64, fmi3IntervalQualifier)
NO_CLOCK_1(fmi3GetShiftDecimal, fmi3Float64)
NO_CLOCK_2(fmi3GetShiftFraction, fmi3UInt64, fmi3UInt64)
NO_CLOCK_1(fmi3SetIntervalDecimal, const fmi3Float64)
NO_CLOCK_2(fmi3SetIntervalFraction, const fmi3UInt64, const fmi3UInt64)
NO_CLOCK_1(fmi3SetShiftDecimal, const fmi3Float64)
NO_CLOCK_2(fmi3SetShiftFraction, const fmi3UInt64, const fmi3UInt64)

fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 counter[],
                                   fmi3UInt64 resolution[], fmi3IntervalQualifier qualifier[])
{
    (void)r, (void)n, (void)counter, (void)resolution, (void)qualifier;
    return absent(c, "clocks");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference r, size_t *n)
{
    (void)r, (void)n;
    return absent(c, "variable dependencies at run time");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference dependent, size_t rows[], fmi3ValueReference r[],
                                       size_t columns[], fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent, (void)rows, (void)r, (void)columns, (void)kinds, (void)n;
    return absent(c, "variable dependencies at run time");
}

#define NO_DERIVATIVE(Name, what)                                                                                              \
    fmi3Status Name(fmi3Instance c, const fmi3ValueReference unknowns[], size_t nu, const fmi3ValueReference knowns[],         \
                    size_t nk, const fmi3Float64 seed[], size_t ns, fmi3Float64 sensitivity[], size_t nv)                      \
    {                                                                                                                          \
        (void)unknowns, (void)nu, (void)knowns, (void)nk, (void)seed, (void)ns, (void)sensitivity, (void)nv;                   \
        return absent(c, what);                                                                                                \
    }

NO_DERIVATIVE(fmi3GetDirectionalDerivative, "directional derivatives (it does not advertise them)")
NO_DERIVATIVE(fmi3GetAdjointDerivative, "adjoint derivatives (it does not advertise them)")

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return absent(c, "configuration mode"); }

fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return absent(c, "configuration mode"); }

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { return absent(c, "discrete states to evaluate"); }

fmi3Status fmi3EnterStepMode(fmi3Instance c) { return absent(c, "event mode in co-simulation"); }

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference r[], size_t nr, const fmi3Int32 orders[],
                                    fmi3Float64 value[], size_t n)
{
    (void)r, (void)nr, (void)orders, (void)value, (void)n;
    return absent(c, "output derivatives");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock, (void)time;
    return absent(c, "scheduled execution");
}

/* Saved states */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *saved)
{
    if (!c || !saved)
        return fmi3Error;
    if (!*saved)
        *saved = malloc(instance_memory_size());
    if (!*saved)
        return fmi3Error;
    memcpy(*saved, ((Instance *)c)->memory, instance_memory_size());
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState saved)
{
    if (!c || !saved)
        return fmi3Error;
    memcpy(((Instance *)c)->memory, saved, instance_memory_size());
    return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *saved)
{
    (void)c;
    if (saved) {
        free(*saved);
        *saved = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState saved, size_t *size)
{
    if (!c || !saved || !size)
        return fmi3Error;
    *size = instance_memory_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState saved, fmi3Byte bytes[], size_t size)
{
    if (!c || !saved || size != instance_memory_size())
        return fmi3Error;
    memcpy(bytes, saved, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *saved)
{
    if (!c || !saved || size != instance_memory_size())
        return fmi3Error;
    if (!*saved)
        *saved = malloc(size);
    if (!*saved)
        return fmi3Error;
    memcpy(*saved, bytes, size);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals_changed,
                                    fmi3Boolean *states_changed, fmi3Boolean *next_event_defined, fmi3Float64 *next_event)
{
    ALLOW((Instance *)c, EVENT);
    *again = *terminate = *nominals_changed = *states_changed = *next_event_defined = false;
    *next_event = 0;
    return fmi3OK;
}

/* Model exchange */

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c)
{
    ALLOW((Instance *)c, EVENT);
    ((Instance *)c)->memory->state = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set_state, fmi3Boolean *enter_event, fmi3Boolean *terminate)
{
    (void)no_set_state;
    ALLOW((Instance *)c, CONTINUOUS);
    *enter_event = *terminate = false;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    ALLOW((Instance *)c, EVENT | CONTINUOUS);
    instance_set_time(c, time);
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n)
{
    ALLOW((Instance *)c, CONTINUOUS | EVENT);
    return status(instance_set_states(c, x, n));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    return status(instance_get_rates(c, dx, n));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 indicators[], size_t n)
{
    (void)indicators;
    return n == 0 ? fmi3OK : absent(c, "event indicators");
}

fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    return status(instance_get_states(c, x, n));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 nominals[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    for (size_t i = 0; i < n; i++)
        nominals[i] = 1.0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    if (!c)
        return fmi3Error;
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    if (!c)
        return fmi3Error;
    *n = block.period >= 0 ? 0 : (size_t)block.states.count;
    return fmi3OK;
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last_time)
{
    (void)no_set_state;
    ALLOW((Instance *)c, STEP);
    Status s = instance_step(c, time, size);
    *event = *terminate = *early = false;
    *last_time = ((Instance *)c)->memory->clock;
    return status(s);
}

