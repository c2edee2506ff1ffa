/* core_alone TICKS: the native core with a ring of four trivial slaves, two of each FMI version. Each
   has eight inputs and eight outputs. Checks the last values. Then prints the time per slave step
   [ns] for three cases: no recording, every tenth instant recorded, every instant recorded. */
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core.h"

enum { SLAVES = 4, WIDTH = 8 };

typedef struct {
    double u[WIDTH], y[WIDTH];
} Trivial;

static int set2(void *instance, const uint32_t *reference, size_t references, const double *value)
{
    for (size_t i = 0; i < references; i++)
        ((Trivial *)instance)->u[reference[i]] = value[i];
    return 0;
}

static int get2(void *instance, const uint32_t *reference, size_t references, double *value)
{
    for (size_t i = 0; i < references; i++)
        value[i] = ((Trivial *)instance)->y[reference[i]];
    return 0;
}

static int step2(void *instance, double time, double size, int no_state_set_before)
{
    Trivial *slave = instance;
    for (int i = 0; i < WIDTH; i++)
        slave->y[i] = slave->u[i] + 1.0;
    return !(time >= 0.0 && size > 0.0 && no_state_set_before) * 3;
}

static int set3(void *instance, const uint32_t *reference, size_t references, const double *value,
                size_t values)
{
    memcpy(((Trivial *)instance)->u, value, values * sizeof *value);
    return references == 1 && reference[0] == 0 ? 0 : 3;
}

static int get3(void *instance, const uint32_t *reference, size_t references, double *value,
                size_t values)
{
    memcpy(value, ((Trivial *)instance)->y, values * sizeof *value);
    return references == 1 && reference[0] == 0 ? 0 : 3;
}

static int step3(void *instance, double time, double size, bool no_state_set_before, bool *event,
                 bool *terminate, bool *early, double *reached)
{
    *event = *terminate = *early = false;
    *reached = time + size;
    return step2(instance, time, size, no_state_set_before);
}

/* Return the time per slave step [ns], or 0 if a value is wrong. */
static double run_ring(int64_t ticks, int64_t record_ratio)
{
    static const uint32_t references[WIDTH] = {0, 1, 2, 3, 4, 5, 6, 7};
    Trivial trivial[SLAVES] = {{{0}, {0}}};
    Slave slave[SLAVES];
    double in[SLAVES][WIDTH] = {{0}}, out[SLAVES][WIDTH] = {{0}};
    double *target[SLAVES][WIDTH];
    const double *source[SLAVES][WIDTH], *recorded[SLAVES * WIDTH];
    size_t rows = (size_t)(ticks / record_ratio) + 2;
    double *row_time = malloc(rows * sizeof *row_time),
           *row = malloc(rows * SLAVES * WIDTH * sizeof *row);
    memset(slave, 0, sizeof slave);
    for (int s = 0; s < SLAVES; s++) {
        bool three = s % 2;
        for (int i = 0; i < WIDTH; i++) {
            target[s][i] = &in[s][i];
            source[s][i] = &out[(s + SLAVES - 1) % SLAVES][i];
            recorded[s * WIDTH + i] = &out[s][i];
        }
        Batch all = {three ? 1 : WIDTH, WIDTH};
        slave[s] = (Slave){.fmi = three ? 3 : 2,
                           .instance = &trivial[s],
                           .set2 = set2,
                           .get2 = get2,
                           .step2 = step2,
                           .set3 = set3,
                           .get3 = get3,
                           .step3 = step3,
                           .inputs = all,
                           .used = all,
                           .outputs = all,
                           .input = references,
                           .output = references,
                           .input_value = in[s],
                           .output_value = out[s],
                           .wires = WIDTH,
                           .target = target[s],
                           .source = source[s],
                           .ratio = 1};
    }
    Core core;
    memset(&core, 0, sizeof core);
    core.slave = slave;
    core.slaves = SLAVES;
    core.first = 2;
    core.tick = 1000000;
    core.ticks = ticks;
    core.record_ratio = record_ratio;
    core.columns = SLAVES * WIDTH;
    core.recorded = recorded;
    core.row_time = row_time;
    core.row = row;
    struct timespec start, end;
    clock_gettime(CLOCK_MONOTONIC, &start);
    End ended = core_run(&core, ticks + 1);
    clock_gettime(CLOCK_MONOTONIC, &end);
    /* Each slave adds 1. A value needs two instants for the ring, because the outputs of the two
       controllers are used at the same instant. */
    double last = row[(core.rows - 1) * SLAVES * WIDTH + (SLAVES - 1) * WIDTH];
    bool right = ended == DONE && core.rows == ticks / record_ratio + 1 &&
                 last == out[SLAVES - 1][0] && last > 1.9 * (double)(ticks - 3);
    free(row_time);
    free(row);
    double spent =
        (double)(end.tv_sec - start.tv_sec) * 1e9 + (double)(end.tv_nsec - start.tv_nsec);
    return right ? spent / ((double)ticks * SLAVES) : 0.0;
}

int main(int argc, char **argv)
{
    int64_t ticks = argc > 1 ? atol(argv[1]) : 1000;
    const int64_t ratios[] = {ticks, 10, 1};
    for (int i = 0; i < 3; i++) {
        double best = 1e9;
        for (int attempt = 0; attempt < 5; attempt++) {
            double each = run_ring(ticks, ratios[i]);
            if (each == 0.0)
                return 1;
            best = each < best ? each : best;
        }
        printf("%.1f ", best);
    }
    printf("\n");
    return 0;
}
