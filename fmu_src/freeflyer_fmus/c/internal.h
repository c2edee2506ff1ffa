/* What the files of the runtime share among themselves. */
#ifndef INTERNAL_H
#define INTERNAL_H

#include <math.h>

#include "instance.h"

#define TIME 0
/* Log categories: a wrong call, and a run that has left what the equations hold for. The description declares both. */
#define MISUSE "logStatusError"
#define REQUIREMENT "logRequirement"
#define ROUNDING 4.5e-16 /* relative, of two times that were computed in two ways */
#define NANOSECOND 1     /* tolerance when times that were doubles are compared */
#define DRIFT \
    100 /* and the part of a step by which an importer's sum of steps may be off when a sample is due */
#define LARGEST_TIME 2e9 /* s; sums of three such times in nanoseconds must fit into 64 bits */
#define TIMES "a finite time below 2e9 s is expected"
#define LARGEST_COUNT 1e7 /* inner steps of one communication step: some 20 s of computation */

static inline double *at(Instance *c, Range range) { return c->memory->value + range.first; }

/* The digits that compensated summation carries, one for each state. */
static inline double *lost(Instance *c) { return c->memory->value + block.values; }

static inline int inside(unsigned index, Range range)
{
    return (int)index >= range.first && (int)index < range.first + range.count;
}

/* How many outputs, from the first, are computed. */
static inline int computed_outputs(const Memory *m)
{
    return m->outputs_valid >= ALL      ? block.outputs.count
           : m->outputs_valid == LINKED ? block.linked
                                        : 0;
}

static inline int is_finite(double x) { return fabs(x) <= 1.7976931348623157e308; }

static inline int64_t nanoseconds(double seconds) { return (int64_t)llround(seconds * 1e9); }

/* Each says nothing itself: on ERROR the message is ready. */
Status instance_check_parameters(Instance *);
Status instance_update_outputs(Instance *, Outputs wanted);
Status instance_update_rates(Instance *);
/* New states into c->scratch; outputs into place once everything is checked. */
Status instance_sample(Instance *, const double *x);
/* The states from which outputs and derivatives follow: in initialization mode those that it will end with. */
const double *instance_present_states(Instance *);
/* Whether a range's values are finite; if not, "NAME is not finite" and `remedy`. */
Status instance_check_finite(Instance *, int first, int count, const double *value,
                             const char *remedy);
/* Inputs, parameters, states or the time are no longer what the outputs were computed from. */
void instance_changed(Instance *);
/* "NAME cannot be set to VALUE" and a reason. */
Status instance_refuse(Instance *, unsigned index, double value, const char *reason);

#endif
