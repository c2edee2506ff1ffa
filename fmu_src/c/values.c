/* Values by value reference. */
#include "internal.h"

#include <string.h>

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
    Memory *m = c->memory;
    if (inside(reference, block.outputs) && instance_update_outputs(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    if (inside(reference, block.derivatives) && instance_update_rates(c) != OK)
        return instance_say(c, ERROR, REQUIREMENT);
    if (reference == TIME)
        m->value[TIME] = m->clock;
    const double *from = m->value + reference;
    if (inside(reference, block.states))
        from = instance_present_states(c) + ((int)reference - block.states.first);
    memcpy(value, from, (size_t)elements * sizeof(double));
    return OK;
}

Status instance_refuse(Instance *c, unsigned index, double value, const char *reason)
{
    message_begin(&c->message, block.value[index].name);
    message_add(&c->message, " cannot be set to ");
    message_add_number(&c->message, value);
    message_add(&c->message, reason);
    return instance_say(c, DISCARD, MISUSE);
}

Status instance_check(Instance *c, unsigned reference, Kind kind, int elements, const double *value)
{
    static const int allowed[] = {
        [READ_ONLY] = 0,
        [FIXED] = INSTANTIATED | INITIALIZATION,
        [TUNABLE] = INSTANTIATED | INITIALIZATION | STEP | EVENT,
        [INPUT] = INSTANTIATED | INITIALIZATION | STEP | EVENT | CONTINUOUS | INTERMEDIATE,
        [START] = INSTANTIATED | INITIALIZATION,
    };
    if (check_reference(c, reference, kind, elements) != OK)
        return ERROR;
    const Value *variable = &block.value[reference];
    if (!((int)c->memory->state & allowed[variable->access])) {
        message_begin(&c->message, variable->name);
        message_add(&c->message, variable->access == READ_ONLY                       ? " cannot be set: it is computed"
                                 : variable->access == FIXED || variable->access == START ? " cannot be set any more: it is fixed once the run has begun"
                                                                                      : " cannot be set in this state");
        return instance_say(c, ERROR, MISUSE);
    }
    for (int i = 0; i < elements; i++) {
        if (!is_finite(value[i]))
            return instance_refuse(c, reference + (unsigned)i, value[i], ": it must be a finite number");
        if (kind == ENUMERATION && (value[i] < 1 || value[i] > variable->maximum))
            return instance_refuse(c, reference + (unsigned)i, value[i], ": it is none of the enumeration's items");
    }
    return OK;
}

void instance_put(Instance *c, unsigned reference, int elements, const double *value)
{
    memcpy(c->memory->value + reference, value, (size_t)elements * sizeof(double));
    if (inside(reference, block.parameters) || inside(reference, block.states))
        c->memory->parameters_checked = 0;
    instance_changed(c);
}
