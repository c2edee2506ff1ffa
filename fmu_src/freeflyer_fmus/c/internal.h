/* Internal declarations of the runtime. */
#ifndef INTERNAL_H
#define INTERNAL_H

#include <math.h>

#include "instance.h"

#define TIME 0
/* Log categories: MISUSE for wrong calls, REQUIREMENT for violated requirements. Both are declared
   in modelDescription.xml. */
#define MISUSE "logStatusError"
#define REQUIREMENT "logRequirement"
#define ROUNDING 4.5e-16 /* relative difference between two computations of the same time */
#define NANOSECOND 1     /* tolerance of time comparisons [ns] */
/* If an importer adds up its step sizes, the rounding errors of its time add up too. Therefore the
   comparisons with the time of a sample and with the stop time accept an error of up to
   step size / DRIFT. */
#define DRIFT 100
#define LARGEST_TIME 2e9 /* s; the sum of three such times in nanoseconds must fit into 64 bits */
#define TIMES "a finite time below 2e9 s is expected"
#define LARGEST_COUNT 1e7 /* inner steps per communication step; 1e7 inner steps take about 20 s */

static inline double *at(Instance *c, Range range) { return c->memory->value + range.first; }

/* Rounding errors of the compensated summation, one per state. */
static inline double *lost(Instance *c) { return c->memory->value + block.values; }

static inline int inside(unsigned index, Range range)
{
    return (int)index >= range.first && (int)index < range.first + range.count;
}

/* Returns the number n of valid outputs. The first n outputs are valid. */
static inline int computed_outputs(const Memory *m)
{
    return m->outputs_valid >= ALL      ? block.outputs.count
           : m->outputs_valid == LINKED ? block.linked
                                        : 0;
}

static inline int is_finite(double x) { return fabs(x) <= 1.7976931348623157e308; }

static inline int64_t nanoseconds(double seconds) { return (int64_t)llround(seconds * 1e9); }

/* If one of the next four functions returns ERROR, it has written a message to c->message. The
   caller reports the message. */
Status instance_check_parameters(Instance *);
Status instance_update_outputs(Instance *, Outputs wanted);
Status instance_update_rates(Instance *);
/* Computes one sample. `x` contains the states before the sample. Writes the new states to
   c->scratch. If all checks pass, writes the outputs to the value vector. */
Status instance_sample(Instance *, const double *x);
/* Returns the states that belong to the present outputs and derivatives. In initialization mode,
   these are the states that the instance would have after initialisation. */
const double *instance_present_states(Instance *);
/* Returns OK if all values are finite. Otherwise, returns ERROR and writes the message "NAME is not
   finite", followed by `remedy`. `first` is the index of value[0] in the value vector. */
Status instance_check_finite(Instance *, int first, int count, const double *value,
                             const char *remedy);
/* Invalidates outputs and rates after a change of inputs, parameters, states or time. */
void instance_changed(Instance *);
/* Reports "NAME cannot be set to VALUE", followed by the reason. */
Status instance_reject(Instance *, unsigned index, double value, const char *reason);

#endif
