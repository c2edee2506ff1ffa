/* A multi-rate schedule of co-simulation slaves as plain data. Python fills the structures, and
   `core_run` executes them; cosim/freeflyer/master/native.py parses this header. The order of an
   instant is that of `Master.run` in cosim/freeflyer/master/master.py. C allocates no memory. */
#ifndef CORE_H
#define CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Functions of FMI 2.0 and FMI 3.0. A status above 1 (warning) is a failure. */
typedef int Set2(void *instance, const uint32_t *reference, size_t references, const double *value);
typedef int Get2(void *instance, const uint32_t *reference, size_t references, double *value);
typedef int Step2(void *instance, double time, double size, int no_state_set_before);
typedef int Set3(void *instance, const uint32_t *reference, size_t references, const double *value,
                 size_t values);
typedef int Get3(void *instance, const uint32_t *reference, size_t references, double *value,
                 size_t values);
typedef int Step3(void *instance, double time, double size, bool no_state_set_before, bool *event,
                  bool *terminate, bool *early, double *reached);

/* Operations of a slave, and of the master: LIMIT evaluates a limit that may be exceeded. */
typedef enum { SET, STEP, GET, LIMIT } Operation;

/* Callback for slaves that are not FMUs, and for limits. Returns 0, or another value to stop. */
typedef int Call(int index, Operation operation, double time, double size);

/* Values of one call: one value reference per value in FMI 2.0, per variable in FMI 3.0. */
typedef struct {
    size_t references, values;
} Batch;

typedef struct {
    int fmi; /* 2 or 3; 0: not an FMU, uses `call` */
    void *instance;
    Set2 *set2;
    Get2 *get2;
    Step2 *step2;
    Set3 *set3;
    Get3 *get3;
    Step3 *step3;
    Batch inputs, used, outputs; /* `used`: the leading outputs that connections and limits need */
    const uint32_t *input, *output;
    double *input_value, *output_value;
    size_t wires; /* number of connected inputs: *target[i] = *source[i] */
    double *const *target;
    const double *const *source;
    int64_t ratio, due; /* [ticks]: communication step, and instant of the next step */
    int64_t steps;
} Slave;

typedef struct {
    const double *value;
    size_t count;
    double bound;
    bool minimum, euclidean, maybe_exceeded;
} Limit;

typedef struct {
    Slave *slave;
    int slaves, first; /* the `first` slaves step one after the other, the others after them */
    Call *call;
    size_t delays; /* number of delayed outputs: *before[i] = *now[i] at the start of an instant */
    double *const *before;
    const double *const *now;
    Limit *limit;
    int limits;
    int64_t tick, ticks; /* length of a tick [ns], and their number in the run */
    int64_t record_ratio;
    size_t columns; /* of the record: row[i] = *recorded[i] */
    const double *const *recorded;
    double *row_time, *row;
    int64_t rows;
    volatile int64_t at; /* the next instant; any thread may read it */
    volatile int cancel; /* any thread may set it: the next instant is then the last */
    int index;           /* slave or limit that stopped the run */
    Operation operation;
    int status;
} Core;

typedef enum { PAUSED, DONE, FAILED, LIMIT_EXCEEDED } End;

/* FMI 3.0: the slave requested the end of the simulation. */
enum { TERMINATE_REQUESTED = -1 };

/* Run from instant `at` to the last instant before `until`, or to the end of the run. After FAILED
   and LIMIT_EXCEEDED, `index`, `operation` and `status` identify the cause. */
End core_run(Core *core, int64_t until);

#endif
