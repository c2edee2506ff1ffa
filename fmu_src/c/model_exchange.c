/* Model exchange: the importer integrates. */
#include "internal.h"

#include <string.h>

Status instance_set_time(Instance *c, double time)
{
    if (!(fabs(time) < LARGEST_TIME))
        return instance_refuse(c, TIME, time, ": a finite time below 9e9 s is expected");
    c->memory->clock = time;
    c->memory->time = nanoseconds(time);
    instance_changed(c);
    return OK;
}

static Status check_count(Instance *c, size_t n)
{
    if ((int)n == block.states.count)
        return OK;
    message_begin(&c->message, "this FMU has ");
    message_add_number(&c->message, block.states.count);
    message_add(&c->message, " continuous states, not ");
    message_add_number(&c->message, (double)n);
    return instance_say(c, ERROR, MISUSE);
}

Status instance_set_states(Instance *c, const double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!is_finite(x[i]))
            return instance_refuse(c, (unsigned)block.states.first + (unsigned)i, x[i], ": it must be a finite number");
    memcpy(at(c, block.states), x, n * sizeof(double));
    instance_changed(c);
    return OK;
}

Status instance_get_states(Instance *c, double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    memcpy(x, instance_present_states(c), n * sizeof(double));
    return OK;
}

Status instance_get_rates(Instance *c, double *dx, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    if (instance_update_rates(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    memcpy(dx, at(c, block.derivatives), n * sizeof(double));
    return OK;
}

Status instance_get_nominals(Instance *c, double *nominals, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    memcpy(nominals, block.nominal, n * sizeof(double));
    return OK;
}
