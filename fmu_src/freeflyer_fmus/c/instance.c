/* Life cycle of an instance. */
#include "internal.h"

#include <stdlib.h>
#include <string.h>

#include "integrate.h"

static int same_text(const char *a, const char *b)
{
    while (*a && *a == *b)
        a++, b++;
    return *a == *b;
}

/* Returns the FNV-1a hash of `text`. */
static uint64_t hash(const char *text, uint64_t seed)
{
    uint64_t value = 14695981039346656037ULL ^ seed;
    for (; *text; text++)
        value = (value ^ (unsigned char)*text) * 1099511628211ULL;
    return value;
}

size_t instance_memory_size(void)
{
    return sizeof(Memory) + (size_t)(block.values + block.states.count) * sizeof(double);
}

const char *instance_rejection(const char *name, const char *token, int model_exchange)
{
    if (!name)
        return "an instance needs a name";
    if (!token || !same_text(token, block.token))
        return "the instantiation token does not match this library: modelDescription.xml and "
               "binary are of different builds";
    if (model_exchange && block.period >= 0)
        return "this FMU is sampled and has no model exchange interface";
    return NULL;
}

Instance *instance_new(const char *name, int model_exchange)
{
    size_t length = 0;
    while (name[length])
        length++;
    /* One allocation contains instance, name, memory and scratch. The size of the name is a
       multiple of 8 bytes. */
    size_t name_size = (length / sizeof(double) + 1) * sizeof(double);
    /* `scratch` has space for an integration step, or for the states, outputs and margins of one
       evaluation. */
    int n = block.states.count, evaluated = n + block.outputs.count;
    int margins =
        2 * (block.running_requirements > block.static_requirements ? block.running_requirements
                                                                    : block.static_requirements);
    int work =
        INTEGRATE_SCRATCH(n) > evaluated + margins ? INTEGRATE_SCRATCH(n) : evaluated + margins;
    size_t scratch =
        (size_t)(work + 2 * n + block.inputs.count + n + 3 * block.values) * sizeof(double);
    char *memory = calloc(1, sizeof(Instance) + name_size + instance_memory_size() + scratch);
    if (!memory)
        return NULL;
    Instance *c = (Instance *)memory;
    memcpy(memory + sizeof(Instance), name, length);
    c->name = memory + sizeof(Instance);
    c->memory = (Memory *)(memory + sizeof(Instance) + name_size);
    c->scratch = (double *)(memory + sizeof(Instance) + name_size + instance_memory_size());
    c->saved = c->scratch + work;
    c->initial = c->saved + 2 * n + block.inputs.count;
    c->seed = c->initial + n;
    c->result = c->seed + block.values;
    c->part = c->result + block.values;
    c->model_exchange = model_exchange;
    instance_reset(c);
    return c;
}

void instance_free(Instance *c) { free(c); }

void instance_reset(Instance *c)
{
    memset(c->memory, 0, instance_memory_size());
    c->memory->stop = INT64_MAX;
    memcpy(c->memory->value, block.start, (size_t)block.values * sizeof(double));
    c->memory->identity = hash(block.token, (uint64_t)c->model_exchange);
    c->memory->state = INSTANTIATED;
}

Status instance_report(Instance *c, Status status, const char *category)
{
    if (c->log)
        c->log(c, status, category, c->message.text);
    return status;
}

Status instance_unsupported(Instance *c, const char *what)
{
    message_begin(&c->message, "this FMU has no ");
    message_add(&c->message, what);
    return instance_report(c, ERROR, MISUSE);
}

Status instance_allow(Instance *c, const char *function, int states, int given)
{
    static const struct {
        State state;
        const char *name;
    } names[] = {{INSTANTIATED, "instantiated"},
                 {INITIALIZATION, "initialization mode"},
                 {STEP, "step mode"},
                 {EVENT, "event mode"},
                 {CONTINUOUS, "continuous-time mode"},
                 {INTERMEDIATE, "intermediate update mode"},
                 {TERMINATED, "terminated"}};
    if (((int)c->memory->state & states) && given &&
        (c->model_exchange || !(states & MODEL_EXCHANGE)))
        return OK;
    message_begin(&c->message, function);
    if (states & MODEL_EXCHANGE && !c->model_exchange) {
        message_add(&c->message,
                    " belongs to model exchange, and this instance is for co-simulation");
        return instance_report(c, ERROR, MISUSE);
    }
    if (!((int)c->memory->state & states)) {
        message_add(&c->message, " is not allowed in the state ");
        for (size_t i = 0; i < sizeof names / sizeof *names; i++)
            if (names[i].state == c->memory->state)
                message_add(&c->message, names[i].name);
        return instance_report(c, ERROR, MISUSE);
    }
    message_add(&c->message, " was given a null pointer");
    return instance_report(c, ERROR, MISUSE);
}

Status instance_check_categories(Instance *c, const char *const categories[], size_t n)
{
    for (size_t i = 0; i < n; i++) {
        if (categories && categories[i] &&
            (same_text(categories[i], MISUSE) || same_text(categories[i], REQUIREMENT)))
            continue;
        message_begin(&c->message, "log category ");
        message_add(&c->message, categories && categories[i] ? categories[i] : "(null)");
        message_add(&c->message, " does not exist; this FMU has " MISUSE " and " REQUIREMENT);
        return instance_report(c, ERROR, MISUSE);
    }
    return OK;
}

Status instance_set_up(Instance *c, double start, double stop)
{
    int bounded = !isinf(stop) || stop < 0, sound = fabs(start) < LARGEST_TIME;
    if (sound && (!bounded || (stop >= start && stop < LARGEST_TIME))) {
        c->memory->clock = start;
        c->memory->stop = bounded ? nanoseconds(stop) : INT64_MAX;
        return OK;
    }
    message_begin(&c->message, sound ? "the stop time cannot be " : "the start time cannot be ");
    message_add_number(&c->message, sound ? stop : start);
    message_add(&c->message,
                sound && stop < start ? " s: it is before the start time" : " s: " TIMES);
    return instance_report(c, ERROR, MISUSE);
}

void instance_enter_initialization(Instance *c)
{
    Memory *m = c->memory;
    m->start = m->next_sample = nanoseconds(m->clock);
    m->state = INITIALIZATION;
}

Status instance_exit_initialization(Instance *c)
{
    Memory *m = c->memory;
    if (instance_check_parameters(c) != OK)
        return instance_report(c, ERROR, REQUIREMENT);
    if (block.period >= 0 &&
        !(m->value[block.period] >= 1e-9 && m->value[block.period] < LARGEST_TIME)) {
        message_begin(&c->message,
                      "the sampling period must be at least 1 ns and below 2e9 s, not ");
        message_add_number(&c->message, m->value[block.period]);
        message_add(&c->message, " s");
        return instance_report(c, ERROR, MISUSE);
    }
    m->outputs_valid = NONE;
    m->rates_valid = 0;
    c->inputs_complete = 1;
    Status valid = instance_update_outputs(c, ALL);
    c->inputs_complete = 0;
    if (valid != OK)
        return instance_report(c, ERROR, REQUIREMENT);
    memcpy(at(c, block.states), instance_present_states(c),
           (size_t)block.states.count * sizeof(double));
    m->state = c->model_exchange ? EVENT : STEP;
    return OK;
}
