/* Ten million steps of 1 ms with FMI 2.0. `clock TOKEN SUMMED REFERENCE` prints the FMU's time and
   one value. If SUMMED is 1, the importer adds up the step sizes. Then the importer's time drifts. */
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"

#define STEPS 10000000

static void on_log(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category,
                   fmi2String text, ...)
{
    (void)e;
    fprintf(stderr, "%s %d %s %s\n", name, (int)s, category, text);
}

int main(int count, char **arguments)
{
    fmi2CallbackFunctions callbacks = {on_log, calloc, free, NULL, NULL};
    fmi2Component c =
        count > 2 ? fmi2Instantiate("clock", fmi2CoSimulation, arguments[1], "", &callbacks, 0, 0)
                  : NULL;
    if (!c || fmi2SetupExperiment(c, 0, 0, 0, 0, 0) || fmi2EnterInitializationMode(c) ||
        fmi2ExitInitializationMode(c))
        return 1;
    int summed = atoi(arguments[2]);
    double time = 0;
    for (int k = 0; k < STEPS; k++) {
        if (fmi2DoStep(c, summed ? time : k * 0.001, 0.001, 1) != fmi2OK)
            return 2;
        time += 0.001;
    }
    fmi2ValueReference reference = (fmi2ValueReference)atoi(arguments[3]);
    double last, value;
    if (fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) ||
        fmi2GetReal(c, &reference, 1, &value))
        return 3;
    printf("%.17g %.17g\n", last, value);
    fmi2FreeInstance(c);
    return 0;
}
