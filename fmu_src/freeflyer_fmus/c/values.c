/* Reading and setting of values by value reference. */
#include "internal.h"

int instance_extent(unsigned reference)
{
    return reference < (unsigned)block.values ? block.value[reference].extent : 0;
}

static Status reject_reference(Instance *c, unsigned reference, Kind kind)
{
    static const char *const kinds[] = {"a real", "a Boolean", "an enumeration"};
    message_begin(&c->message, "value reference ");
    message_add_number(&c->message, reference);
    message_add(&c->message, " is not ");
    message_add(&c->message, kinds[kind]);
    message_add(&c->message, " variable of this FMU");
    return instance_report(c, ERROR, MISUSE);
}

static inline int is_reference(unsigned reference, Kind kind)
{
    return reference < (unsigned)block.values && block.value[reference].kind == kind;
}

static inline int extent(unsigned reference, int whole)
{
    return whole ? block.value[reference].extent : 1;
}

/* Returns which outputs to compute for the list: ALL if the list contains an output that is not a
   linked output, and LINKED otherwise. */
static int wanted_outputs(References list)
{
    for (size_t i = 0; i < list.n; i++)
        if (inside(list.reference[i], block.outputs) &&
            (int)list.reference[i] >= block.outputs.first + block.linked)
            return ALL;
    return LINKED;
}

Status instance_get(Instance *c, References list, int whole, Kind kind, double *value)
{
    Memory *m = c->memory;
    for (size_t i = 0; i < list.n; i++) {
        unsigned reference = list.reference[i];
        if (!is_reference(reference, kind))
            return reject_reference(c, reference, kind);
        const double *from = m->value + reference;
        if (inside(reference, block.outputs)) {
            int level = (int)reference < block.outputs.first + block.linked ? LINKED : ALL;
            if (m->outputs_valid < level && instance_update_outputs(c, wanted_outputs(list)) != OK)
                return instance_report(c, ERROR, REQUIREMENT);
        } else if (inside(reference, block.derivatives)) {
            if (!m->rates_valid && instance_update_rates(c) != OK)
                return instance_report(c, ERROR, REQUIREMENT);
        } else if (reference == TIME) {
            m->value[TIME] = m->clock;
        } else if (m->state == INITIALIZATION && inside(reference, block.states)) {
            from = instance_present_states(c) + ((int)reference - block.states.first);
        }
        /* The first element is copied before the loop. For a scalar, this copy is faster than a
           loop with one iteration. */
        *value++ = from[0];
        for (int k = 1, n = extent(reference, whole); k < n; k++)
            *value++ = from[k];
    }
    return OK;
}

Status instance_reject(Instance *c, unsigned index, double value, const char *reason)
{
    message_begin(&c->message, block.value[index].name);
    message_add(&c->message, " cannot be set to ");
    message_add_number(&c->message, value);
    message_add(&c->message, reason);
    return instance_report(c, DISCARD, MISUSE);
}

static Status reject_access(Instance *c, const Value *variable)
{
    message_begin(&c->message, variable->name);
    message_add(&c->message, variable->access == READ_ONLY ? " cannot be set: it is computed"
                             : variable->access == FIXED || variable->access == START
                                 ? " cannot be set any more: it is fixed after initialisation"
                                 : " cannot be set in this state");
    return instance_report(c, ERROR, MISUSE);
}

Status instance_check(Instance *c, References list, int whole, Kind kind, const double *value)
{
    static const int allowed[] = {
        [READ_ONLY] = 0,
        [FIXED] = INSTANTIATED | INITIALIZATION,
        [TUNABLE] = INSTANTIATED | INITIALIZATION | STEP | EVENT,
        [INPUT] = INSTANTIATED | INITIALIZATION | STEP | EVENT | CONTINUOUS | INTERMEDIATE,
        [START] = INSTANTIATED | INITIALIZATION,
    };
    int state = (int)c->memory->state;
    for (size_t i = 0; i < list.n; i++) {
        unsigned reference = list.reference[i];
        if (!is_reference(reference, kind))
            return reject_reference(c, reference, kind);
        const Value *variable = &block.value[reference];
        if (!(state & allowed[variable->access]))
            return reject_access(c, variable);
        for (int k = 0, n = extent(reference, whole); k < n; k++, value++) {
            if (!is_finite(*value))
                return instance_reject(c, reference + (unsigned)k, *value,
                                       ": it must be a finite number");
            if (kind == ENUMERATION && (*value < 1 || *value > variable->maximum))
                return instance_reject(c, reference + (unsigned)k, *value,
                                       ": it is not an item of the enumeration");
        }
    }
    return OK;
}

void instance_put(Instance *c, References list, int whole, const double *value)
{
    Memory *m = c->memory;
    for (size_t i = 0; i < list.n; i++) {
        unsigned reference = list.reference[i];
        double *to = m->value + reference;
        to[0] = *value++;
        for (int k = 1, n = extent(reference, whole); k < n; k++)
            to[k] = *value++;
        if (!inside(reference, block.inputs))
            m->parameters_checked = 0;
    }
    if (list.n > 0)
        instance_changed(c);
}
