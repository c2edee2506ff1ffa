/* FMI 2.0: the binary interface, and nothing else. */
#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

#include "instance.h"

#define ANY_MODE (INITIALIZATION | STEP | EVENT | CONTINUOUS | TERMINATED | FAILED)
#define ALLOW(instance, states)                                                \
    do {                                                                       \
        if (!(instance))                                                       \
            return fmi2Error;                                                  \
        if (instance_allow((instance), __func__, (states)) != OK)              \
            return fmi2Error;                                                  \
    } while (0)

static fmi2Status status(Status s) { return (fmi2Status)s; }

static void say(Instance *c, Status s, const char *category, const char *text)
{
    fmi2CallbackLogger logger;
    memcpy(&logger, &c->log_target[0], sizeof logger);
    if (logger && (c->logging || s != OK))
        logger(c->environment, c->name, (fmi2Status)s, category, "%s", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)n, (void)categories;
    if (!c)
        return fmi2Error;
    ((Instance *)c)->logging = on;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible;
    if (type == fmi2ModelExchange && block.period >= 0)
        return NULL;
    Instance *c = instance_new(name, token, type == fmi2ModelExchange);
    if (!c && name && callbacks && callbacks->logger)
        callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError", "%s", INSTANCE_NOT_MADE);
    if (!c)
        return NULL;
    c->logging = logging;
    if (callbacks) {
        c->environment = callbacks->componentEnvironment;
        memcpy(&c->log_target[0], &callbacks->logger, sizeof callbacks->logger);
        c->log = say;
    }
    return c;
}

void fmi2FreeInstance(fmi2Component c) { instance_free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop)
{
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop;
    ALLOW((Instance *)c, INSTANTIATED);
    ((Instance *)c)->memory->clock = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    ALLOW((Instance *)c, INSTANTIATED);
    return status(instance_enter_initialization(c, ((Instance *)c)->memory->clock));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ALLOW((Instance *)c, INITIALIZATION);
    return status(instance_exit_initialization(c));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    ALLOW((Instance *)c, STEP | EVENT | CONTINUOUS | FAILED);
    ((Instance *)c)->memory->state = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    if (!c)
        return fmi2Error;
    instance_reset(c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference reference[], size_t n, fmi2Real value[])
{
    ALLOW((Instance *)c, ANY_MODE);
    for (size_t i = 0; i < n; i++)
        if (instance_get(c, reference[i], REAL, 1, &value[i]) != OK)
            return fmi2Error;
    return fmi2OK;
}

static fmi2Status get_integers(fmi2Component c, const fmi2ValueReference reference[], size_t n, int value[], Kind kind)
{
    for (size_t i = 0; i < n; i++) {
        double number;
        if (instance_get(c, reference[i], kind, 1, &number) != OK)
            return fmi2Error;
        value[i] = (int)number;
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference reference[], size_t n, fmi2Integer value[])
{
    ALLOW((Instance *)c, ANY_MODE);
    return get_integers(c, reference, n, value, ENUMERATION);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference reference[], size_t n, fmi2Boolean value[])
{
    ALLOW((Instance *)c, ANY_MODE);
    return get_integers(c, reference, n, value, BOOLEAN);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2Real value[])
{
    if (!c)
        return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        Status s = instance_set(c, reference[i], REAL, 1, &value[i]);
        if (s != OK)
            return status(s);
    }
    return fmi2OK;
}

static fmi2Status set_integers(fmi2Component c, const fmi2ValueReference reference[], size_t n, const int value[], Kind kind)
{
    if (!c)
        return fmi2Error;
    for (size_t i = 0; i < n; i++) {
        double number = kind == BOOLEAN ? value[i] != 0 : value[i];
        Status s = instance_set(c, reference[i], kind, 1, &number);
        if (s != OK)
            return status(s);
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2Integer value[])
{
    return set_integers(c, reference, n, value, ENUMERATION);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2Boolean value[])
{
    return set_integers(c, reference, n, value, BOOLEAN);
}

static fmi2Status no_variables(fmi2Component c, size_t n, const char *what)
{
    if (!c)
        return fmi2Error;
    if (n == 0)
        return fmi2OK;
    message_begin(&((Instance *)c)->message, "this FMU has no ");
    message_add(&((Instance *)c)->message, what);
    return status(instance_say(c, ERROR, "logStatusError"));
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference reference[], size_t n, fmi2String value[])
{
    (void)reference, (void)value;
    return no_variables(c, n, "string variables");
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2String value[])
{
    (void)reference, (void)value;
    return no_variables(c, n, "string variables");
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    if (!c || !saved)
        return fmi2Error;
    if (!*saved)
        *saved = malloc(instance_memory_size());
    if (!*saved)
        return fmi2Error;
    memcpy(*saved, ((Instance *)c)->memory, instance_memory_size());
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate saved)
{
    if (!c || !saved)
        return fmi2Error;
    memcpy(((Instance *)c)->memory, saved, instance_memory_size());
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *saved)
{
    (void)c;
    if (saved) {
        free(*saved);
        *saved = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate saved, size_t *size)
{
    if (!c || !saved || !size)
        return fmi2Error;
    *size = instance_memory_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate saved, fmi2Byte bytes[], size_t size)
{
    if (!c || !saved || size != instance_memory_size())
        return fmi2Error;
    memcpy(bytes, saved, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *saved)
{
    if (!c || !saved || size != instance_memory_size())
        return fmi2Error;
    if (!*saved)
        *saved = malloc(size);
    if (!*saved)
        return fmi2Error;
    memcpy(*saved, bytes, size);
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t nu,
                                        const fmi2ValueReference known[], size_t nk, const fmi2Real dk[], fmi2Real du[])
{
    (void)unknown, (void)nu, (void)known, (void)nk, (void)dk, (void)du;
    return no_variables(c, 1, "directional derivatives (it does not advertise them)");
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    ALLOW((Instance *)c, CONTINUOUS | EVENT);
    ((Instance *)c)->memory->state = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    ALLOW((Instance *)c, EVENT);
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    ALLOW((Instance *)c, EVENT);
    ((Instance *)c)->memory->state = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *enter_event, fmi2Boolean *terminate)
{
    (void)no_set_state;
    ALLOW((Instance *)c, CONTINUOUS);
    *enter_event = fmi2False;
    *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ALLOW((Instance *)c, EVENT | CONTINUOUS);
    instance_set_time(c, time);
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    ALLOW((Instance *)c, CONTINUOUS | EVENT);
    return status(instance_set_states(c, x, n));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    return status(instance_get_rates(c, dx, n));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t n)
{
    (void)indicators;
    return no_variables(c, n, "event indicators");
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    return status(instance_get_states(c, x, n));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominals[], size_t n)
{
    ALLOW((Instance *)c, ANY_MODE);
    for (size_t i = 0; i < n; i++)
        nominals[i] = 1.0;
    return fmi2OK;
}

/* Co-simulation */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[])
{
    (void)reference, (void)order, (void)value;
    return no_variables(c, n, "input derivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference reference[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[])
{
    (void)reference, (void)order, (void)value;
    return no_variables(c, n, "output derivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_set_state)
{
    (void)no_set_state;
    ALLOW((Instance *)c, STEP);
    return status(instance_step(c, time, size));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return no_variables(c, 1, "asynchronous steps to cancel");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
    return no_variables(c, 1, "asynchronous status") == fmi2OK ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (!c)
        return fmi2Error;
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Instance *)c)->memory->clock;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (!c)
        return fmi2Error;
    if (kind != fmi2Terminated)
        return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
