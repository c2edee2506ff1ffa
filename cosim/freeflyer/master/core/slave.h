/* Operations of one slave. `take_inputs` copies the values of the sources to the input buffer, and
   `set_inputs` writes the buffer to the inputs of the component. `get_outputs` reads all outputs if
   `all` is true, otherwise only the outputs that connections and limits need. The result is 0, or
   the status of a failure. */
#ifndef SLAVE_H
#define SLAVE_H

#include "core.h"

void take_inputs(const Slave *slave);
int set_inputs(const Core *core, int index);
int make_step(const Core *core, int index, double time, double size);
int get_outputs(const Core *core, int index, bool all);

#endif
