#include "slave.h"

#include <math.h>
#include <stdatomic.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

EXPORT End core_run(Core *core, int64_t until);

static double seconds(int64_t time)
{
    return (double)time / 1e9; /* correctly rounded if `time` is below 2^53 ns (104 days) */
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }

/* If `status` is a failure (not 0), store the cause of the stop in the core and return true. */
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

/* Read the outputs of a slave that connections or limits need. The other outputs are only recorded.
   They are also read if `all` is true: at a recorded instant, or at the end of the run. If the step
   of a slave is several ticks, all its outputs are read at each of its steps. The reason is that a
   recorded instant may be between two of its steps, when no outputs of this slave are read. */
static bool get_fails(Core *core, int index, bool all)
{
    return fails(core, index, GET, get_outputs(core, index, all || core->slave[index].ratio > 1));
}

static bool maybe_exceeded(const Limit *limit)
{
    double sum = 0.0;
    bool within = true; /* becomes false for NaN */
    for (size_t i = 0; i < limit->count; i++) {
        double x = limit->value[i];
        within = within && (limit->minimum ? x >= limit->bound : fabs(x) <= limit->bound);
        sum += x * x;
    }
    /* Python may round the sum of squares differently. Therefore the result is also true if the sum
       is only near the square of the bound, and Python decides. */
    return !within || (limit->euclidean && !(sum <= limit->bound * limit->bound * (1.0 - 1e-12)));
}

/* Return true if a limit ends the run. C finds the limits that may be exceeded, and calls Python
   for each of these limits. Python decides whether the limit is exceeded, and counts the instants
   at which it is exceeded. When a limit is no longer exceeded, C calls Python once more. Python
   then resets the counter. */
static bool limit_exceeded(Core *core)
{
    for (int i = 0; i < core->limits; i++) {
        Limit *limit = &core->limit[i];
        bool before = limit->maybe_exceeded;
        limit->maybe_exceeded = maybe_exceeded(limit);
        if ((before || limit->maybe_exceeded) &&
            fails(core, i, LIMIT, core->call(i, LIMIT, 0.0, 0.0))) {
            return true;
        }
    }
    return false;
}

/* Write a row of the record. The time is written after the values: if the process dies in between,
   the row counts as not written. */
static void record(Core *core, int64_t k)
{
    double *row = core->row + (size_t)core->rows * core->columns;
    for (size_t i = 0; i < core->columns; i++) {
        row[i] = *core->recorded[i];
    }
    atomic_signal_fence(memory_order_release);
    core->row_time[core->rows++] = seconds(k * core->tick);
}

/* Read the outputs of the plants (all slaves except the controllers) whose step ends at instant k.
   At the last instant of the run, read the outputs of all plants. `samples_fail` reads the outputs
   of a controller, directly after its step. */
static bool settled_outputs_fail(Core *core, int64_t k, bool all)
{
    for (int i = core->first; i < core->slaves; i++) {
        if ((core->slave[i].due == k || k == core->ticks) && get_fails(core, i, all)) {
            return true;
        }
    }
    return false;
}

/* Step the controllers whose step starts at instant k, one after the other. Each controller uses
   the outputs that the controllers before it have computed at the same instant. */
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

/* Step the plants whose step starts at instant k. The inputs of all these plants are written before
   the first of them steps. */
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

/* Read all outputs of the slaves with a step of one tick. `get_fails` has omitted some of these
   outputs if the run ends between two recorded instants. The last instant is always recorded. */
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
    if (limit_exceeded(core)) {
        int index = core->index, status = core->status;
        if (!recorded && reading_all_fails(core)) {
            return FAILED;
        }
        fails(core, index, LIMIT, status);
        return LIMIT_EXCEEDED;
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
