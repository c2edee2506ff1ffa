/* Interface between a block and the runtime. The generated block.c defines `block`. */
#ifndef BLOCK_H
#define BLOCK_H

#include <stddef.h>

/* Computes up to three result vectors from time t [s], parameters p, inputs u and states x. */
typedef void Equations(const double *t, const double *p, const double *u, const double *x,
                       double *r0, double *r1, double *r2);

/* Directional derivative of an `Equations` function. J is the Jacobian of r0 by (t, p, u, x). For
   `update`, J is the Jacobian of (r0, r1). Forward: `result` is J seed, and `seed` has the size of
   (t, p, u, x). Reverse: `result` is J^T seed, and `seed` has the size of the result vectors. */
typedef void Sensitivity(const double *t, const double *p, const double *u, const double *x,
                         const double *seed, double *result);

typedef enum { REAL, BOOLEAN, ENUMERATION } Kind;

/* When a value can be set. READ_ONLY: never. FIXED (a parameter) and START (the start value of a
   state): until the end of initialisation. TUNABLE (a parameter): also between steps and in event
   mode. INPUT: in every state except TERMINATED. */
typedef enum { READ_ONLY, FIXED, TUNABLE, INPUT, START } Access;

/* Description of one value. The value reference is the index in the value vector. The value
   reference of an array is the index of its first element. */
typedef struct {
    const char *name;      /* name of the element in FMI 2.0's structured naming */
    unsigned char kind;    /* Kind */
    unsigned char access;  /* Access */
    unsigned char maximum; /* largest value of an enumeration */
    unsigned short extent; /* size of the variable at its first element, 0 at all others */
} Value;

/* Condition value >= minimum, or value > minimum if `strict` is nonzero. The block's functions
   return the pair (value, minimum) of each requirement as its margin, in the order of the
   requirements. If `connection` is nonzero, the condition shows that an input is connected. */
typedef struct {
    const char *subject, *remedy;
    int strict, connection;
} Requirement;

/* Range of the value vector. The order of the values is time, parameters, inputs, states, outputs,
   derivatives. */
typedef struct {
    int first, count;
} Range;

typedef struct {
    const char *name, *token;
    int values;
    Range parameters, inputs, states, outputs, derivatives;
    const Value *value;
    const double *start;
    const double *nominal; /* nominal values of the states */
    int period;            /* index of the sampling period, or -1 for a continuous block */
    double step;           /* integration step of a continuous block [s] if no parameter sets it */
    int step_parameter;    /* index of the parameter that sets the integration step, or -1 */
    Equations *initial;    /* r0: states after initialisation */
    Equations *check;      /* r0: margins of the requirements on parameters */
    Equations *update;     /* sampled: r0 new states, r1 outputs, r2 margins */
    Equations *rates;      /* continuous: r0 derivatives */
    Equations *outputs_;   /* continuous: r0 outputs, r1 margins */
    /* continuous: r0 the linked outputs, r1 margins. The linked outputs are the first `linked`
       outputs: all outputs up to and including the last output that is in a terminal. */
    Equations *linked_outputs;
    int linked;
    /* Derivatives of initial, update, rates and outputs_. */
    Sensitivity *forward_initial, *forward_update, *forward_rates, *forward_outputs;
    Sensitivity *reverse_initial, *reverse_update, *reverse_rates, *reverse_outputs;
    int static_requirements, running_requirements;
    const Requirement *static_requirement, *running_requirement;
} Block;

extern const Block block;

#endif
