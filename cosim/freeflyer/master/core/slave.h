/* Functions that write inputs, make a step and read outputs of one slave. The result is 0, or the
   status of a failure. */
#ifndef SLAVE_H
#define SLAVE_H

#include "core.h"

void take_inputs(const Slave *slave);
int set_inputs(const Core *core, int index);
int make_step(const Core *core, int index, double time, double size);
int get_outputs(const Core *core, int index, bool all);

#endif
