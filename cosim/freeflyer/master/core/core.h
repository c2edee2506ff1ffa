/* The structures and the main function of the C core, which executes a run.

   A slave is a component that the master steps. The tick is the smallest step. Each step is a
   multiple of the tick. Instant k is the time k * tick, and steps start only at instants. The
   operations at an instant have the order of `Master.run` in cosim/freeflyer/master/master.py.

   cosim/freeflyer/master/native.py parses this header and fills the structures. The C code
   allocates no memory. */
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

/* Operations for which C calls Python. SET writes the inputs of a slave, STEP makes a step, and GET
   reads the outputs. LIMIT checks whether a limit is exceeded. */
typedef enum { SET, STEP, GET, LIMIT } Operation;

/* Callback to Python, for slaves that are not co-simulation FMUs, and for limits. `index` is the
   index of the slave or of the limit. `time` and `size` [s] are the start and the length of a step;
   for other operations they are 0. Any result except 0 stops the run. */
typedef int Call(int index, Operation operation, double time, double size);

/* Number of value references and number of values in one FMI call. FMI 2.0 needs one value
   reference for each value. FMI 3.0 needs one value reference for each variable, and an array is
   one variable. */
typedef struct {
    size_t references, values;
} Batch;

typedef struct {
    int fmi; /* 2 or 3: FMI version; 0: the core calls Python (`call`) for this slave */
    void *instance;
    Set2 *set2;
    Get2 *get2;
    Step2 *step2;
    Set3 *set3;
    Get3 *get3;
    Step3 *step3;
    /* `outputs` describes a call that reads all outputs. `used` describes a call that reads only
       the first outputs: those that connections and limits need. */
    Batch inputs, used, outputs;
    const uint32_t *input, *output;
    double *input_value, *output_value;
    size_t wires; /* number of connected input values; the core copies *target[i] = *source[i] */
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
    /* `slaves` is the number of slaves. The slaves 0 to `first` - 1 are the controllers. At an
       instant they step one after the other. The remaining slaves step after the controllers. */
    int slaves, first;
    Call *call;
    /* `delays` is the number of output values that delayed connections transfer. At the start of an
       instant, the core copies *before[i] = *now[i]. */
    size_t delays;
    double *const *before;
    const double *const *now;
    Limit *limit;
    int limits;
    int64_t tick, ticks; /* length of a tick [ns]; number of ticks in the run */
    int64_t record_ratio;
    size_t columns; /* columns of the record without the time; column i contains *recorded[i] */
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

/* Value of `Core.status` if an FMI 3.0 FMU requested the end of the simulation in a step. */
enum { TERMINATE_REQUESTED = -1 };

/* Execute the instants from `core->at` to `until` - 1, or to the end of the run. The result is
   PAUSED if the run has not ended. After FAILED and LIMIT_EXCEEDED, the fields `index`, `operation`
   and `status` of the core identify the cause. */
End core_run(Core *core, int64_t until);

#endif
