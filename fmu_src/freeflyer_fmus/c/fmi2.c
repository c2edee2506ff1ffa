/* FMI 2.0 interface: translates FMI calls to calls of the functions in instance.h. */
#include "fmi2Functions.h"

#include <math.h>
#include <string.h>

#include "instance.h"

/* First line of every FMI function: checks the instance, the state and the arrays. */
#define ALLOW(states, given)                                                        \
    do {                                                                            \
        if (!c || instance_allow((Instance *)c, __func__, (states), (given)) != OK) \
            return fmi2Error;                                                       \
    } while (0)
#define ALIVE (INSTANTIATED | INITIALIZED)

static fmi2Status status(Status s) { return (fmi2Status)s; }

static void send_log_message(Instance *c, Status s, const char *category, const char *text)
{
    fmi2CallbackLogger logger;
    memcpy(&logger, &c->log_target[0], sizeof logger);
    if (logger)
        logger(c->environment, c->name, (fmi2Status)s, category, "%s", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                               const fmi2String categories[])
{
    (void)on; /* failures are always logged, because many importers never enable logging */
    ALLOW(ALIVE, 1);
    if (instance_check_categories(c, categories, n) != OK)
        return fmi2Error;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token,
                              fmi2String resources, const fmi2CallbackFunctions *callbacks,
                              fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    const char *rejection = instance_rejection(name, token, type == fmi2ModelExchange);
    Instance *c = rejection ? NULL : instance_new(name, type == fmi2ModelExchange);
    if (!c && callbacks && callbacks->logger)
        callbacks->logger(callbacks->componentEnvironment, name ? name : "", fmi2Error,
                          "logStatusError", "%s", rejection ? rejection : NO_MEMORY);
    if (!c)
        return NULL;
    if (callbacks) {
        c->environment = callbacks->componentEnvironment;
        memcpy(&c->log_target[0], &callbacks->logger, sizeof callbacks->logger);
        c->log = send_log_message;
    }
    return c;
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance;
    ALLOW(INSTANTIATED, 1);
    return status(instance_set_up(c, start, stop_defined ? (isinf(stop) ? NAN : stop) : INFINITY));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    ALLOW(INSTANTIATED, 1);
    instance_enter_initialization(c);
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ALLOW(INITIALIZATION, 1);
    return status(instance_exit_initialization(c));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    ALLOW(STEP | EVENT | CONTINUOUS, 1);
    ((Instance *)c)->memory->state = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    ALLOW(ALIVE, 1);
    instance_reset(c);
    return fmi2OK;
}

/* Values. FMI 2.0 has only scalars. */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                       fmi2Real value[])
{
    ALLOW(INITIALIZED, n == 0 || (reference && value));
    References list = {reference, n};
    return instance_get(c, list, 0, REAL, value) == OK ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                       const fmi2Real value[])
{
    ALLOW(ALIVE, n == 0 || (reference && value));
    References list = {reference, n};
    Status s = instance_check(c, list, 0, REAL, value);
    if (s == OK)
        instance_put(c, list, 0, value);
    return status(s);
}

static fmi2Status get_integers(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                               int value[], Kind kind)
{
    for (size_t i = 0; i < n; i++) {
        double number;
        References one = {&reference[i], 1};
        if (instance_get(c, one, 0, kind, &number) != OK)
            return fmi2Error;
        value[i] = (int)number;
    }
    return fmi2OK;
}

static double from_integer(int value, Kind kind) { return kind == BOOLEAN ? value != 0 : value; }

static fmi2Status set_integers(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                               const int value[], Kind kind)
{
    for (size_t i = 0; i < n; i++) {
        double number = from_integer(value[i], kind);
        References one = {&reference[i], 1};
        Status s = instance_check(c, one, 0, kind, &number);
        if (s != OK)
            return status(s);
    }
    for (size_t i = 0; i < n; i++) {
        double number = from_integer(value[i], kind);
        References one = {&reference[i], 1};
        instance_put(c, one, 0, &number);
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                          fmi2Integer value[])
{
    ALLOW(INITIALIZED, n == 0 || (reference && value));
    return get_integers(c, reference, n, value, ENUMERATION);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                          fmi2Boolean value[])
{
    ALLOW(INITIALIZED, n == 0 || (reference && value));
    return get_integers(c, reference, n, value, BOOLEAN);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                          const fmi2Integer value[])
{
    ALLOW(ALIVE, n == 0 || (reference && value));
    return set_integers(c, reference, n, value, ENUMERATION);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                          const fmi2Boolean value[])
{
    ALLOW(ALIVE, n == 0 || (reference && value));
    return set_integers(c, reference, n, value, BOOLEAN);
}

static fmi2Status none(fmi2Component c, size_t n, const char *what)
{
    return n == 0 ? fmi2OK : status(instance_unsupported(c, what));
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                         fmi2String value[])
{
    (void)reference, (void)value;
    ALLOW(INITIALIZED, 1);
    return none(c, n, "string variables");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference reference[], size_t n,
                         const fmi2String value[])
{
    (void)reference, (void)value;
    ALLOW(ALIVE, 1);
    return none(c, n, "string variables");
}

/* Saved states */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    ALLOW(ALIVE, saved != NULL);
    return status(instance_save(c, saved));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    ALLOW(ALIVE, saved != NULL);
    return status(instance_restore(c, saved));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    ALLOW(ALIVE, 1);
    if (saved)
        instance_free_saved(saved);
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    ALLOW(ALIVE, saved && size);
    *size = instance_serialized_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    ALLOW(ALIVE, saved && bytes);
    return status(instance_serialize(c, saved, bytes, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *saved)
{
    ALLOW(ALIVE, bytes && saved);
    return status(instance_deserialize(c, bytes, size, saved));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                        size_t nu, const fmi2ValueReference known[], size_t nk,
                                        const fmi2Real dk[], fmi2Real du[])
{
    ALLOW(INITIALIZED, (nu == 0 || (unknown && du)) && (nk == 0 || (known && dk)));
    References unknowns = {unknown, nu}, knowns = {known, nk};
    return status(instance_sensitivity(c, unknowns, knowns, 0, 0, dk, nk, du, nu));
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    ALLOW(CONTINUOUS | EVENT | MODEL_EXCHANGE, 1);
    ((Instance *)c)->memory->state = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    ALLOW(EVENT | MODEL_EXCHANGE, info != NULL);
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    ALLOW(EVENT | MODEL_EXCHANGE, 1);
    ((Instance *)c)->memory->state = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state,
                                       fmi2Boolean *enter_event, fmi2Boolean *terminate)
{
    (void)no_set_state;
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, enter_event && terminate);
    *enter_event = fmi2False;
    *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ALLOW(EVENT | CONTINUOUS | MODEL_EXCHANGE, 1);
    return status(instance_set_time(c, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    ALLOW(CONTINUOUS | MODEL_EXCHANGE, n == 0 || x);
    return status(instance_set_states(c, x, n));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    ALLOW(INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | MODEL_EXCHANGE, n == 0 || dx);
    return status(instance_get_rates(c, dx, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    (void)indicators;
    ALLOW(INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | MODEL_EXCHANGE, 1);
    return none(c, n, "event indicators");
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    ALLOW(INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | MODEL_EXCHANGE, n == 0 || x);
    return status(instance_get_states(c, x, n));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    ALLOW(INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | TERMINATED | MODEL_EXCHANGE,
          n == 0 || nominals);
    return status(instance_get_nominals(c, nominals, n));
}

/* Co-simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference reference[],
                                       size_t n, const fmi2Integer order[], const fmi2Real value[])
{
    (void)reference, (void)order, (void)value;
    ALLOW(INSTANTIATED | INITIALIZATION | STEP, 1);
    return none(c, n, "input derivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference reference[],
                                        size_t n, const fmi2Integer order[], fmi2Real value[])
{
    (void)reference, (void)order, (void)value;
    ALLOW(STEP | TERMINATED, 1);
    return none(c, n, "output derivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state)
{
    (void)no_set_state;
    ALLOW(STEP, 1);
    return status(instance_step(c, time, size));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    ALLOW(STEP, 1);
    return status(instance_unsupported(c, "asynchronous steps to cancel"));
}

/* When fmi2DoStep returns, the step is complete. Therefore there is no status of a pending step.
   Only fmi2LastSuccessfulTime and fmi2Terminated can be read. */

#define NO_PENDING_STATUS(Name, Type)                                        \
    fmi2Status Name(fmi2Component c, const fmi2StatusKind kind, Type *value) \
    {                                                                        \
        (void)kind;                                                          \
        ALLOW(STEP | TERMINATED, value != NULL);                             \
        return fmi2Discard;                                                  \
    }

NO_PENDING_STATUS(fmi2GetStatus, fmi2Status)
NO_PENDING_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_PENDING_STATUS(fmi2GetStringStatus, fmi2String)

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    ALLOW(STEP | TERMINATED, value != NULL);
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Instance *)c)->memory->clock;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    ALLOW(STEP | TERMINATED, value != NULL);
    if (kind != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}
