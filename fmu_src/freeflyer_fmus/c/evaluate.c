/* Evaluates the block's functions when their results are needed. Checks the requirements. */
#include "internal.h"

#include <string.h>

/* Returns ERROR if a requirement is violated. The message describes the first violated requirement.
   NaN violates every requirement. In initialization mode, an importer may read outputs before it
   sets the connected inputs. Until the mode ends, requirements on connections are not checked. */
static Status check_margins(Instance *c, const Requirement *requirement, int count,
                            const double *margin)
{
    int incomplete = c->memory->state == INITIALIZATION && !c->inputs_complete;
    for (int i = 0; i < count; i++) {
        double value = margin[2 * i], minimum = margin[2 * i + 1];
        if (incomplete && requirement[i].connection)
            continue;
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

Status instance_check_finite(Instance *c, int first, int count, const double *value,
                             const char *remedy)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += 0.0 * value[i]; /* NaN if any value is not finite */
    if (sum == 0)
        return OK;
    int i = 0;
    while (is_finite(value[i]))
        i++;
    message_begin(&c->message, block.value[first + i].name);
    message_add(&c->message, " is not finite");
    message_add(&c->message, remedy);
    return ERROR;
}

Status instance_check_parameters(Instance *c)
{
    Memory *m = c->memory;
    if (m->parameters_checked)
        return OK;
    block.check(&m->clock, at(c, block.parameters), at(c, block.inputs), at(c, block.states),
                c->scratch, 0, 0);
    if (check_margins(c, block.static_requirement, block.static_requirements, c->scratch) != OK)
        return ERROR;
    m->parameters_checked = 1;
    return OK;
}

Status instance_sample(Instance *c, const double *x)
{
    Memory *m = c->memory;
    double *outputs = c->scratch + block.states.count, *margins = outputs + block.outputs.count;
    block.update(&m->clock, at(c, block.parameters), at(c, block.inputs), x, c->scratch, outputs,
                 margins);
    if (check_margins(c, block.running_requirement, block.running_requirements, margins) != OK)
        return ERROR;
    if (instance_check_finite(c, block.states.first, block.states.count + block.outputs.count,
                              c->scratch, " at this sample; check the inputs") != OK)
        return ERROR;
    memcpy(at(c, block.outputs), outputs, (size_t)block.outputs.count * sizeof(double));
    m->outputs_valid = ALL;
    return OK;
}

const double *instance_present_states(Instance *c)
{
    if (c->memory->state != INITIALIZATION)
        return at(c, block.states);
    block.initial(&c->memory->clock, at(c, block.parameters), at(c, block.inputs),
                  at(c, block.states), c->initial, 0, 0);
    return c->initial;
}

Status instance_update_outputs(Instance *c, Outputs wanted)
{
    Memory *m = c->memory;
    if (m->outputs_valid >= (int)wanted)
        return OK;
    const double *x = instance_present_states(c);
    if (block.period >= 0)
        return instance_sample(c, x);
    double *margins = c->scratch;
    Equations *equations = wanted == LINKED ? block.linked_outputs : block.outputs_;
    int count = wanted == LINKED ? block.linked : block.outputs.count;
    equations(&m->clock, at(c, block.parameters), at(c, block.inputs), x, at(c, block.outputs),
              margins, 0);
    if (check_margins(c, block.running_requirement, block.running_requirements, margins) != OK)
        return ERROR;
    if (instance_check_finite(c, block.outputs.first, count, at(c, block.outputs),
                              "; check states, inputs and parameters") != OK)
        return ERROR;
    m->outputs_valid = (int)wanted;
    return OK;
}

Status instance_update_rates(Instance *c)
{
    Memory *m = c->memory;
    double *rates = at(c, block.derivatives);
    if (m->rates_valid || block.derivatives.count == 0)
        return OK;
    block.rates(&m->clock, at(c, block.parameters), at(c, block.inputs), instance_present_states(c),
                rates, 0, 0);
    if (instance_check_finite(c, block.derivatives.first, block.derivatives.count, rates,
                              "; check states, inputs and parameters") != OK)
        return ERROR;
    m->rates_valid = 1;
    return OK;
}

void instance_changed(Instance *c)
{
    /* After initialisation, the outputs of a sampled block change only at a sample. A change of the
       inputs does not make the outputs invalid. */
    if (block.period < 0 || (c->memory->state & (INSTANTIATED | INITIALIZATION)))
        c->memory->outputs_valid = NONE;
    c->memory->rates_valid = 0;
}
