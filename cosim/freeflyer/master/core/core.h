/* A multi-rate schedule over co-simulation slaves, as plain data: Python fills it in (cosim/freeflyer/master/native.py reads this very file), and
   `core_run` executes it. The order of an instant is that of cosim/freeflyer/master/master.py, the core's twin. Nothing here is allocated or freed by C. */
#ifndef CORE_H
#define CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Functions of FMI 2.0 and FMI 3.0; a status above 1 (warning) is a failure. */
typedef int Set2(void *instance, const uint32_t *reference, size_t references, const double *value);
typedef int Get2(void *instance, const uint32_t *reference, size_t references, double *value);
typedef int Step2(void *instance, double time, double size, int no_state_set_before);
typedef int Set3(void *instance, const uint32_t *reference, size_t references, const double *value,
                 size_t values);
typedef int Get3(void *instance, const uint32_t *reference, size_t references, double *value,
                 size_t values);
typedef int Step3(void *instance, double time, double size, bool no_state_set_before, bool *event,
                  bool *terminate, bool *early, double *reached);

/* Of a slave, and of the master: a limit that looks passed is judged by its owner. */
typedef enum { SET, STEP, GET, LIMIT } Operation;

/* What is not an FMU, by its owner: 0, or anything else to stop. */
typedef int Call(int index, Operation operation, double time, double size);

/* Values that one call hands over: one reference a value in FMI 2.0, one a variable in FMI 3.0. */
typedef struct {
    size_t references, values;
} Batch;

typedef struct {
    int fmi; /* 2 or 3; 0: not an FMU, called through `call` */
    void *instance;
    Set2 *set2;
    Get2 *get2;
    Step2 *step2;
    Set3 *set3;
    Get3 *get3;
    Step3 *step3;
    Batch inputs, used,
        outputs; /* `used`: the first of the outputs, which connections and limits need at every step */
    const uint32_t *input, *output;
    double *input_value, *output_value;
    size_t wires; /* the connected inputs: *target[i] = *source[i] */
    double *const *target;
    const double *const *source;
    int64_t ratio, due; /* ticks: of a step, and the next one */
    int64_t steps;
} Slave;

typedef struct {
    const double *value;
    size_t count;
    double bound;
    bool minimum, euclidean, looks_passed;
} Limit;

typedef struct {
    Slave *
        slave; /* `first` of them are stepped one after the other at an instant, the others together after them */
    int slaves, first;
    Call *call;
    size_t
        delays; /* outputs that delayed connections carry: *before[i] = *now[i] at the begin of an instant */
    double *const *before;
    const double *const *now;
    Limit *limit;
    int limits;
    int64_t tick, ticks; /* ns, and their number in the run */
    int64_t record_ratio;
    size_t columns; /* of the record: row[i] = *recorded[i] */
    const double *const *recorded;
    double *row_time, *row;
    int64_t rows;
    volatile int64_t at; /* the next instant; may be read from any thread */
    volatile int cancel; /* may be set from any thread: the next instant is the last */
    int index;           /* of the slave or limit that stopped the run */
    Operation operation;
    int status;
} Core;

typedef enum { PAUSED, DONE, FAILED, PASSED } End;

/* FMI 3.0: the slave asked for the end of the simulation. */
enum { ASKED_TO_END = -1 };

/* From instant `at` up to, but without, instant `until`, or to the end of the run. After FAILED and PASSED, `index`,
   `operation` and `status` say what it was. */
End core_run(Core *core, int64_t until);

#endif
