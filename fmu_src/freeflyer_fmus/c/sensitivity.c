/* Directional and adjoint derivatives from the generated forward and reverse functions. */
#include "internal.h"

#include <string.h>

static int is_known(unsigned i)
{
    int real = block.value[i].kind == REAL;
    return i == TIME || inside(i, block.inputs) || inside(i, block.states) ||
           (real && inside(i, block.parameters));
}

static int is_unknown(unsigned i)
{
    return inside(i, block.outputs) || inside(i, block.states) || inside(i, block.derivatives);
}

/* Returns the number of elements that the list refers to. If `allowed` rejects a reference, writes
   a message that ends in `kind` and returns -1. */
static long count(Instance *c, References list, int whole, int (*allowed)(unsigned),
                  const char *kind)
{
    long sum = 0;
    for (size_t i = 0; i < list.n; i++) {
        int extent = instance_extent(list.reference[i]);
        if (list.reference[i] >= (unsigned)block.values || (whole && extent == 0) ||
            !allowed(list.reference[i])) {
            message_begin(&c->message, "value reference ");
            message_add_number(&c->message, list.reference[i]);
            message_add(&c->message, kind);
            return -1;
        }
        sum += whole ? extent : 1;
    }
    return sum;
}

/* Adds the values at `from` to the elements of `vector` (value vector) that the list refers to. */
static void scatter(References list, int whole, const double *from, double *vector)
{
    for (size_t i = 0; i < list.n; i++) {
        int n = whole ? instance_extent(list.reference[i]) : 1;
        for (int k = 0; k < n; k++)
            vector[list.reference[i] + (unsigned)k] += *from++;
    }
}

/* Copies the elements of `vector` (value vector) that the list refers to. */
static void gather(References list, int whole, const double *vector, double *to)
{
    for (size_t i = 0; i < list.n; i++) {
        int n = whole ? instance_extent(list.reference[i]) : 1;
        for (int k = 0; k < n; k++)
            *to++ = vector[list.reference[i] + (unsigned)k];
    }
}

/* Computes forward derivatives. In initialization mode, the states depend on their start values. In
   this mode, "derivative by a state" means the derivative by its start value. */
static void forward(Instance *c, const double *x, double *seed, double *result)
{
    const double *t = &c->memory->clock, *p = at(c, block.parameters), *u = at(c, block.inputs);
    size_t size = (size_t)block.states.count * sizeof(double);
    if (c->memory->state == INITIALIZATION) {
        block.forward_initial(t, p, u, at(c, block.states), seed, c->scratch);
        memcpy(seed + block.states.first, c->scratch, size);
    }
    if (block.period >= 0) {
        block.forward_update(t, p, u, x, seed, result + block.states.first);
        /* Before the first sample, an importer that reads a state gets the initial value. */
        if (c->memory->state == INITIALIZATION)
            memcpy(result + block.states.first, seed + block.states.first, size);
        return;
    }
    memcpy(result + block.states.first, seed + block.states.first, size);
    block.forward_outputs(t, p, u, x, seed, result + block.outputs.first);
    block.forward_rates(t, p, u, x, seed, result + block.derivatives.first);
}

static void add(double *sum, const double *part, int count)
{
    for (int i = 0; i < count; i++)
        sum[i] += part[i];
}

/* Computes adjoint derivatives: the steps of `forward`, transposed and in reverse order. */
static void reverse(Instance *c, const double *x, double *seed, double *result)
{
    const double *t = &c->memory->clock, *p = at(c, block.parameters), *u = at(c, block.inputs);
    int first = block.states.first, n = block.states.count, knowns = first + n;
    if (block.period >= 0) {
        if (c->memory->state == INITIALIZATION) {
            memcpy(c->scratch, seed + first, (size_t)n * sizeof(double));
            memset(seed + first, 0, (size_t)n * sizeof(double));
        }
        block.reverse_update(t, p, u, x, seed + first, result);
        if (c->memory->state == INITIALIZATION)
            add(result + first, c->scratch, n);
    } else {
        block.reverse_outputs(t, p, u, x, seed + block.outputs.first, result);
        block.reverse_rates(t, p, u, x, seed + block.derivatives.first, c->part);
        add(result, c->part, knowns);
        add(result + first, seed + first, n);
    }
    if (c->memory->state == INITIALIZATION) {
        block.reverse_initial(t, p, u, at(c, block.states), result + first, c->part);
        memset(result + first, 0, (size_t)n * sizeof(double));
        add(result, c->part, knowns);
    }
}

static Status fail(Instance *c) { return instance_report(c, ERROR, MISUSE); }

Status instance_sensitivity(Instance *c, References unknowns, References knowns, int whole,
                            int is_reverse, const double *seed, size_t seeds, double *result,
                            size_t results)
{
    long nu =
        count(c, unknowns, whole, is_unknown, " is not an output, state or derivative of this FMU");
    if (nu < 0)
        return fail(c);
    long nk = count(c, knowns, whole, is_known,
                    " is not the time, a real parameter, an input or a state of this FMU");
    if (nk < 0)
        return fail(c);
    if (seeds != (size_t)(is_reverse ? nu : nk) || results != (size_t)(is_reverse ? nk : nu)) {
        message_begin(&c->message, "the unknowns have ");
        message_add_number(&c->message, (double)nu);
        message_add(&c->message, " elements and the knowns ");
        message_add_number(&c->message, (double)nk);
        message_add(&c->message, "; the lengths of seed and sensitivity differ from these numbers");
        return fail(c);
    }
    size_t size = (size_t)block.values * sizeof(double);
    memset(c->seed, 0, size);
    memset(c->result, 0, size);
    scatter(is_reverse ? unknowns : knowns, whole, seed, c->seed);
    const double *x = instance_present_states(c);
    if (is_reverse)
        reverse(c, x, c->seed, c->result);
    else
        forward(c, x, c->seed, c->result);
    if (instance_check_finite(c, 0, block.values, c->result,
                              " as a derivative along the seed; check seed, states and inputs") !=
        OK)
        return instance_report(c, ERROR, REQUIREMENT);
    gather(is_reverse ? knowns : unknowns, whole, c->result, result);
    return OK;
}
