/* time_steps LIBRARY TOKEN STEP COUNT INPUTS OUTPUTS...: the time per step [us] through FMI 2.0, best
   of seven runs of COUNT steps. The first time is that of doStep. Each list OUTPUTS adds the time of
   a cycle: set the inputs, step, get these outputs. Lists are comma-separated value references, or
   "-" for none. */
#define _POSIX_C_SOURCE 199309L
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"

#define LARGEST 1000

typedef struct {
    fmi2ValueReference reference[LARGEST];
    fmi2Real value[LARGEST];
    size_t n;
} List;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e6 + (double)t.tv_nsec * 1e-3;
}

static void read_list(const char *text, List *list)
{
    char *end;
    for (list->n = 0; *text != '-' && *text && list->n < LARGEST; text = *end ? end + 1 : end)
        list->reference[list->n++] = (fmi2ValueReference)strtoul(text, &end, 10);
}

#define LOAD(name)                                \
    name##TYPE *name##_;                          \
    {                                             \
        void *symbol = dlsym(library, #name);     \
        memcpy(&name##_, &symbol, sizeof symbol); \
    }

int main(int argc, char **argv)
{
    if (argc < 6)
        return 2;
    void *library = dlopen(argv[1], RTLD_NOW);
    if (!library)
        return 3;
    LOAD(fmi2Instantiate)
    LOAD(fmi2SetupExperiment)
    LOAD(fmi2EnterInitializationMode)
    LOAD(fmi2ExitInitializationMode)
    LOAD(fmi2DoStep)
    LOAD(fmi2GetReal)
    LOAD(fmi2SetReal)
    fmi2Component c = fmi2Instantiate_("x", fmi2CoSimulation, argv[2], "", NULL, 0, 0);
    if (!c || fmi2SetupExperiment_(c, 0, 0, 0, 0, 0) || fmi2EnterInitializationMode_(c) ||
        fmi2ExitInitializationMode_(c))
        return 4;
    static List inputs, outputs;
    read_list(argv[5], &inputs);
    if (fmi2GetReal_(c, inputs.reference, inputs.n, inputs.value))
        return 5;
    double step = atof(argv[3]), time = 0;
    int count = atoi(argv[4]);
    for (int list = 5; list < argc; list++) {
        double best = 1e9;
        if (list > 5)
            read_list(argv[list], &outputs);
        for (int run = 0; run < 7; run++) {
            double start = now();
            for (int k = 0; k < count; k++, time += step)
                if ((list > 5 && fmi2SetReal_(c, inputs.reference, inputs.n, inputs.value)) ||
                    fmi2DoStep_(c, time, step, 1) ||
                    (list > 5 && fmi2GetReal_(c, outputs.reference, outputs.n, outputs.value)))
                    return 6;
            double each = (now() - start) / count;
            best = each < best ? each : best;
        }
        printf("%.4f\n", best);
    }
    return 0;
}
