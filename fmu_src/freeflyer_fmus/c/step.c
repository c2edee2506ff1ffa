/* Communication steps. */
#include "internal.h"

#include <string.h>

#include "integrate.h"

/* Returns the time [ns] of the sample after m->next_sample: the start time plus a whole number of
   periods. The function does not add up periods. Therefore rounding errors do not accumulate. */
static int64_t sample_after(const Memory *m, double period)
{
    int64_t count = (int64_t)llround((double)(m->next_sample - m->start) * 1e-9 / period);
    return m->start + (int64_t)llround((double)(count + 1) * period * 1e9);
}

static Status step_sampled(Instance *c, int64_t begin, int64_t end, double size)
{
    Memory *m = c->memory;
    double period = m->value[block.period];
    int64_t tolerance = NANOSECOND + (end - begin) / DRIFT;
    int due = begin + tolerance >= m->next_sample;
    int64_t next = due ? sample_after(m, period) : m->next_sample;
    if (end > next + tolerance) {
        message_begin(&c->message, "a communication step of ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s passes over a sample of this block, whose period is ");
        message_add_number(&c->message, period);
        message_add(&c->message, " s; choose a step that divides the period");
        return instance_report(c, ERROR, MISUSE);
    }
    if (due && instance_sample(c, at(c, block.states)) != OK)
        return instance_report(c, ERROR, REQUIREMENT);
    if (due)
        memcpy(at(c, block.states), c->scratch, (size_t)block.states.count * sizeof(double));
    m->next_sample = next;
    return OK;
}

/* Makes an intermediate update, in which the importer may read values and set inputs. Returns
   nonzero if the importer ends the communication step at this time. */
static int interrupted(Instance *c, double time)
{
    Memory *m = c->memory;
    m->clock = time;
    instance_changed(c);
    m->state = INTERMEDIATE;
    int stop = c->intermediate_update(c, time);
    m->state = STEP;
    return stop;
}

static Status step_continuous(Instance *c, double time, double size)
{
    Memory *m = c->memory;
    int n = block.states.count;
    double *x = at(c, block.states), *saved = c->saved;
    double longest = block.step_parameter >= 0 ? m->value[block.step_parameter] : block.step;
    double steps = ceil(size / longest - 1e-9), end = time + size;
    if (steps > LARGEST_COUNT) {
        message_begin(&c->message, "a communication step of ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s would be more than 1e7 integration steps of ");
        message_add_number(&c->message, longest);
        message_add(&c->message, " s; choose a shorter step");
        return instance_report(c, ERROR, MISUSE);
    }
    /* Save states, rounding errors and inputs. They are restored if the step fails. */
    int64_t count = size > 0 ? (int64_t)steps : 0;
    double h = count > 0 ? size / (double)count : 0;
    memcpy(saved, x, (size_t)n * sizeof(double));
    memcpy(saved + n, lost(c), (size_t)n * sizeof(double));
    memcpy(saved + 2 * n, at(c, block.inputs), (size_t)block.inputs.count * sizeof(double));
    for (int64_t i = 0; i < count; i++) {
        double inner = time + (double)(i + 1) * h;
        if (n > 0)
            integrate_runge_kutta(block.rates, time + (double)i * h, h, at(c, block.parameters),
                                  at(c, block.inputs), x, lost(c), n, c->scratch);
        if (i + 1 < count && c->intermediate_update && interrupted(c, inner)) {
            end = inner;
            break;
        }
    }
    /* The new state must be finite and satisfy the requirements. */
    m->clock = end;
    m->outputs_valid = NONE;
    m->rates_valid = 0;
    Status status = instance_check_finite(
        c, block.states.first, n, x, " after this step; the step was rejected: check the inputs");
    /* Usually, outputs are computed when they are read. But the requirements are checked together
       with the outputs. If there are requirements, compute the outputs at every step. */
    if (status == OK && block.running_requirements > 0)
        status = instance_update_outputs(c, LINKED);
    if (status == OK)
        return OK;
    memcpy(x, saved, (size_t)n * sizeof(double));
    memcpy(lost(c), saved + n, (size_t)n * sizeof(double));
    memcpy(at(c, block.inputs), saved + 2 * n, (size_t)block.inputs.count * sizeof(double));
    m->clock = time;
    m->outputs_valid = NONE;
    return instance_report(c, ERROR, REQUIREMENT);
}

Status instance_step(Instance *c, double time, double size)
{
    Memory *m = c->memory;
    int sound = size >= 0 && fabs(time) < LARGEST_TIME && fabs(time + size) < LARGEST_TIME;
    int64_t begin = sound ? nanoseconds(time) : 0, end = sound ? nanoseconds(time + size) : 0;
    if (!sound || !(fabs(time - m->clock) <= 1e-9 + ROUNDING * fabs(time))) {
        message_begin(&c->message, "a step from ");
        message_add_number(&c->message, time);
        message_add(&c->message, " s of size ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s does not start at the end of the last step, ");
        message_add_number(&c->message, m->clock);
        message_add(&c->message, " s (difference ");
        message_add_number(&c->message, time - m->clock);
        message_add(&c->message, " s), or its size is not valid");
        return instance_report(c, ERROR, MISUSE);
    }
    if (m->stop != INT64_MAX && end > m->stop + NANOSECOND + (end - begin) / DRIFT) {
        message_begin(&c->message, "a step to ");
        message_add_number(&c->message, time + size);
        message_add(&c->message, " s goes beyond the stop time, ");
        message_add_number(&c->message, (double)m->stop * 1e-9);
        message_add(&c->message, " s");
        return instance_report(c, ERROR, MISUSE);
    }
    double before = m->clock;
    m->clock = time;
    Status status =
        instance_check_parameters(c) == OK ? OK : instance_report(c, ERROR, REQUIREMENT);
    if (status == OK)
        status =
            block.period >= 0 ? step_sampled(c, begin, end, size) : step_continuous(c, time, size);
    if (status != OK) {
        m->clock = before;
        return status;
    }
    if (block.period >= 0)
        m->clock = time + size;
    return OK;
}
