#include "slave.h"

#include <math.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT End core_run(Core *core, int64_t until);

static double seconds(int64_t time)
{
    return (double)time / 1e9; /* correctly rounded as long as `time` is below 2^53 ns, 104 days */
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

/* The end of the run in `failed`, if `status` says so. */
static bool fails(Core *core, int index, Operation operation, int status)
{
    if (status == 0) {
        return false;
    }
    core->index = index;
    core->operation = operation;
    core->status = status;
    return true;
}

static bool step_fails(Core *core, int index, int64_t k)
{
    Slave *s = &core->slave[index];
    int64_t size = least(s->ratio, core->ticks - k) * core->tick;
    if (fails(core, index, STEP, make_step(core, index, seconds(k * core->tick), seconds(size)))) {
        return true;
    }
    s->due = k + s->ratio;
    s->steps++;
    return false;
}

/* The outputs that nobody uses are read where they are recorded. A slow slave is ahead of time until its next step: it is read
   whole while its outputs are those of the instant. */
static bool get_fails(Core *core, int index, bool all)
{
    return fails(core, index, GET, get_outputs(core, index, all || core->slave[index].ratio > 1));
}

static bool looks_passed(const Limit *limit)
{
    double sum = 0.0;
    bool within = true; /* NaN is not */
    for (size_t i = 0; i < limit->count; i++) {
        double x = limit->value[i];
        within = within && (limit->minimum ? x >= limit->bound : fabs(x) <= limit->bound);
        sum += x * x;
    }
    /* Sums of squares are rounded in an order of their own: what is close is judged by the limit's owner. */
    return !within || (limit->euclidean && !(sum <= limit->bound * limit->bound * (1.0 - 1e-12)));
}

/* The owner judges, and counts how long a limit is passed: it is asked once more after the last time. */
static bool limit_passed(Core *core)
{
    for (int i = 0; i < core->limits; i++) {
        Limit *limit = &core->limit[i];
        bool before = limit->looks_passed;
        limit->looks_passed = looks_passed(limit);
        if ((before || limit->looks_passed) &&
            fails(core, i, LIMIT, core->call(i, LIMIT, 0.0, 0.0))) {
            return true;
        }
    }
    return false;
}

static void record(Core *core, int64_t k)
{
    double *row = core->row + (size_t)core->rows * core->columns;
    core->row_time[core->rows++] = seconds(k * core->tick);
    for (size_t i = 0; i < core->columns; i++) {
        row[i] = *core->recorded[i];
    }
}

/* Slaves whose outputs belong to the end of a step hand over those of instant k. */
static bool settled_outputs_fail(Core *core, int64_t k, bool all)
{
    for (int i = core->first; i < core->slaves; i++) {
        if ((core->slave[i].due == k || k == core->ticks) && get_fails(core, i, all)) {
            return true;
        }
    }
    return false;
}

/* Controllers sample one after the other, each output used at once. */
static bool samples_fail(Core *core, int64_t k, bool all)
{
    for (int i = 0; i < core->first; i++) {
        if (core->slave[i].due != k) {
            continue;
        }
        take_inputs(&core->slave[i]);
        if (fails(core, i, SET, set_inputs(core, i)) || step_fails(core, i, k) ||
            get_fails(core, i, all)) {
            return true;
        }
    }
    return false;
}

/* All others take their inputs before any of them moves. */
static bool steps_fail(Core *core, int64_t k)
{
    for (int i = core->first; i < core->slaves; i++) {
        if (core->slave[i].due == k) {
            take_inputs(&core->slave[i]);
            if (fails(core, i, SET, set_inputs(core, i))) {
                return true;
            }
        }
    }
    for (int i = core->first; i < core->slaves; i++) {
        if (core->slave[i].due == k && step_fails(core, i, k)) {
            return true;
        }
    }
    return false;
}

/* Where the run ends between two recorded instants, what was not read is read now; slow slaves were read whole. */
static bool reading_all_fails(Core *core)
{
    for (int i = 0; i < core->slaves; i++) {
        if (core->slave[i].ratio == 1 && get_fails(core, i, true)) {
            return true;
        }
    }
    return false;
}

static End instant(Core *core, int64_t k, bool last)
{
    bool recorded = k % core->record_ratio == 0;
    for (size_t i = 0; i < core->delays; i++) {
        *core->before[i] = *core->now[i];
    }
    if (k > 0 && settled_outputs_fail(core, k, recorded)) {
        return FAILED;
    }
    if (!last && samples_fail(core, k, recorded)) {
        return FAILED;
    }
    if (last && reading_all_fails(core)) {
        return FAILED;
    }
    if (recorded) {
        record(core, k);
    }
    if (limit_passed(core)) {
        int index = core->index, status = core->status;
        if (!recorded && reading_all_fails(core)) {
            return FAILED;
        }
        fails(core, index, LIMIT, status);
        return PASSED;
    }
    if (last) {
        return DONE;
    }
    return steps_fail(core, k) ? FAILED : PAUSED;
}

End core_run(Core *core, int64_t until)
{
    while (core->at < until || core->cancel) {
        int64_t k = core->at;
        End end = instant(core, k, core->cancel || k == core->ticks);
        if (end != PAUSED) {
            return end;
        }
        core->at = k + 1;
    }
    return PAUSED;
}
