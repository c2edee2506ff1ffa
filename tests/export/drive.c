/* Loads an FMU's library at run time, steps the FMU through FMI 2.0, and prints values as bits.

   drive LIBRARY TOKEN < VECTOR. The vector has fields separated by white space: the numbers of
   steps, of inputs and of values to read; the step size; the value references of both; the inputs
   of every step. Doubles are 16 hexadecimal digits, because C libraries format numbers
   differently. */
#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

static void stop(const char *what)
{
    fprintf(stderr, "drive: %s\n", what);
    exit(1);
}

#ifdef _WIN32
static HMODULE library;
static void open_library(const char *path) { library = LoadLibraryA(path); }
#else
static void *library;
static void open_library(const char *path) { library = dlopen(path, RTLD_NOW); }
#endif

/* ISO C does not convert object pointers to function pointers. Therefore copy the bytes. */
static void find(const char *name, void *function, size_t size)
{
#ifdef _WIN32
    FARPROC found = GetProcAddress(library, name);
#else
    void *found = dlsym(library, name);
#endif
    if (!found || size != sizeof found)
        stop(name);
    memcpy(function, &found, size);
}

#define FIND(name)    \
    name##TYPE *name; \
    find(#name, &name, sizeof name)

static void on_log(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String category,
                   fmi2String format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fprintf(stderr, " (%s, %s, status %d)\n", name, category, (int)s);
    (void)e;
}

static void check(fmi2Status status, const char *call)
{
    if (status != fmi2OK)
        stop(call);
}

static uint64_t field(int base)
{
    char text[32];
    if (scanf("%31s", text) != 1)
        stop("the vector is too short");
    return strtoull(text, NULL, base);
}

static double real(void)
{
    uint64_t bits = field(16);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void *allocate(size_t count, size_t size)
{
    void *memory = calloc(count + 1, size);
    if (!memory)
        stop("out of memory");
    return memory;
}

int main(int argc, char **argv)
{
    if (argc != 3)
        stop("LIBRARY TOKEN are expected");
    open_library(argv[1]);
    if (!library)
        stop("the library cannot be loaded");
    FIND(fmi2Instantiate);
    FIND(fmi2SetupExperiment);
    FIND(fmi2EnterInitializationMode);
    FIND(fmi2ExitInitializationMode);
    FIND(fmi2SetReal);
    FIND(fmi2GetReal);
    FIND(fmi2DoStep);
    FIND(fmi2Terminate);
    FIND(fmi2FreeInstance);

    /* The head of the test vector. */
    size_t steps = field(10), inputs = field(10), outputs = field(10);
    double size = real();
    fmi2ValueReference *in = allocate(inputs, sizeof *in), *out = allocate(outputs, sizeof *out);
    fmi2Real *u = allocate(inputs, sizeof *u), *y = allocate(outputs, sizeof *y);
    for (size_t i = 0; i < inputs; i++)
        in[i] = (fmi2ValueReference)field(10);
    for (size_t i = 0; i < outputs; i++)
        out[i] = (fmi2ValueReference)field(10);

    /* Instantiate and initialise. */
    fmi2CallbackFunctions callbacks = {on_log, calloc, free, NULL, NULL};
    fmi2Component c =
        fmi2Instantiate("driven", fmi2CoSimulation, argv[2], "", &callbacks, fmi2False, fmi2False);
    if (!c)
        stop("fmi2Instantiate");
    check(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
    check(fmi2EnterInitializationMode(c), "fmi2EnterInitializationMode");
    check(fmi2ExitInitializationMode(c), "fmi2ExitInitializationMode");
    /* One line per value and step. */
    for (size_t k = 0; k < steps; k++) {
        for (size_t i = 0; i < inputs; i++)
            u[i] = real();
        check(fmi2SetReal(c, in, inputs, u), "fmi2SetReal");
        check(fmi2DoStep(c, (double)k * size, size, fmi2True), "fmi2DoStep");
        check(fmi2GetReal(c, out, outputs, y), "fmi2GetReal");
        for (size_t i = 0; i < outputs; i++) {
            uint64_t bits;
            memcpy(&bits, &y[i], sizeof bits);
            printf("%08lx%08lx\n", (unsigned long)(bits >> 32),
                   (unsigned long)(bits & 0xffffffffu));
        }
    }
    check(fmi2Terminate(c), "fmi2Terminate");
    fmi2FreeInstance(c);
    return 0;
}
