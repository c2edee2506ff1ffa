/* Internal declarations of the runtime. */
#ifndef INTERNAL_H
#define INTERNAL_H

#include <math.h>

#include "instance.h"

#define TIME 0
/* Log categories: wrong calls, and violated requirements. modelDescription.xml declares both. */
#define MISUSE "logStatusError"
#define REQUIREMENT "logRequirement"
#define ROUNDING 4.5e-16 /* relative difference of one time computed in two ways */
#define NANOSECOND 1     /* tolerance of comparisons of times */
/* An importer that adds up step sizes may be off by step / DRIFT when a sample is due. */
#define DRIFT 100
#define LARGEST_TIME 2e9 /* s; sums of three such times in nanoseconds must fit into 64 bits */
#define TIMES "a finite time below 2e9 s is expected"
#define LARGEST_COUNT 1e7 /* inner steps per communication step: about 20 s of computation */

static inline double *at(Instance *c, Range range) { return c->memory->value + range.first; }

/* Rounding errors of the compensated summation, one per state. */
static inline double *lost(Instance *c) { return c->memory->value + block.values; }

static inline int inside(unsigned index, Range range)
{
    return (int)index >= range.first && (int)index < range.first + range.count;
}

/* Number of leading outputs that are valid. */
static inline int computed_outputs(const Memory *m)
{
    return m->outputs_valid >= ALL      ? block.outputs.count
           : m->outputs_valid == LINKED ? block.linked
                                        : 0;
}

static inline int is_finite(double x) { return fabs(x) <= 1.7976931348623157e308; }

static inline int64_t nanoseconds(double seconds) { return (int64_t)llround(seconds * 1e9); }

/* These write a message on ERROR but do not report it. */
Status instance_check_parameters(Instance *);
Status instance_update_outputs(Instance *, Outputs wanted);
Status instance_update_rates(Instance *);
/* Writes the new states to c->scratch, and the outputs in place if all checks pass. */
Status instance_sample(Instance *, const double *x);
/* States that outputs and derivatives depend on; in initialization mode, the initialised states. */
const double *instance_present_states(Instance *);
/* Returns OK if all values are finite, else ERROR with "NAME is not finite" and `remedy`. */
Status instance_check_finite(Instance *, int first, int count, const double *value,
                             const char *remedy);
/* Invalidates outputs and rates after a change of inputs, parameters, states or time. */
void instance_changed(Instance *);
/* Reports "NAME cannot be set to VALUE" and the reason. */
Status instance_reject(Instance *, unsigned index, double value, const char *reason);

#endif
