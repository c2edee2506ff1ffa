#include "slave.h"

enum { WARNING = 1 };

static int failure(int status) { return status > WARNING ? status : 0; }

void take_inputs(const Slave *s)
{
    for (size_t i = 0; i < s->wires; i++) {
        *s->target[i] = *s->source[i];
    }
}

int set_inputs(const Core *core, int index)
{
    const Slave *s = &core->slave[index];
    if (s->inputs.values == 0) {
        return 0;
    }
    switch (s->fmi) {
    case 2:
        return failure(s->set2(s->instance, s->input, s->inputs.references, s->input_value));
    case 3:
        return failure(
            s->set3(s->instance, s->input, s->inputs.references, s->input_value, s->inputs.values));
    default:
        return core->call(index, SET, 0.0, 0.0);
    }
}

int make_step(const Core *core, int index, double time, double size)
{
    const Slave *s = &core->slave[index];
    bool event = false, terminate = false, early = false;
    double reached = 0.0;
    switch (s->fmi) {
    case 2:
        return failure(s->step2(s->instance, time, size, 1));
    case 3: {
        int status =
            failure(s->step3(s->instance, time, size, true, &event, &terminate, &early, &reached));
        return status == 0 && terminate ? TERMINATE_REQUESTED : status;
    }
    default:
        return core->call(index, STEP, time, size);
    }
}

int get_outputs(const Core *core, int index, bool all)
{
    const Slave *s = &core->slave[index];
    const Batch *batch = all ? &s->outputs : &s->used;
    if (batch->values == 0) {
        return 0;
    }
    switch (s->fmi) {
    case 2:
        return failure(s->get2(s->instance, s->output, batch->references, s->output_value));
    case 3:
        return failure(
            s->get3(s->instance, s->output, batch->references, s->output_value, batch->values));
    default:
        return core->call(index, GET, 0.0, 0.0);
    }
}
