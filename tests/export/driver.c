/* Calls one statically linked FMU through both interfaces: legal life cycles and illegal calls. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#include "block.h"

#define EXPECT(condition)                                                   \
    do {                                                                    \
        if (!(condition)) {                                                 \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition); \
            exit(1);                                                        \
        }                                                                   \
    } while (0)

static int logged;

static void on_log2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category,
                    fmi2String format, ...)
{
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    (void)e;
    (void)s;
    EXPECT(name && category && strlen(text) > 0);
    logged++;
}

static void on_log3(fmi3InstanceEnvironment e, fmi3Status s, fmi3String category, fmi3String text)
{
    (void)e;
    (void)s;
    EXPECT(category && strlen(text) > 0);
    logged++;
}

static void drive2(const char *token, int sampled)
{
    fmi2CallbackFunctions callbacks = {on_log2, calloc, free, NULL, NULL};
    EXPECT(!fmi2Instantiate("x", fmi2CoSimulation, "wrong token", "", &callbacks, 0, 0));
    EXPECT(!sampled || !fmi2Instantiate("x", fmi2ModelExchange, token, "", &callbacks, 0, 0));
    fmi2Component c = fmi2Instantiate("a name", fmi2CoSimulation, token, "", &callbacks, 0, 0);
    EXPECT(c);
    /* Calls in the wrong state, then a legal initialisation. */
    fmi2Real x;
    fmi2ValueReference references[] = {1, 100000, 4294967295u};
    EXPECT(fmi2DoStep(c, 0, 0.001, 1) == fmi2Error);
    EXPECT(fmi2GetReal(c, references, 1, &x) == fmi2Error);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2Error);
    EXPECT(fmi2SetupExperiment(c, 0, 0, 0, 0, 0) == fmi2OK);
    EXPECT(fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK);
    /* Invalid references and values. */
    EXPECT(fmi2GetReal(c, references + 1, 1, &x) == fmi2Error);
    EXPECT(fmi2GetReal(c, references + 2, 1, &x) == fmi2Error);
    for (int k = 0; k < 400; k++)
        EXPECT(fmi2DoStep(c, k * 0.001, 0.001, 1) == fmi2OK);
    for (fmi2ValueReference r = 0; r < 2000; r++) {
        fmi2Boolean b;
        fmi2Integer i;
        fmi2Status s = fmi2GetReal(c, &r, 1, &x);
        EXPECT(s == fmi2OK || s == fmi2Error);
        s = fmi2GetBoolean(c, &r, 1, &b);
        s = fmi2GetInteger(c, &r, 1, &i);
        x = NAN;
        s = fmi2SetReal(c, &r, 1, &x);
        EXPECT(s == fmi2Discard || s == fmi2Error);
    }
    /* Saved states. */
    fmi2FMUstate saved = NULL, copy = NULL;
    EXPECT(fmi2GetFMUstate(c, &saved) == fmi2OK);
    size_t size;
    EXPECT(fmi2SerializedFMUstateSize(c, saved, &size) == fmi2OK);
    char *bytes = malloc(size);
    EXPECT(fmi2SerializeFMUstate(c, saved, bytes, size) == fmi2OK);
    EXPECT(fmi2SerializeFMUstate(c, saved, bytes, size - 1) == fmi2Error);
    EXPECT(fmi2DeSerializeFMUstate(c, bytes, size, &copy) == fmi2OK);
    EXPECT(fmi2DoStep(c, 0.4, 0.001, 1) == fmi2OK);
    EXPECT(fmi2SetFMUstate(c, copy) == fmi2OK);
    EXPECT(fmi2DoStep(c, 0.4, 0.001, 1) == fmi2OK);
    free(bytes);
    EXPECT(fmi2FreeFMUstate(c, &saved) == fmi2OK && fmi2FreeFMUstate(c, &copy) == fmi2OK &&
           !saved && !copy);
    /* Wrong times and sizes of steps; reset; stop time. */
    EXPECT(fmi2DoStep(c, 7.0, 0.001, 1) == fmi2Error);
    EXPECT(fmi2DoStep(c, 0.401, 0.001, 1) == fmi2OK);
    EXPECT(fmi2Reset(c) == fmi2OK);
    EXPECT(fmi2SetupExperiment(c, 0, 0, 5.0, 0, 0) == fmi2OK &&
           fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK && fmi2DoStep(c, 5.0, NAN, 1) == fmi2Error);
    EXPECT(fmi2Reset(c) == fmi2OK && fmi2SetupExperiment(c, 0, 0, 0, 1, -1) == fmi2Error);
    EXPECT(fmi2SetupExperiment(c, 0, 0, 0, 1, 0.002) == fmi2OK &&
           fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK && fmi2DoStep(c, 0, 0.001, 1) == fmi2OK);
    EXPECT(fmi2DoStep(c, 0.001, 0.00105, 1) == fmi2Error &&
           fmi2DoStep(c, 0.001, 0.001, 1) == fmi2OK);
    EXPECT(fmi2DoStep(c, 0.002, 0.001, 1) == fmi2Error);
    EXPECT(fmi2Terminate(c) == fmi2OK);
    fmi2FreeInstance(c);
    EXPECT(fmi2DoStep(NULL, 0, 1, 1) == fmi2Error);
    fmi2FreeInstance(NULL);
}

static void drive_model_exchange2(const char *token)
{
    fmi2CallbackFunctions callbacks = {on_log2, calloc, free, NULL, NULL};
    fmi2Component c = fmi2Instantiate("x", fmi2ModelExchange, token, "", &callbacks, 0, 0);
    fmi2EventInfo info;
    fmi2Real x[64], dx[64];
    size_t n = (size_t)block.states.count;
    EXPECT(c && fmi2SetupExperiment(c, 0, 0, 0, 0, 0) == fmi2OK &&
           fmi2EnterInitializationMode(c) == fmi2OK);
    EXPECT(fmi2ExitInitializationMode(c) == fmi2OK && fmi2NewDiscreteStates(c, &info) == fmi2OK);
    EXPECT(fmi2EnterContinuousTimeMode(c) == fmi2OK &&
           fmi2GetContinuousStates(c, x, n + 1) == fmi2Error);
    EXPECT(fmi2GetContinuousStates(c, x, n) == fmi2OK);
    for (int k = 0; k < 20; k++) {
        EXPECT(fmi2SetTime(c, k * 0.01) == fmi2OK && fmi2SetContinuousStates(c, x, n) == fmi2OK);
        EXPECT(fmi2GetDerivatives(c, dx, n) == fmi2OK);
        for (size_t i = 0; i < n; i++)
            x[i] += 0.01 * dx[i];
    }
    if (n > 0) {
        x[n - 1] = NAN;
        EXPECT(fmi2SetContinuousStates(c, x, n) == fmi2Discard);
        /* Extreme states must not give derivatives that are not finite with status OK. */
        for (size_t i = 0; i < n; i++)
            x[i] = 1e200;
        EXPECT(fmi2SetContinuousStates(c, x, n) == fmi2OK &&
               fmi2GetDerivatives(c, dx, n) == fmi2Error);
    }
    EXPECT(fmi2DoStep(c, 0, 0.001, 1) == fmi2Error);
    EXPECT(fmi2Terminate(c) == fmi2OK);
    fmi2FreeInstance(c);
}

static void drive_model_exchange3(const char *token)
{
    fmi3Instance c = fmi3InstantiateModelExchange("x", token, "", 0, 0, NULL, on_log3);
    fmi3Boolean a, b, d, e, f, enter, terminate;
    fmi3Float64 next, x[64], dx[64];
    size_t n = 99;
    EXPECT(c && fmi3EnterInitializationMode(c, 0, 0, 0, 0, 0) == fmi3OK &&
           fmi3ExitInitializationMode(c) == fmi3OK);
    EXPECT(fmi3UpdateDiscreteStates(c, &a, &b, &d, &e, &f, &next) == fmi3OK && !a && !f);
    EXPECT(fmi3EnterContinuousTimeMode(c) == fmi3OK);
    EXPECT(fmi3GetNumberOfContinuousStates(c, &n) == fmi3OK && n == (size_t)block.states.count);
    EXPECT(fmi3GetContinuousStates(c, x, n) == fmi3OK && fmi3SetTime(c, 0.1) == fmi3OK);
    EXPECT(fmi3SetContinuousStates(c, x, n) == fmi3OK &&
           fmi3GetContinuousStateDerivatives(c, dx, n) == fmi3OK);
    EXPECT(fmi3CompletedIntegratorStep(c, 1, &enter, &terminate) == fmi3OK && !enter && !terminate);
    EXPECT(fmi3EnterEventMode(c) == fmi3OK && fmi3Terminate(c) == fmi3OK);
    fmi3FreeInstance(c);
}

static void drive3(const char *token)
{
    EXPECT(!fmi3InstantiateCoSimulation("x", token, "", 0, 0, 1, 0, NULL, 0, NULL, on_log3, NULL));
    EXPECT(
        !fmi3InstantiateCoSimulation("x", "wrong", "", 0, 0, 0, 0, NULL, 0, NULL, on_log3, NULL));
    fmi3Instance c =
        fmi3InstantiateCoSimulation("x", token, "", 0, 0, 0, 0, NULL, 0, NULL, on_log3, NULL);
    fmi3Boolean event, terminate, early;
    fmi3Float64 last, values[64];
    EXPECT(c && fmi3DoStep(c, 0, 0.001, 1, &event, &terminate, &early, &last) == fmi3Error);
    EXPECT(fmi3EnterInitializationMode(c, 0, 0, 0, 0, 0) == fmi3OK &&
           fmi3ExitInitializationMode(c) == fmi3OK);
    for (int k = 0; k < 400; k++)
        EXPECT(fmi3DoStep(c, k * 0.001, 0.001, 1, &event, &terminate, &early, &last) == fmi3OK &&
               !event && !terminate && !early);
    EXPECT(fabs(last - 0.4) < 1e-12);
    for (fmi3ValueReference r = 0; r < 2000; r++)
        for (size_t n = 0; n < 64; n++) {
            fmi3Int64 i[64];
            fmi3Boolean b[64];
            fmi3GetFloat64(c, &r, 1, values, n);
            fmi3GetInt64(c, &r, 1, i, n);
            fmi3GetBoolean(c, &r, 1, b, n);
        }
    fmi3ValueReference beyond = 4294967295u;
    EXPECT(fmi3GetFloat64(c, &beyond, 1, values, 1) == fmi3Error);
    EXPECT(fmi3EnterConfigurationMode(c) == fmi3Error);
    EXPECT(fmi3Terminate(c) == fmi3OK && fmi3Reset(c) == fmi3OK);
    fmi3FreeInstance(c);
}

int main(int argc, char **argv)
{
    if (argc != 3)
        return 2;
    int sampled = argv[2][0] == '1';
    drive2(argv[1], sampled);
    if (!sampled) {
        drive_model_exchange2(argv[1]);
        drive_model_exchange3(argv[1]);
    }
    drive3(argv[1]);
    EXPECT(logged > 100);
    puts("all calls made");
    return 0;
}
