/* A multi-rate schedule as plain data. A slave is a component that the master steps.
   cosim/freeflyer/master/native.py parses this header and fills the structures. `core_run` executes
   the schedule. The operations at an instant have the same order as in `Master.run` in
   cosim/freeflyer/master/master.py. The C code allocates no memory. */
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

/* SET, STEP and GET are operations of a slave. LIMIT evaluates a limit that may be exceeded. */
typedef enum { SET, STEP, GET, LIMIT } Operation;

/* Callback for slaves that are not FMUs, and for limits. Any result except 0 stops the run. */
typedef int Call(int index, Operation operation, double time, double size);

/* Number of value references and number of values in one FMI call. FMI 2.0 has one value reference
   per value. FMI 3.0 has one value reference per variable. */
typedef struct {
    size_t references, values;
} Batch;

typedef struct {
    int fmi; /* FMI version 2 or 3; 0: the slave is not an FMU, and `call` is used */
    void *instance;
    Set2 *set2;
    Get2 *get2;
    Step2 *step2;
    Set3 *set3;
    Get3 *get3;
    Step3 *step3;
    /* `used` is the first part of `outputs`. Connections and limits need only this part. */
    Batch inputs, used, outputs;
    const uint32_t *input, *output;
    double *input_value, *output_value;
    size_t wires; /* number of connected input values; *target[i] = *source[i] */
    double *const *target;
    const double *const *source;
    int64_t ratio, due; /* [ticks]: communication step; instant of the next step */
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
    /* `slaves` is the number of slaves. The slaves 0 to `first` - 1 step one after the other. The
       remaining slaves step after these slaves. */
    int slaves, first;
    Call *call;
    size_t delays; /* number of delayed outputs; at the start of an instant: *before[i] = *now[i] */
    double *const *before;
    const double *const *now;
    Limit *limit;
    int limits;
    int64_t tick, ticks; /* length of a tick [ns]; number of ticks in the run */
    int64_t record_ratio;
    size_t columns; /* number of columns of the record; row[i] = *recorded[i] */
    const double *const *recorded;
    double *row_time, *row;
    int64_t rows;
    volatile int64_t at; /* the next instant [ticks]; any thread may read `at` */
    volatile int cancel; /* 1: the next instant is the last; any thread may write 1 */
    int index;           /* slave or limit that stopped the run */
    Operation operation;
    int status;
} Core;

typedef enum { PAUSED, DONE, FAILED, LIMIT_EXCEEDED } End;

/* Status of a step in which a slave of FMI 3.0 requested the end of the simulation. */
enum { TERMINATE_REQUESTED = -1 };

/* Run from instant `at` to the last instant before `until`, or to the end of the run. After FAILED
   and LIMIT_EXCEEDED, `index`, `operation` and `status` identify the cause. */
End core_run(Core *core, int64_t until);

#endif
