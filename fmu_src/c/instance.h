/* One instance of the block: its values, its life cycle, its steps. fmi2.c and fmi3.c translate FMI calls to these. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "block.h"
#include "message.h"

/* The same numbers in FMI 2.0 and FMI 3.0. */
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;

/* Bits, so that a function can name the states in which it may be called. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,        /* co-simulation, between steps */
    EVENT = 8,       /* model exchange */
    CONTINUOUS = 16, /* model exchange */
    TERMINATED = 32,
    FAILED = 64
} State;

typedef struct {
    State state;
    int outputs_valid, rates_valid, parameters_checked;
    int64_t start, time, next_sample; /* ns */
    double clock;                     /* s; the exact time that the importer gave */
    double value[];                   /* the value vector, then the integrator's lost digits */
} Memory;

typedef struct Instance {
    const char *name;
    int model_exchange;
    void *environment;
    void (*log)(struct Instance *, Status, const char *category, const char *text);
    void *log_target[2];
    int logging;
    Message message;
    double *scratch;
    Memory *memory; /* everything that a saved FMU state holds */
} Instance;

#define INSTANCE_NOT_MADE "the instantiation token is not this library's, or there is no memory: description and binary do not belong together"
Instance *instance_new(const char *name, const char *token, int model_exchange);
void instance_free(Instance *);
/* Back to start values. */
void instance_reset(Instance *);
/* Say why, and give `status`. */
Status instance_say(Instance *, Status status, const char *category);
/* OK if the call is allowed now. */
Status instance_allow(Instance *, const char *function, int states);

/* Values by value reference. Setting checks access, range and finiteness; nothing is changed on failure. */
Status instance_get(Instance *, unsigned reference, Kind kind, int elements, double *value);
Status instance_set(Instance *, unsigned reference, Kind kind, int elements, const double *value);
/* Elements of the variable that begins at `reference`; 0 if none does. */
int instance_extent(unsigned reference);

Status instance_enter_initialization(Instance *, double start);
Status instance_exit_initialization(Instance *);
Status instance_step(Instance *, double time, double size);

/* Model exchange. */
void instance_set_time(Instance *, double time);
Status instance_set_states(Instance *, const double *x, size_t n);
Status instance_get_states(Instance *, double *x, size_t n);
Status instance_get_rates(Instance *, double *dx, size_t n);

/* Saved states: one flat copy each. */
size_t instance_memory_size(void);

#endif
