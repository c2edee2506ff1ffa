/* Instance of the block: values, life cycle, steps. fmi2.c and fmi3.c translate FMI calls to calls
   of these functions. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "block.h"
#include "message.h"

/* Status of a call. The numbers are those of fmi2Status and fmi3Status. */
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;

/* Bit flags. A sum of flags is a set of states, for example those in which a call is allowed. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    STEP = 4,          /* co-simulation, between steps */
    EVENT = 8,         /* model exchange */
    CONTINUOUS = 16,   /* model exchange */
    INTERMEDIATE = 32, /* co-simulation, inside a step: during the importer's intermediate update */
    TERMINATED = 64,
    /* Not a state. If `states` of instance_allow contains this flag, the function is allowed only
       in model exchange. */
    MODEL_EXCHANGE = 128
} State;

/* States in which values may be read. */
#define INITIALIZED (INITIALIZATION | STEP | EVENT | CONTINUOUS | INTERMEDIATE | TERMINATED)

/* Which outputs are valid. LINKED: the first outputs of the block, up to and including the last
   output that belongs to a terminal. */
typedef enum { NONE, LINKED, ALL } Outputs;

typedef struct {
    uint64_t identity; /* hash of the token and the interface type */
    State state;
    int outputs_valid; /* Outputs */
    /* The rates are the derivatives of the states. */
    int rates_valid, parameters_checked;
    int64_t start, stop, next_sample; /* ns */
    double clock;                     /* s; the exact time given by the importer */
    double value[];                   /* the value vector, then the integrator's rounding errors */
} Memory;

typedef struct Instance {
    const char *name;
    int model_exchange;
    int inputs_complete; /* nonzero while instance_exit_initialization checks the requirements */
    void *environment;
    void (*log)(struct Instance *, Status, const char *category, const char *text);
    void *log_target[2];
    /* Called at the end of an inner step. A nonzero result ends the communication step. The pointer
       may be NULL. */
    int (*intermediate_update)(struct Instance *, double time);
    void *update_target[2];
    int may_return_early;
    Message message;
    double *scratch;              /* memory for one evaluation or integration step */
    double *saved;                /* states, rounding errors and inputs before a step */
    double *initial;              /* for instance_present_states: states after initialisation */
    double *seed, *result, *part; /* for instance_sensitivity; size of the value vector */
    Memory *memory;               /* content of a saved FMU state */
} Instance;

/* Returns why an instance cannot be created, or NULL. */
const char *instance_rejection(const char *name, const char *token, int model_exchange);
#define NO_MEMORY "out of memory: the instance cannot be allocated"
Instance *instance_new(const char *name, int model_exchange); /* NULL if out of memory */
void instance_free(Instance *);
/* Resets all values to their start values. */
void instance_reset(Instance *);
/* Sends the message to the log and returns `status`. */
Status instance_report(Instance *, Status status, const char *category);
/* Returns OK if the function may be called in the present state and `given` is nonzero. The caller
   sets `given` to zero if a needed pointer is NULL. */
Status instance_allow(Instance *, const char *function, int states, int given);
/* Reports "this FMU has no ..." and returns ERROR. */
Status instance_unsupported(Instance *, const char *what);
/* Returns OK if all `categories` are log categories of this FMU. */
Status instance_check_categories(Instance *, const char *const categories[], size_t n);

/* Reading and setting of values by value reference. If `whole` is nonzero, a reference denotes a
   variable with all its elements (FMI 3.0). If `whole` is zero, a reference denotes one element
   (FMI 2.0). To set values, call `instance_check` for all values first. It checks whether the
   values may be set now, are in their ranges and are finite. Then call `instance_put`. */
typedef struct {
    const unsigned *reference;
    size_t n;
} References;
Status instance_get(Instance *, References, int whole, Kind kind, double *value);
Status instance_check(Instance *, References, int whole, Kind kind, const double *value);
void instance_put(Instance *, References, int whole, const double *value);
/* Returns the size of the variable with this reference, or 0 if there is no such variable. */
int instance_extent(unsigned reference);

/* Sets the start time and the stop time. `stop` is INFINITY if the stop time is undefined. */
Status instance_set_up(Instance *, double start, double stop);
void instance_enter_initialization(Instance *);
Status instance_exit_initialization(Instance *);
/* Makes a communication step. After ERROR, the instance has not changed, and the importer may try
   another step. */
Status instance_step(Instance *, double time, double size);

/* Model exchange. */
Status instance_set_time(Instance *, double time);
Status instance_set_states(Instance *, const double *x, size_t n);
Status instance_get_states(Instance *, double *x, size_t n);
Status instance_get_rates(Instance *, double *dx, size_t n);
Status instance_get_nominals(Instance *, double *nominals, size_t n);

/* Computes directional derivatives of unknowns by knowns at the present values. Unknowns are
   outputs, derivatives, and states that are visible as outputs. Knowns are time, real parameters,
   inputs and states. For a sampled block, the derivatives are computed as if the block took a
   sample at the present time. Forward: `seed` has one value per known, and `result` one value per
   unknown. Reverse: `seed` has one value per unknown, and `result` one value per known. */
Status instance_sensitivity(Instance *, References unknowns, References knowns, int whole,
                            int reverse, const double *seed, size_t seeds, double *result,
                            size_t results);
/* Saved states. A saved state is a flat copy of `Memory`, and `*slot` points to it. If `*slot`
   is NULL, instance_save and instance_deserialize allocate a saved state. */
size_t instance_memory_size(void);
size_t instance_serialized_size(void); /* includes a checksum */
Status instance_save(Instance *, void **slot);
Status instance_restore(Instance *, const void *saved);
Status instance_serialize(Instance *, const void *saved, void *bytes, size_t size);
Status instance_deserialize(Instance *, const void *bytes, size_t size, void **slot);
void instance_free_saved(void **slot);

#endif
