/* Interface between a block and the runtime. The generated block.c defines `block`. */
#ifndef BLOCK_H
#define BLOCK_H

#include <stddef.h>

/* t [s], parameters, inputs, states -> up to three result vectors. */
typedef void Equations(const double *t, const double *p, const double *u, const double *x,
                       double *r0, double *r1, double *r2);

/* The directional derivative of such a function. Forward: `seed` is a direction of (t, p, u, x),
   and the result is the derivative of r0 (followed by r1). Reverse: the seed belongs to the
   results. */
typedef void Sensitivity(const double *t, const double *p, const double *u, const double *x,
                         const double *seed, double *result);

typedef enum { REAL, BOOLEAN, ENUMERATION } Kind;

/* Access to a value: read only; settable until initialisation ends; settable between steps too;
   input; start value of a state. */
typedef enum { READ_ONLY, FIXED, TUNABLE, INPUT, START } Access;

/* One entry per value. The value reference is the index in the value vector. An array's value
   reference is that of its first element. */
typedef struct {
    const char *name;      /* of the element, FMI 2.0 structured naming */
    unsigned char kind;    /* Kind */
    unsigned char access;  /* Access */
    unsigned char maximum; /* largest value of an enumeration */
    unsigned short extent; /* size of the variable that starts here; 0 for its further elements */
} Value;

/* A requirement. Margins are pairs (value, minimum), in the same order. */
typedef struct {
    const char *subject, *remedy;
    int strict;
} Requirement;

/* A range of the value vector. Order: time, parameters, inputs, states, outputs, derivatives. */
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
    /* continuous: r0 the first `linked` outputs (up to the last one in a terminal), r1 margins */
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
