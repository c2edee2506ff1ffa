/* What a block is to the runtime. The generated block.c defines one `block`; everything else here is the same for all. */
#ifndef BLOCK_H
#define BLOCK_H

#include <stddef.h>

/* t [s], parameters, inputs, states -> up to three result vectors. */
typedef void Equations(const double *t, const double *p, const double *u, const double *x,
                       double *r0, double *r1, double *r2);

/* The derivative of such a function along `seed`. Forward: the seed is of (t, p, u, x), the result of r0 (and r1 after it);
   reverse: the other way round. */
typedef void Sensitivity(const double *t, const double *p, const double *u, const double *x,
                         const double *seed, double *result);

typedef enum { REAL, BOOLEAN, ENUMERATION } Kind;

/* When a value may be set: never, before initialisation ends, also between steps, as an input, as a state's start value. */
typedef enum { READ_ONLY, FIXED, TUNABLE, INPUT, START } Access;

/* One entry per value. The value reference is its index in the value vector; an array's is that of its first element. */
typedef struct {
    const char *name;      /* of the element, FMI 2.0 structured naming */
    unsigned char kind;    /* Kind */
    unsigned char access;  /* Access */
    unsigned char maximum; /* largest value of an enumeration */
    unsigned short extent; /* elements of the variable that begins here; 0 inside an array */
} Value;

/* Margins are pairs (value, minimum), in the order of these. */
typedef struct {
    const char *subject, *remedy;
    int strict;
} Requirement;

/* A range of the value vector: time, parameters, inputs, states, outputs, derivatives follow one another in it. */
typedef struct {
    int first, count;
} Range;

typedef struct {
    const char *name, *token;
    int values;
    Range parameters, inputs, states, outputs, derivatives;
    const Value *value;
    const double *start;
    const double *nominal; /* of the states */
    int period;            /* index of the sampling period, or -1 for a continuous block */
    double step;           /* integration step of a continuous block [s] */
    Equations *initial;    /* r0: states after initialisation */
    Equations *check;      /* r0: margins of the requirements on parameters */
    Equations *update;     /* sampled: r0 new states, r1 outputs, r2 margins */
    Equations *rates;      /* continuous: r0 derivatives */
    Equations *outputs_;   /* continuous: r0 outputs, r1 margins */
    Equations *
        linked_outputs; /* continuous: the first `linked` of them, which are made to be connected, and all margins */
    int linked;
    /* Of initial, update, rates and outputs_. */
    Sensitivity *forward_initial, *forward_update, *forward_rates, *forward_outputs;
    Sensitivity *reverse_initial, *reverse_update, *reverse_rates, *reverse_outputs;
    int static_requirements, running_requirements;
    const Requirement *static_requirement, *running_requirement;
} Block;

extern const Block block;

#endif
