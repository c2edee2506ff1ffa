/* Model exchange: the importer integrates the states. */
#include "internal.h"

Status instance_set_time(Instance *c, double time)
{
    if (!(fabs(time) < LARGEST_TIME))
        return instance_reject(c, TIME, time, ": " TIMES);
    c->memory->clock = time;
    instance_changed(c);
    return OK;
}

/* Copies n values. Unlike for memcpy, the arrays may be NULL if n is 0. */
static void transfer(double *to, const double *from, size_t n)
{
    for (size_t i = 0; i < n; i++)
        to[i] = from[i];
}

static Status check_count(Instance *c, size_t n)
{
    if (n == (size_t)block.states.count)
        return OK;
    message_begin(&c->message, "this FMU has ");
    message_add_number(&c->message, block.states.count);
    message_add(&c->message, " continuous states, not ");
    message_add_number(&c->message, (double)n);
    return instance_report(c, ERROR, MISUSE);
}

Status instance_set_states(Instance *c, const double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!is_finite(x[i]))
            return instance_reject(c, (unsigned)block.states.first + (unsigned)i, x[i],
                                   ": it must be a finite number");
    transfer(at(c, block.states), x, n);
    instance_changed(c);
    return OK;
}

Status instance_get_states(Instance *c, double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    transfer(x, instance_present_states(c), n);
    return OK;
}

Status instance_get_rates(Instance *c, double *dx, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    if (instance_update_rates(c) != OK)
        return instance_report(c, ERROR, REQUIREMENT);
    transfer(dx, at(c, block.derivatives), n);
    return OK;
}

Status instance_get_nominals(Instance *c, double *nominals, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    transfer(nominals, block.nominal, n);
    return OK;
}
