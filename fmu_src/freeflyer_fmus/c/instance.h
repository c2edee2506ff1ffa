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
    STEP = 4,          /* co-simulation, between steps */
    EVENT = 8,         /* model exchange */
    CONTINUOUS = 16,   /* model exchange */
    INTERMEDIATE = 32, /* co-simulation, inside a step: the importer's intermediate update runs */
    TERMINATED = 64,
    MODEL_EXCHANGE = 128 /* no state: a function's remark that it belongs to model exchange */
} State;

/* Where values may be read. */
#define INITIALIZED (INITIALIZATION | STEP | EVENT | CONTINUOUS | INTERMEDIATE | TERMINATED)

/* Which outputs are computed: none, those that are made to be connected, all. */
typedef enum { NONE, LINKED, ALL } Outputs;

typedef struct {
    uint64_t identity; /* whose: a hash of the token and of the interface type */
    State state;
    int outputs_valid; /* Outputs */
    int rates_valid, parameters_checked;
    int64_t start, stop, next_sample; /* ns */
    double clock;                     /* s; the exact time that the importer gave */
    double value[];                   /* the value vector, then the integrator's lost digits */
} Memory;

typedef struct Instance {
    const char *name;
    int model_exchange;
    void *environment;
    void (*log)(struct Instance *, Status, const char *category, const char *text);
    void *log_target[2];
    /* At the end of an inner step of a communication step; not 0 ends the communication step there. May be NULL. */
    int (*intermediate_update)(struct Instance *, double time);
    void *update_target[2];
    int may_return_early;
    Message message;
    double *scratch;              /* of one evaluation or integration */
    double *saved;                /* states, lost digits and inputs before a step */
    double *initial;              /* states as initialisation makes them */
    double *seed, *result, *part; /* of a sensitivity, each as long as the value vector */
    Memory *memory;               /* everything that a saved FMU state holds */
} Instance;

/* Why an instance cannot be made, or NULL. */
const char *instance_refusal(const char *name, const char *token, int model_exchange);
#define NO_MEMORY "there is no memory for an instance"
Instance *instance_new(const char *name, int model_exchange); /* NULL: no memory */
void instance_free(Instance *);
/* Back to start values. */
void instance_reset(Instance *);
/* Say why, and give `status`. */
Status instance_say(Instance *, Status status, const char *category);
/* OK if the call is allowed now, and if the arrays that it needs are `given`. */
Status instance_allow(Instance *, const char *function, int states, int given);
/* "This FMU has no ...". */
Status instance_lacks(Instance *, const char *what);
/* OK if these are log categories of this FMU. */
Status instance_check_categories(Instance *, const char *const categories[], size_t n);

/* Values by value reference, in FMI 3.0 one for a `whole` variable, in FMI 2.0 one for each element. Setting: first check access,
   range and finiteness of everything, then put it. */
typedef struct {
    const unsigned *reference;
    size_t n;
} References;
Status instance_get(Instance *, References, int whole, Kind kind, double *value);
Status instance_check(Instance *, References, int whole, Kind kind, const double *value);
void instance_put(Instance *, References, int whole, const double *value);
/* Elements of the variable that begins at `reference`; 0 if none does. */
int instance_extent(unsigned reference);

/* `stop` is INFINITY where none was announced. */
Status instance_set_up(Instance *, double start, double stop);
void instance_enter_initialization(Instance *);
Status instance_exit_initialization(Instance *);
/* ERROR: nothing has changed, and a step with other inputs or of another size may go through. */
Status instance_step(Instance *, double time, double size);

/* Model exchange. */
Status instance_set_time(Instance *, double time);
Status instance_set_states(Instance *, const double *x, size_t n);
Status instance_get_states(Instance *, double *x, size_t n);
Status instance_get_rates(Instance *, double *dx, size_t n);
Status instance_get_nominals(Instance *, double *nominals, size_t n);

/* Sensitivities of unknowns (outputs, derivatives; states as outputs) to knowns (time, real parameters, inputs, states), at
   the present values; of a sampled block, those of the sample that it would take now. Forward: `seed` belongs to the knowns; reverse: to the unknowns. */
Status instance_sensitivity(Instance *, References unknowns, References knowns, int whole,
                            int reverse, const double *seed, size_t seeds, double *result,
                            size_t results);
/* Saved states: one flat copy each. `slot` is reused where it is not NULL. */
size_t instance_memory_size(void);
size_t instance_serialized_size(void); /* with a check sum */
Status instance_save(Instance *, void **slot);
Status instance_restore(Instance *, const void *saved);
Status instance_serialize(Instance *, const void *saved, void *bytes, size_t size);
Status instance_deserialize(Instance *, const void *bytes, size_t size, void **slot);
void instance_free_saved(void **slot);

#endif
