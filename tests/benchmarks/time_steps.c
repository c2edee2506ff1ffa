/* time_steps LIBRARY TOKEN STEP COUNT: the best of five runs of COUNT steps through FMI 2.0, in microseconds a step. */
#define _POSIX_C_SOURCE 199309L
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e6 + (double)t.tv_nsec * 1e-3;
}

#define LOAD(name) name##TYPE *name##_; \
    { void *symbol = dlsym(library, #name); memcpy(&name##_, &symbol, sizeof symbol); }

int main(int argc, char **argv)
{
    if (argc != 5)
        return 2;
    void *library = dlopen(argv[1], RTLD_NOW);
    if (!library)
        return 3;
    LOAD(fmi2Instantiate)
    LOAD(fmi2SetupExperiment)
    LOAD(fmi2EnterInitializationMode)
    LOAD(fmi2ExitInitializationMode)
    LOAD(fmi2DoStep)
    fmi2Component c = fmi2Instantiate_("x", fmi2CoSimulation, argv[2], "", NULL, 0, 0);
    if (!c || fmi2SetupExperiment_(c, 0, 0, 0, 0, 0) || fmi2EnterInitializationMode_(c) || fmi2ExitInitializationMode_(c))
        return 4;
    double step = atof(argv[3]), best = 1e9;
    int count = atoi(argv[4]);
    for (int run = 0; run < 5; run++) {
        double begin = now();
        for (int k = 0; k < count; k++)
            if (fmi2DoStep_(c, ((double)run * count + k) * step, step, 1))
                return 5;
        double each = (now() - begin) / count;
        best = each < best ? each : best;
    }
    printf("%.4f\n", best);
    return 0;
}
