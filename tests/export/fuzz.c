/* Random legal and illegal FMI calls on one statically linked FMU, checked against a model of the
   standards' state machines.

   fuzz TOKEN SAMPLED FIRST COUNT: sequences of calls with the seeds FIRST, FIRST + 1, ... Every
   failure, including a sanitizer's finding, is printed with the seed and all calls of its sequence;
   `fuzz TOKEN SAMPLED SEED 1` reproduces it.
   Every call has these properties:
   - If the state does not permit the call: Error, and a message with the name of the call and the
     state, or with the unsupported feature.
   - If the state permits the call, the arguments are good and the instance has plausible values:
     OK.
   - If an argument is bad: Error or Discard, and a message with this status. If a value is invalid,
     the message names the variable.
   - If the result is not OK, or if the call only reads: the saved state and all readable values are
     unchanged.
   - After any result: no other instance has changed, and the saved state can be deserialized.
   - After any result: a good step from good inputs succeeds. */
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <sanitizer/common_interface_defs.h>
#include <sanitizer/lsan_interface.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

/* From the runtime: state names, the table of the block's variables, layout of a saved state. */
#include "instance.h"
#include "fuzz_model.h"

#include "fuzz_calls.h"

/* The call tables of the standards: 2.0.5, 3.2.3 and 4.2.4; 3.0.2, 2.3, 3.2 and 4.2. */

typedef struct {
    const char *name;
    int (*run)(Slot *);
    const char *cs, *me; /* states that permit the call, in co-simulation and model exchange */
    State next;          /* after OK; 0: unchanged, or set by the call */
} Call;

#define ROW(Function, ...) {#Function, run_##Function, __VA_ARGS__}
#define TYPE_ROWS(Type) ROW(fmi3Get##Type, "nsut", "nect", 0), ROW(fmi3Set##Type, "insu", "inec", 0)
static const Call table2[] = {
    {"fmi2SetDebugLogging", run_logging, "inst", "inect", 0},
    {"fmi2SetupExperiment", run_start, "i", "i", 0},
    {"fmi2EnterInitializationMode", run_initialize2, "i", "i", INITIALIZATION},
    {"fmi2ExitInitializationMode", run_initialized, "n", "n", STEP},
    ROW(fmi2Terminate, "s", "ec", TERMINATED),
    {"fmi2Reset", run_reset, "inst", "inect", 0},
    ROW(fmi2GetReal, "nst", "nect", 0),
    ROW(fmi2GetInteger, "nst", "nect", 0),
    ROW(fmi2GetBoolean, "nst", "nect", 0),
    ROW(fmi2GetString, "nst", "nect", 0),
    ROW(fmi2SetReal, "ins", "inec", 0),
    ROW(fmi2SetInteger, "ins", "ine", 0),
    ROW(fmi2SetBoolean, "ins", "ine", 0),
    ROW(fmi2SetString, "ins", "ine", 0),
    {"fmi2GetFMUstate", run_save, "inst", "inect", 0},
    {"fmi2SetFMUstate", run_restore, "inst", "inect", 0},
    {"fmi2FreeFMUstate", run_free_state, "inst", "inect", 0},
    {"fmi2SerializedFMUstateSize", run_size, "inst", "inect", 0},
    {"fmi2SerializeFMUstate", run_serialize, "inst", "inect", 0},
    {"fmi2DeSerializeFMUstate", run_deserialize, "inst", "inect", 0},
    ROW(fmi2GetDirectionalDerivative, "nst", "nect", 0),
    ROW(fmi2EnterEventMode, "", "ec", EVENT),
    ROW(fmi2NewDiscreteStates, "", "e", 0),
    ROW(fmi2EnterContinuousTimeMode, "", "e", CONTINUOUS),
    ROW(fmi2CompletedIntegratorStep, "", "c", 0),
    {"fmi2SetTime", run_time, "", "c", 0},
    ROW(fmi2SetContinuousStates, "", "c", 0),
    ROW(fmi2GetEventIndicators, "", "nect", 0),
    ROW(fmi2GetContinuousStates, "", "nect", 0),
    ROW(fmi2GetDerivatives, "", "nect", 0),
    ROW(fmi2GetNominalsOfContinuousStates, "", "inect", 0),
    ROW(fmi2SetRealInputDerivatives, "ins", "", 0),
    ROW(fmi2GetRealOutputDerivatives, "st", "", 0),
    {"fmi2DoStep", run_step, "s", "", 0},
    ROW(fmi2CancelStep, "", "", 0),
    ROW(fmi2GetStatus, "st", "", 0),
    ROW(fmi2GetRealStatus, "st", "", 0),
    ROW(fmi2GetIntegerStatus, "st", "", 0),
    ROW(fmi2GetBooleanStatus, "st", "", 0),
    ROW(fmi2GetStringStatus, "st", "", 0),
};
static const Call table3[] = {
    {"fmi3SetDebugLogging", run_logging, "inst", "inect", 0},
    {"fmi3EnterInitializationMode", run_start, "i", "i", INITIALIZATION},
    {"fmi3ExitInitializationMode", run_initialized, "n", "n", STEP},
    ROW(fmi3EnterEventMode, "", "c", EVENT),
    ROW(fmi3Terminate, "s", "ec", TERMINATED),
    {"fmi3Reset", run_reset, "inst", "inect", 0},
    ROW(fmi3GetFloat64, "insut", "inect", 0),
    ROW(fmi3GetInt64, "insut", "inect", 0),
    ROW(fmi3GetBoolean, "insut", "inect", 0),
    ROW(fmi3SetFloat64, "insu", "inec", 0),
    ROW(fmi3SetInt64, "insu", "inec", 0),
    ROW(fmi3SetBoolean, "insu", "inec", 0),
    TYPE_ROWS(Float32),
    TYPE_ROWS(Int8),
    TYPE_ROWS(UInt8),
    TYPE_ROWS(Int16),
    TYPE_ROWS(UInt16),
    TYPE_ROWS(Int32),
    TYPE_ROWS(UInt32),
    TYPE_ROWS(UInt64),
    TYPE_ROWS(String),
    TYPE_ROWS(Binary),
    ROW(fmi3GetClock, "", "e", 0),
    ROW(fmi3SetClock, "", "e", 0),
    ROW(fmi3GetIntervalDecimal, "n", "ne", 0),
    ROW(fmi3GetIntervalFraction, "n", "ne", 0),
    ROW(fmi3GetShiftDecimal, "n", "n", 0),
    ROW(fmi3GetShiftFraction, "n", "n", 0),
    ROW(fmi3SetIntervalDecimal, "n", "n", 0),
    ROW(fmi3SetIntervalFraction, "n", "n", 0),
    ROW(fmi3SetShiftDecimal, "n", "n", 0),
    ROW(fmi3SetShiftFraction, "n", "n", 0),
    {"fmi3GetFMUState", run_save, "inst", "inect", 0},
    {"fmi3SetFMUState", run_restore, "inst", "inect", 0},
    {"fmi3FreeFMUState", run_free_state, "inst", "inect", 0},
    {"fmi3SerializedFMUStateSize", run_size, "inst", "inect", 0},
    {"fmi3SerializeFMUState", run_serialize, "inst", "inect", 0},
    {"fmi3DeserializeFMUState", run_deserialize, "inst", "inect", 0},
    ROW(fmi3GetDirectionalDerivative, "nst", "nect", 0),
    ROW(fmi3GetAdjointDerivative, "nst", "nect", 0),
    ROW(fmi3EnterConfigurationMode, "", "", 0),
    ROW(fmi3ExitConfigurationMode, "", "", 0),
    ROW(fmi3EvaluateDiscreteStates, "", "", 0),
    ROW(fmi3UpdateDiscreteStates, "", "e", 0),
    ROW(fmi3EnterContinuousTimeMode, "", "e", CONTINUOUS),
    ROW(fmi3CompletedIntegratorStep, "", "c", 0),
    {"fmi3SetTime", run_time, "", "c", 0},
    ROW(fmi3SetContinuousStates, "", "c", 0),
    ROW(fmi3GetContinuousStateDerivatives, "", "nect", 0),
    ROW(fmi3GetEventIndicators, "", "nect", 0),
    ROW(fmi3GetContinuousStates, "", "nect", 0),
    ROW(fmi3GetNominalsOfContinuousStates, "", "nect", 0),
    ROW(fmi3GetNumberOfEventIndicators, "", "ie", 0),
    ROW(fmi3GetNumberOfContinuousStates, "", "ie", 0),
    ROW(fmi3EnterStepMode, "", "", 0),
    ROW(fmi3GetOutputDerivatives, "sut", "", 0),
    {"fmi3DoStep", run_step, "s", "", 0},
    ROW(fmi3ActivateModelPartition, "", "", 0),
    ROW(fmi3GetNumberOfVariableDependencies, "", "", 0),
    ROW(fmi3GetVariableDependencies, "", "", 0),
};

static int permitted(const Slot *s, const Call *call)
{
    int allowed = is_in(s->m.state, s->model_exchange ? call->me : call->cs);
    for (size_t i = 0; i < sizeof deviations / sizeof *deviations; i++) {
        const char *pattern = deviations[i].call;
        size_t n = strcspn(pattern, "*");
        int clock = !strcmp(pattern, "clock functions") &&
                    (strstr(call->name, "Clock") || strstr(call->name, "Interval") ||
                     strstr(call->name, "Shift"));
        if (!clock && strncmp(pattern, call->name, pattern[n] ? n : strlen(call->name) + 1))
            continue;
        int other = deviations[i].instead == ALLOWED ||
                    (deviations[i].instead == ALLOWED_IF_EMPTY && expected.empty);
        if (is_in(s->m.state, s->model_exchange ? deviations[i].me : deviations[i].cs) &&
            allowed != other && (other || deviations[i].instead == REJECTED)) {
            deviations[i].met++;
            return other;
        }
    }
    return allowed;
}

static void check_result(Slot *s, const Call *call, int status)
{
    const char *state = "";
    for (size_t i = 0; i < sizeof states / sizeof *states; i++)
        state = states[i].state == s->m.state ? states[i].name : state;
    LAW(status == 0 || status == 2 || status == 3, "status %d", status);
    LAW(status == 0 || s->mute || expected.given == SILENT ||
            (logged.count == 1 && logged.status == status),
        "%d messages, the last with status %d", logged.count, logged.status);
    int about_fmu = s->mute || strstr(logged.text, "this FMU has no ") ||
                    strstr(logged.text, "belongs to model exchange");
    if (!permitted(s, call)) {
        rejected++;
        LAW(status == 3, "%s in %s is not rejected", call->name, state);
        int about_variable = expected.given == BAD && strstr(call->name, "Set") &&
                             strstr(logged.text, expected.named);
        LAW(about_fmu || about_variable ||
                (strstr(logged.text, call->name) && strstr(logged.text, state)),
            "the message does not name %s and %s", call->name, state);
        return;
    }
    LAW(expected.given != GOOD || status == 0, "a valid call fails");
    LAW(expected.given != SILENT || status == 2, "an unexpected status");
    LAW((expected.given != BAD && expected.given != LACKED) || status != 0,
        "an invalid call succeeds");
    LAW(expected.given != LACKED || (status == 3 && about_fmu),
        "the message does not name the unsupported feature");
    LAW(expected.given != BAD || s->mute || strstr(logged.text, expected.named),
        "the message does not contain %s", expected.named);
    if (s->m.failed && status == 0 && !strstr(call->name, "Get") && !strstr(call->name, "Reset") &&
        !strstr(call->name, "State") && !strstr(call->name, "state"))
        deviates("no error state");
}

/* Makes one call on an instance and checks it against the properties above. */
static void perform(Slot *s, const Call *call)
{
    static unsigned char *after;
    static double seen[2][4096];
    const int inner = s->m.state == INTERMEDIATE, none = once_in(100),
              watched = !inner && !is_in(s->m.state, "i") && once_in(8);
    const Model m = s->m;
    calls++;
    note("%*s%td.%s%s(", inner ? 4 : 0, "", s - slots, none ? "null." : "", call->name);
    if (watched)
        read_all(s, seen[0]);
    /* States before the call. */
    for (int i = 0; i < slot_count && !inner; i++)
        snapshot(&slots[i], slots[i].bytes);
    memset(&expected, 0, sizeof expected);
    memset(&logged, 0, sizeof logged);
    expected.after = s->m;
    /* Make the call. In one of 100 cases, the instance is NULL. */
    void *c = s->c;
    s->c = none ? NULL : c;
    int status = call->run(s);
    s->c = c;
    note(") = %d  %s\n", status, logged.text);
    if (none)
        LAW(status == 3 && logged.count == 0, "a call without an instance");
    else
        check_result(s, call, status);
    if (status == 0) {
        s->m = expected.after;
        s->m.state = strstr(call->name, "ExitInit") && s->model_exchange ? EVENT
                     : call->next                                        ? call->next
                                                                         : s->m.state;
    }
    s->m.failed |= status == 3;
    /* Compare the states after the call. Only a successful call may change this instance. No call
       may change another instance. */
    after = realloc(after, memory_size);
    for (int i = 0; i < slot_count && !inner; i++) {
        snapshot(&slots[i], after);
        int may_change = &slots[i] == s && status == 0 && !strstr(call->name, "Get");
        void *again = NULL; /* the saved state must be deserializable */
        if (&slots[i] == s && !(s->m.wild & 2))
            LAW((s->version == 2
                     ? (int)fmi2DeSerializeFMUstate(s->c, (char *)after, memory_size, &again)
                     : (int)fmi3DeserializeFMUState(s->c, after, memory_size, &again)) == 0,
                "a saved state cannot be read back");
        free_state(&slots[i], &again);
        LAW(may_change || same(&slots[i], slots[i].bytes, after, &slots[i] == s && s->inner_sets),
            "instance %d has changed", i);
    }
    if (watched && (status != 0 || strstr(call->name, "Get")) && !s->inner_sets &&
        m.state == s->m.state) {
        read_all(s, seen[1]);
        LAW(!memcmp(seen[0], seen[1], (size_t)block.values * sizeof(double)),
            "what can be read has changed");
    }
    s->inner_sets = inner ? s->inner_sets : 0;
}

static const Call *named(const Slot *s, const char *name)
{
    const Call *table = s->version == 2 ? table2 : table3;
    while (strcmp(table->name + 4, name))
        table++;
    return table;
}

static void on_update(fmi3InstanceEnvironment e, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get,
                      fmi3Boolean finished, fmi3Boolean can_return, fmi3Boolean *early,
                      fmi3Float64 *early_time)
{
    Slot *s = e;
    LAW(set && get && finished && can_return == s->early, "the flags of an intermediate update");
    LAW(time > s->begin && time < s->end && time >= s->seen, "an intermediate update at %.17g",
        time);
    s->seen = time;
    s->m.state = INTERMEDIATE;
    note("\n    update at %.17g\n", time);
    for (unsigned n = below(4) ? 0 : 1 + below(2); n > 0; n--) {
        Expected outer_expected = expected;
        Logged outer_logged = logged;
        perform(s, below(3) ? &table3[below(sizeof table3 / sizeof *table3)]
                            : named(s, below(2) ? "GetFloat64" : "SetFloat64"));
        expected = outer_expected;
        logged = outer_logged;
    }
    s->m.state = STEP;
    if (below(6) == 0) {
        s->asked = 1;
        *early = true;
        *early_time = time + (s->end - time) * below(3) / 2;
    }
}

/* Sequences */

static void *instantiate(Slot *s, const char *name, const char *key)
{
    static fmi2CallbackFunctions callbacks = {on_log2, calloc, free, NULL, NULL};
    int logging = (int)below(2);
    callbacks.componentEnvironment = s;
    s->silent = !logging && !s->mute;
    if (name && !*name)
        deviates("blank name");
    note("%td = %s of FMI %d, %s, %s%s\n", s - slots,
         s->model_exchange ? "model exchange" : "co-simulation", s->version, s->mute ? "mute" : "",
         s->early ? "early return" : "", s->callback ? ", updates" : "");
    if (s->version == 2)
        return fmi2Instantiate(name, s->model_exchange ? fmi2ModelExchange : fmi2CoSimulation, key,
                               "", s->mute ? NULL : &callbacks, 0, logging);
    if (s->model_exchange)
        return fmi3InstantiateModelExchange(name, key, NULL, 0, logging, s,
                                            s->mute ? NULL : on_log3);
    return fmi3InstantiateCoSimulation(name, key, NULL, 0, logging, 0, s->early, some, below(3), s,
                                       s->mute ? NULL : on_log3, s->callback ? on_update : NULL);
}

static void begin(Slot *s, int version)
{
    *s = (Slot){.version = version,
                .model_exchange = !sampled && below(2),
                .mute = once_in(12),
                .early = (int)below(2),
                .callback = below(3) > 0,
                .before = s->before,
                .bytes = s->bytes};
    s->m.state = INSTANTIATED;
    if (once_in(8)) {
        int mute = s->mute, what = (int)below(3), kind = s->model_exchange;
        s->mute = 0;
        logged.count = 0;
        s->model_exchange |= what == 2 && sampled;
        if (what < 2 || sampled)
            LAW(!instantiate(s, what == 0 ? NULL : "x", what == 1 ? "wrong" : token) &&
                    logged.count == 1 && logged.status == 3,
                "a bad instance");
        s->mute = mute;
        s->model_exchange = kind;
    }
    s->c = instantiate(s, once_in(30) ? "" : "an instance", token);
    LAW(s->c, "no instance");
}

static void end(Slot *s)
{
    if (s->before)
        free_state(s, &s->before);
    note("free %td\n", s - slots);
    if (s->version == 2)
        fmi2FreeInstance(s->c);
    else
        fmi3FreeInstance(s->c);
}

/* The usual next call of a master. */
static const char *usual(const Slot *s)
{
    static const char *const event[] = {"EnterContinuousTimeMode", "EnterContinuousTimeMode",
                                        "SetContinuousStates"};
    static const char *const continuous[] = {"SetTime", "SetContinuousStates", "EnterEventMode"};
    switch (s->m.state) {
    case INSTANTIATED:
        return s->version == 2 && !s->m.set_up ? "SetupExperiment" : "EnterInitializationMode";
    case INITIALIZATION:
        return "ExitInitializationMode";
    case STEP:
        return "DoStep";
    case EVENT:
        return event[below(3)];
    case CONTINUOUS:
        return continuous[below(3)];
    default:
        return "Reset";
    }
}

/* With good inputs, a step or derivative succeeds, also after any rejected call. */
static void recover(Slot *s)
{
    if (s->m.wild || !is_in(s->m.state, "s"))
        return;
    note("good inputs, ");
    for (unsigned r = (unsigned)block.inputs.first; within(r, block.inputs); r++) {
        double good[1200];
        int n = s->version == 2 ? 1 : block.value[r].extent;
        for (int k = 0; k < n; k++)
            good[k] = block.start[r + (unsigned)k];
        LAW(n == 0 || (s->version == 2 ? (int)fmi2SetReal(s->c, &r, 1, good)
                                       : (int)fmi3SetFloat64(s->c, &r, 1, good, (size_t)n)) == 0,
            "#%u", r);
    }
    s->m.wild_inputs = 0;
    forced = 1;
    perform(s, named(s, "DoStep"));
    forced = 0;
}

static void sequence(void)
{
    int version = below(2) ? 2 : 3;
    traced = 0;
    trace[0] = '\0';
    chance = seed * 0x2545f4914f6cdd1dULL;
    rough = (int)below(2);
    slot_count = 1 + (int)below(3);
    for (int i = 0; i < slot_count; i++)
        begin(&slots[i], version);
    for (unsigned n = 20 + below(41); n > 0; n--) {
        Slot *s = &slots[below((unsigned)slot_count)];
        unsigned what = below(100);
        if (what < 35)
            perform(s, named(s, usual(s)));
        else if (what < 40)
            recover(s);
        else if (what < 42) {
            end(s);
            begin(s, version);
        } else if (what < 50)
            perform(s, named(s, version == 2 ? "SetReal" : "SetFloat64"));
        else if (what < 60) {
            static const char *const two[] = {"GetFMUstate", "SerializeFMUstate",
                                              "DeSerializeFMUstate", "SetFMUstate"};
            static const char *const three[] = {"GetFMUState", "SerializeFMUState",
                                                "DeserializeFMUState", "SetFMUState"};
            perform(s, named(s, version == 2 ? two[below(4)] : three[below(4)]));
        } else if (what < 62)
            perform(s, named(s, "Terminate"));
        else if (version == 2)
            perform(s, &table2[below(sizeof table2 / sizeof *table2)]);
        else
            perform(s, &table3[below(sizeof table3 / sizeof *table3)]);
    }
    for (int j = 0; j < 4; j++) {
        free_state(&slots[0], &stash[j].state);
        LAW(!stash[j].state, "the pointer to a freed state is not reset");
    }
    free(written.bytes);
    written.bytes = NULL;
    for (int i = 0; i < slot_count; i++)
        end(&slots[i]);
}

int main(int argc, char **argv)
{
    if (argc != 5)
        return 2;
    token = argv[1];
    sampled = argv[2][0] == '1';
    const unsigned long long first = strtoull(argv[3], NULL, 10),
                             count = strtoull(argv[4], NULL, 10);
    void *c = fmi2Instantiate("size", fmi2CoSimulation, token, "", NULL, 0, 0), *state = NULL;
    LAW(c && fmi2GetFMUstate(c, &state) == fmi2OK &&
            fmi2SerializedFMUstateSize(c, state, &memory_size) == fmi2OK,
        "no instance");
    fmi2FreeFMUstate(c, &state);
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
    fmi3FreeInstance(NULL);
    for (int i = 0; i < 3; i++)
        slots[i].bytes = malloc(memory_size);
    __sanitizer_set_death_callback(print_trace);
    signal(SIGABRT, aborted);
    for (seed = first; seed < first + count; seed++) {
        sequence();
        if (seed % 256 == 255 && __lsan_do_recoverable_leak_check())
            fail("a leak, within 256 sequences up to this one");
    }
    for (size_t i = 0; i < sizeof deviations / sizeof *deviations; i++)
        printf("deviation %ld: %s\n", deviations[i].met, deviations[i].call);
    printf("%llu sequences, %llu calls, %llu rejected by the state\n", count, calls, rejected);
    return 0;
}
