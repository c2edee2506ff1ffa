#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "integrate.h"

#define TIME 0
/* Log categories: a wrong call, and a run that has left what the equations hold for. The description declares both. */
#define MISUSE "logStatusError"
#define REQUIREMENT "logRequirement"
#define NANOSECOND 1 /* tolerance when times that were doubles are compared */

static double *at(Instance *c, Range range) { return c->memory->value + range.first; }

static double *lost(Instance *c) { return c->memory->value + block.values; }

static int inside(unsigned index, Range range)
{
    return (int)index >= range.first && (int)index < range.first + range.count;
}

static int is_finite(double x) { return fabs(x) <= 1.7976931348623157e308; }

static int64_t nanoseconds(double seconds) { return llround(seconds * 1e9); }

size_t instance_memory_size(void) { return sizeof(Memory) + (size_t)(block.values + block.states.count) * sizeof(double); }

Instance *instance_new(const char *name, const char *token, int model_exchange)
{
    if (!name || !token || strcmp(token, block.token) != 0)
        return NULL;
    /* One piece of memory: instance, name, memory, scratch. The name's length is rounded up to keep doubles aligned. */
    size_t name_size = (strlen(name) / sizeof(double) + 1) * sizeof(double);
    int widest = block.outputs.count > block.states.count ? block.outputs.count : block.states.count;
    int margins = 2 * (block.running_requirements > block.static_requirements ? block.running_requirements : block.static_requirements);
    size_t scratch = (size_t)(INTEGRATE_SCRATCH(block.states.count) + 2 * widest + margins + 1) * sizeof(double);
    char *memory = calloc(1, sizeof(Instance) + name_size + instance_memory_size() + scratch);
    if (!memory)
        return NULL;
    Instance *c = (Instance *)memory;
    memcpy(memory + sizeof(Instance), name, strlen(name));
    c->name = memory + sizeof(Instance);
    c->memory = (Memory *)(memory + sizeof(Instance) + name_size);
    c->scratch = (double *)(memory + sizeof(Instance) + name_size + instance_memory_size());
    c->model_exchange = model_exchange;
    instance_reset(c);
    return c;
}

void instance_free(Instance *c) { free(c); }

void instance_reset(Instance *c)
{
    memset(c->memory, 0, instance_memory_size());
    memcpy(c->memory->value, block.start, (size_t)block.values * sizeof(double));
    c->memory->state = INSTANTIATED;
}

Status instance_say(Instance *c, Status status, const char *category)
{
    if (c->log)
        c->log(c, status, category, c->message.text);
    return status;
}

static Status fail(Instance *c, const char *category)
{
    c->memory->state = FAILED;
    return instance_say(c, ERROR, category);
}

Status instance_allow(Instance *c, const char *function, int states)
{
    static const struct {
        State state;
        const char *name;
    } names[] = {{INSTANTIATED, "instantiated"}, {INITIALIZATION, "initialization mode"}, {STEP, "step mode"},
                 {EVENT, "event mode"},          {CONTINUOUS, "continuous-time mode"},    {TERMINATED, "terminated"},
                 {FAILED, "failed"}};
    if ((int)c->memory->state & states)
        return OK;
    message_begin(&c->message, function);
    message_add(&c->message, " is not allowed in the state ");
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (names[i].state == c->memory->state)
            message_add(&c->message, names[i].name);
    return instance_say(c, ERROR, MISUSE);
}

/* The first margin below its minimum, told with its value; NaN is below everything. */
static Status check_margins(Instance *c, const Requirement *requirement, int count, const double *margin)
{
    for (int i = 0; i < count; i++) {
        double value = margin[2 * i], minimum = margin[2 * i + 1];
        if (requirement[i].strict ? value > minimum : value >= minimum)
            continue;
        message_begin(&c->message, requirement[i].subject);
        message_add(&c->message, " is ");
        message_add_number(&c->message, value);
        message_add(&c->message, requirement[i].strict ? "; more than " : "; at least ");
        message_add_number(&c->message, minimum);
        message_add(&c->message, " is expected: ");
        message_add(&c->message, requirement[i].remedy);
        return ERROR;
    }
    return OK;
}

static Status check_parameters(Instance *c)
{
    Memory *m = c->memory;
    if (m->parameters_checked)
        return OK;
    block.check(&m->clock, at(c, block.parameters), at(c, block.inputs), at(c, block.states), c->scratch, 0, 0);
    if (check_margins(c, block.static_requirement, block.static_requirements, c->scratch) != OK)
        return ERROR;
    m->parameters_checked = 1;
    return OK;
}

/* New states into c->scratch, outputs into place, margins checked. */
static Status sample(Instance *c)
{
    Memory *m = c->memory;
    double *outputs = c->scratch + block.states.count, *margins = outputs + block.outputs.count;
    block.update(&m->clock, at(c, block.parameters), at(c, block.inputs), at(c, block.states), c->scratch, outputs, margins);
    if (check_margins(c, block.running_requirement, block.running_requirements, margins) != OK)
        return ERROR;
    memcpy(at(c, block.outputs), outputs, (size_t)block.outputs.count * sizeof(double));
    m->outputs_valid = 1;
    return OK;
}

static Status update_outputs(Instance *c)
{
    Memory *m = c->memory;
    if (m->outputs_valid)
        return OK;
    if (block.period >= 0)
        return sample(c);
    double *margins = c->scratch;
    block.outputs_(&m->clock, at(c, block.parameters), at(c, block.inputs), at(c, block.states), at(c, block.outputs), margins, 0);
    if (check_margins(c, block.running_requirement, block.running_requirements, margins) != OK)
        return ERROR;
    m->outputs_valid = 1;
    return OK;
}

static Status update_rates(Instance *c)
{
    Memory *m = c->memory;
    double *rates = at(c, block.derivatives);
    if (m->rates_valid || block.derivatives.count == 0)
        return OK;
    block.rates(&m->clock, at(c, block.parameters), at(c, block.inputs), at(c, block.states), rates, 0, 0);
    for (int i = 0; i < block.derivatives.count; i++)
        if (!is_finite(rates[i])) {
            message_begin(&c->message, block.value[block.derivatives.first + i].name);
            message_add(&c->message, " is not finite: check states, inputs and parameters");
            return ERROR;
        }
    m->rates_valid = 1;
    return OK;
}

/* A sampled block's outputs follow its inputs only while it is initialised: afterwards they are held. */
static void changed(Instance *c)
{
    if (block.period < 0 || (c->memory->state & (INSTANTIATED | INITIALIZATION)))
        c->memory->outputs_valid = 0;
    c->memory->rates_valid = 0;
}

int instance_extent(unsigned reference) { return reference < (unsigned)block.values ? block.value[reference].extent : 0; }

static Status check_reference(Instance *c, unsigned reference, Kind kind, int elements)
{
    static const char *const kinds[] = {"a real", "a Boolean", "an enumeration"};
    if (reference < (unsigned)block.values && (int)reference + elements <= block.values && block.value[reference].kind == kind)
        return OK;
    message_begin(&c->message, "value reference ");
    message_add_number(&c->message, reference);
    message_add(&c->message, " is not ");
    message_add(&c->message, kinds[kind]);
    message_add(&c->message, " variable of this FMU");
    return instance_say(c, ERROR, MISUSE);
}

Status instance_get(Instance *c, unsigned reference, Kind kind, int elements, double *value)
{
    if (check_reference(c, reference, kind, elements) != OK)
        return ERROR;
    if (inside(reference, block.outputs) && update_outputs(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    if (inside(reference, block.derivatives) && update_rates(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    if (reference == TIME)
        c->memory->value[TIME] = c->memory->clock;
    memcpy(value, c->memory->value + reference, (size_t)elements * sizeof(double));
    return OK;
}

static Status refuse(Instance *c, unsigned index, double value, const char *reason)
{
    message_begin(&c->message, block.value[index].name);
    message_add(&c->message, " cannot be set to ");
    message_add_number(&c->message, value);
    message_add(&c->message, reason);
    return instance_say(c, DISCARD, MISUSE);
}

Status instance_set(Instance *c, unsigned reference, Kind kind, int elements, const double *value)
{
    static const int allowed[] = {
        [READ_ONLY] = 0,
        [FIXED] = INSTANTIATED | INITIALIZATION,
        [TUNABLE] = INSTANTIATED | INITIALIZATION | STEP | EVENT,
        [INPUT] = INSTANTIATED | INITIALIZATION | STEP | EVENT | CONTINUOUS,
        [START] = INSTANTIATED | INITIALIZATION,
    };
    if (check_reference(c, reference, kind, elements) != OK)
        return ERROR;
    const Value *variable = &block.value[reference];
    if (!((int)c->memory->state & allowed[variable->access])) {
        message_begin(&c->message, variable->name);
        message_add(&c->message, variable->access == READ_ONLY ? " cannot be set: it is computed" : " cannot be set any more: it is fixed once the run has begun");
        return instance_say(c, ERROR, MISUSE);
    }
    for (int i = 0; i < elements; i++) {
        if (!(is_finite(value[i])))
            return refuse(c, reference + (unsigned)i, value[i], ": it must be a finite number");
        if (kind == ENUMERATION && (value[i] < 1 || value[i] > variable->maximum))
            return refuse(c, reference + (unsigned)i, value[i], ": it is none of the enumeration's items");
    }
    memcpy(c->memory->value + reference, value, (size_t)elements * sizeof(double));
    if (inside(reference, block.parameters))
        c->memory->parameters_checked = 0;
    changed(c);
    return OK;
}

Status instance_enter_initialization(Instance *c, double start)
{
    Memory *m = c->memory;
    m->clock = start;
    m->start = m->time = m->next_sample = nanoseconds(start);
    m->state = INITIALIZATION;
    return OK;
}

Status instance_exit_initialization(Instance *c)
{
    Memory *m = c->memory;
    double *x = at(c, block.states);
    if (check_parameters(c) != OK)
        return fail(c, REQUIREMENT);
    block.initial(&m->clock, at(c, block.parameters), at(c, block.inputs), x, c->scratch, 0, 0);
    memcpy(x, c->scratch, (size_t)block.states.count * sizeof(double));
    m->outputs_valid = 0;
    m->rates_valid = 0;
    if (update_outputs(c) != OK)
        return fail(c, REQUIREMENT);
    if (block.period >= 0 && !(c->memory->value[block.period] >= 1e-9)) {
        message_begin(&c->message, "the sampling period must be at least 1 ns");
        return fail(c, MISUSE);
    }
    m->state = c->model_exchange ? EVENT : STEP;
    return OK;
}

static Status step_sampled(Instance *c, int64_t begin, int64_t end, double size)
{
    Memory *m = c->memory;
    double period = m->value[block.period];
    if (begin + NANOSECOND >= m->next_sample) {
        if (sample(c) != OK)
            return fail(c, REQUIREMENT);
        memcpy(at(c, block.states), c->scratch, (size_t)block.states.count * sizeof(double));
        /* start + count x period, so that rounding never adds up. */
        int64_t count = llround((double)(m->next_sample - m->start) * 1e-9 / period);
        m->next_sample = m->start + llround((double)(count + 1) * period * 1e9);
    }
    if (end > m->next_sample + NANOSECOND) {
        message_begin(&c->message, "a communication step of ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s passes over a sample of this block, whose period is ");
        message_add_number(&c->message, period);
        message_add(&c->message, " s; choose a step that divides the period");
        return fail(c, MISUSE);
    }
    return OK;
}

static Status step_continuous(Instance *c, double time, double size)
{
    Memory *m = c->memory;
    int n = block.states.count;
    double *x = at(c, block.states), *saved = c->scratch + INTEGRATE_SCRATCH(n);
    memcpy(saved, x, (size_t)n * sizeof(double));
    memcpy(saved + n, lost(c), (size_t)n * sizeof(double));
    int64_t count = size > 0 ? (int64_t)ceil(size / block.step - 1e-9) : 0;
    double h = count > 0 ? size / (double)count : 0;
    for (int64_t i = 0; i < count && n > 0; i++)
        integrate_runge_kutta(block.rates, time + (double)i * h, h, at(c, block.parameters), at(c, block.inputs), x, lost(c), n, c->scratch);
    m->outputs_valid = 0;
    m->rates_valid = 0;
    for (int i = 0; i < n; i++) {
        if (is_finite(x[i]))
            continue;
        memcpy(x, saved, (size_t)n * sizeof(double));
        memcpy(lost(c), saved + n, (size_t)n * sizeof(double));
        message_begin(&c->message, block.value[block.states.first + i].name);
        message_add(&c->message, " did not stay finite in a step of ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s; the step was not made: check the inputs");
        return instance_say(c, DISCARD, REQUIREMENT);
    }
    return OK;
}

Status instance_step(Instance *c, double time, double size)
{
    Memory *m = c->memory;
    int64_t begin = nanoseconds(time), end = nanoseconds(time + size);
    if (!(size >= 0) || !(fabs(time + size) < 9e9) || begin - m->time > NANOSECOND || m->time - begin > NANOSECOND) {
        message_begin(&c->message, "a step from ");
        message_add_number(&c->message, time);
        message_add(&c->message, " s of size ");
        message_add_number(&c->message, size);
        message_add(&c->message, " s does not begin where the last one ended, at ");
        message_add_number(&c->message, (double)m->time * 1e-9);
        message_add(&c->message, " s, or has no valid size");
        return fail(c, MISUSE);
    }
    if (check_parameters(c) != OK)
        return fail(c, REQUIREMENT);
    m->clock = time;
    Status status = block.period >= 0 ? step_sampled(c, begin, end, size) : step_continuous(c, time, size);
    if (status != OK)
        return status;
    m->clock = time + size;
    m->time = end;
    /* Outputs wait until somebody asks, unless a requirement watches the motion. */
    if (block.running_requirements > 0 && update_outputs(c) != OK)
        return fail(c, REQUIREMENT);
    return OK;
}

void instance_set_time(Instance *c, double time)
{
    c->memory->clock = time;
    changed(c);
}

static Status check_count(Instance *c, size_t n)
{
    if ((int)n == block.states.count)
        return OK;
    message_begin(&c->message, "this FMU has ");
    message_add_number(&c->message, block.states.count);
    message_add(&c->message, " continuous states, not ");
    message_add_number(&c->message, (double)n);
    return instance_say(c, ERROR, MISUSE);
}

Status instance_set_states(Instance *c, const double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    for (size_t i = 0; i < n; i++)
        if (!(is_finite(x[i])))
            return refuse(c, (unsigned)block.states.first + (unsigned)i, x[i], ": it must be a finite number");
    memcpy(at(c, block.states), x, n * sizeof(double));
    changed(c);
    return OK;
}

Status instance_get_states(Instance *c, double *x, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    memcpy(x, at(c, block.states), n * sizeof(double));
    return OK;
}

Status instance_get_rates(Instance *c, double *dx, size_t n)
{
    if (check_count(c, n) != OK)
        return ERROR;
    if (update_rates(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    memcpy(dx, at(c, block.derivatives), n * sizeof(double));
    return OK;
}
