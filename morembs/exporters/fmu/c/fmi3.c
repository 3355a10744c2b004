/* The body by the Functional Mock-up Interface 3.0: model exchange and co-simulation. Value references count
   time, parameters, inputs, states, rates and outputs in this order. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "instance.h"

typedef void *fmi3Instance;
typedef uint32_t fmi3ValueReference;
typedef int fmi3Status;
typedef const char *fmi3String;
typedef const uint8_t *fmi3Binary;
enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal };
typedef void (*fmi3LogMessage)(void *environment, fmi3Status status, fmi3String category, fmi3String text);

static int failed(Instance *instance, const char *text)
{
    fmi3LogMessage log = instance->log;
    if (log)
        log(instance->environment, fmi3Error, "logStatusError", text);
    return fmi3Error;
}

#define DONE(c, done, text) return (done) ? fmi3OK : failed((Instance *)(c), text)

EXPORT const char *fmi3GetVersion(void) { return "3.0"; }

EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance c, bool on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

static Instance *instantiated(fmi3String name, fmi3String token, void *environment, fmi3LogMessage log)
{
    Instance *instance = make_instance(name, token);
    if (instance) {
        instance->environment = environment;
        instance->log = log;
    } else if (log) {
        log(environment, fmi3Error, "logStatusError", NO_INSTANCE);
    }
    return instance;
}

EXPORT fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                                 bool logging, void *environment, fmi3LogMessage log)
{
    (void)resources, (void)visible, (void)logging;
    return instantiated(name, token, environment, log);
}

EXPORT fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                                bool logging, bool events, bool early,
                                                const fmi3ValueReference intermediate[], size_t n, void *environment,
                                                fmi3LogMessage log, void (*update)(void))
{
    (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)intermediate, (void)n, (void)update;
    return instantiated(name, token, environment, log);
}

EXPORT fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                      bool visible, bool logging, void *environment,
                                                      fmi3LogMessage log, void (*update)(void), void (*lock)(void),
                                                      void (*unlock)(void))
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)update, (void)lock, (void)unlock;
    if (log)
        log(environment, fmi3Error, "logStatusError", NOT_OFFERED);
    return NULL;
}

EXPORT void fmi3FreeInstance(fmi3Instance c) { free_instance(c); }

EXPORT fmi3Status fmi3EnterInitializationMode(fmi3Instance c, bool has_tolerance, double tolerance, double start,
                                              bool has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    DONE(c, set_time(c, start), NOT_SET);
}

/* Changes of mode, which ask nothing of the body. */
#define MODE(name) \
    EXPORT fmi3Status fmi3##name(fmi3Instance c) { (void)c; return fmi3OK; }
MODE(ExitInitializationMode)
MODE(EnterEventMode)
MODE(EnterContinuousTimeMode)
MODE(EnterStepMode)
MODE(EnterConfigurationMode)
MODE(ExitConfigurationMode)
MODE(EvaluateDiscreteStates)
MODE(Terminate)

EXPORT fmi3Status fmi3Reset(fmi3Instance c) { start_instance(c); return fmi3OK; }

EXPORT fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, double value[], size_t m)
{
    DONE(c, n == m && get_values(c, vr, n, value), NO_VALUE);
}

EXPORT fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const double value[], size_t m)
{
    DONE(c, n == m && set_values(c, vr, n, value), NOT_SET);
}

#define OTHER_TYPE(name, type)                                                                                      \
    EXPORT fmi3Status fmi3Get##name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t m) \
    {                                                                                                               \
        (void)vr, (void)value;                                                                                      \
        DONE(c, n == 0 && m == 0, NO_VALUE);                                                                        \
    }                                                                                                               \
    EXPORT fmi3Status fmi3Set##name(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const type value[], size_t m) \
    {                                                                                                               \
        (void)vr, (void)value;                                                                                      \
        DONE(c, n == 0 && m == 0, NO_VALUE);                                                                        \
    }
OTHER_TYPE(Float32, float)
OTHER_TYPE(Int8, int8_t)
OTHER_TYPE(UInt8, uint8_t)
OTHER_TYPE(Int16, int16_t)
OTHER_TYPE(UInt16, uint16_t)
OTHER_TYPE(Int32, int32_t)
OTHER_TYPE(UInt32, uint32_t)
OTHER_TYPE(Int64, int64_t)
OTHER_TYPE(UInt64, uint64_t)
OTHER_TYPE(Boolean, bool)
OTHER_TYPE(String, fmi3String)

/* What a body without clocks, binaries, events and arrays does not have. */
#define NOT_HERE(name, ...) \
    EXPORT fmi3Status fmi3##name(fmi3Instance c, const void *of, size_t n, __VA_ARGS__)

NOT_HERE(GetBinary, size_t sizes[], fmi3Binary value[], size_t m)
{
    (void)of, (void)sizes, (void)value, (void)m;
    DONE(c, n == 0, NO_VALUE);
}
NOT_HERE(SetBinary, const size_t sizes[], const fmi3Binary value[], size_t m)
{
    (void)of, (void)sizes, (void)value, (void)m;
    DONE(c, n == 0, NO_VALUE);
}
#define NOT_HERE_1(name, type)         \
    NOT_HERE(name, type value[])       \
    {                                  \
        (void)of, (void)value;         \
        DONE(c, n == 0, NOT_OFFERED);  \
    }
#define NOT_HERE_2(name, first, second)       \
    NOT_HERE(name, first a[], second b[])     \
    {                                         \
        (void)of, (void)a, (void)b;           \
        DONE(c, n == 0, NOT_OFFERED);         \
    }
NOT_HERE_1(GetClock, bool)
NOT_HERE_1(SetClock, const bool)
NOT_HERE_2(GetIntervalDecimal, double, int)
NOT_HERE_1(GetShiftDecimal, double)
NOT_HERE_1(SetIntervalDecimal, const double)
NOT_HERE_1(SetShiftDecimal, const double)
NOT_HERE_2(GetShiftFraction, uint64_t, uint64_t)
NOT_HERE_2(SetIntervalFraction, const uint64_t, const uint64_t)
NOT_HERE_2(SetShiftFraction, const uint64_t, const uint64_t)
NOT_HERE(GetIntervalFraction, uint64_t counter[], uint64_t resolution[], int qualifier[])
{
    (void)of, (void)counter, (void)resolution, (void)qualifier;
    DONE(c, n == 0, NOT_OFFERED);
}
NOT_HERE(GetOutputDerivatives, const int32_t order[], double value[], size_t m)
{
    (void)of, (void)order, (void)value, (void)m;
    DONE(c, n == 0, NOT_OFFERED);
}
#define DERIVATIVE(name)                                                                         \
    NOT_HERE(name, const void *known, size_t k, const double seed[], size_t s, double value[], size_t m) \
    {                                                                                            \
        (void)of, (void)n, (void)known, (void)k, (void)seed, (void)s, (void)value, (void)m;      \
        DONE(c, 0, NOT_OFFERED);                                                                 \
    }
DERIVATIVE(GetDirectionalDerivative)
DERIVATIVE(GetAdjointDerivative)

EXPORT fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n)
{
    (void)vr, (void)n;
    DONE(c, 0, NOT_OFFERED);
}

EXPORT fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t of_dependent[],
                                              fmi3ValueReference independent[], size_t of_independent[], int kind[],
                                              size_t n)
{
    (void)vr, (void)of_dependent, (void)independent, (void)of_independent, (void)kind, (void)n;
    DONE(c, 0, NOT_OFFERED);
}

EXPORT fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, double time)
{
    (void)clock, (void)time;
    DONE(c, 0, NOT_OFFERED);
}

EXPORT fmi3Status fmi3GetFMUState(fmi3Instance c, void **state) { DONE(c, get_state(c, state), NO_MEMORY); }
EXPORT fmi3Status fmi3SetFMUState(fmi3Instance c, void *state) { DONE(c, set_state(c, state), NO_STATE); }
EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance c, void **state) { (void)c; free_state(state); return fmi3OK; }

EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = STATE_BYTES;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance c, void *state, uint8_t bytes[], size_t size)
{
    if (size >= STATE_BYTES)
        memcpy(bytes, state, STATE_BYTES);
    DONE(c, size >= STATE_BYTES, NO_MEMORY);
}

EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const uint8_t bytes[], size_t size, void **state)
{
    DONE(c, size == STATE_BYTES && restore_state(bytes, state), NO_MEMORY);
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, bool *again, bool *end, bool *nominals, bool *values,
                                           bool *has_next, double *next)
{
    (void)c, (void)next;
    *again = *end = *nominals = *values = *has_next = false;
    return fmi3OK;
}

/* Model exchange. */
EXPORT fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, bool kept, bool *event, bool *end)
{
    (void)c, (void)kept;
    *event = *end = false;
    return fmi3OK;
}

EXPORT fmi3Status fmi3SetTime(fmi3Instance c, double time) { DONE(c, set_time(c, time), NOT_SET); }

EXPORT fmi3Status fmi3SetContinuousStates(fmi3Instance c, const double x[], size_t n)
{
    DONE(c, set_all_states(c, x, n), NOT_SET);
}

EXPORT fmi3Status fmi3GetContinuousStates(fmi3Instance c, double x[], size_t n)
{
    DONE(c, get_all_states(c, x, n), NO_VALUE);
}

EXPORT fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, double rate[], size_t n)
{
    DONE(c, get_rates(c, rate, n), NO_VALUE);
}

EXPORT fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, double nominal[], size_t n)
{
    DONE(c, get_nominals(nominal, n), NO_VALUE);
}

EXPORT fmi3Status fmi3GetEventIndicators(fmi3Instance c, double indicator[], size_t n)
{
    (void)indicator;
    DONE(c, n == 0, NO_VALUE);
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { (void)c; *n = 0; return fmi3OK; }
EXPORT fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { (void)c; *n = STATES; return fmi3OK; }

/* Co-simulation. */
EXPORT fmi3Status fmi3DoStep(fmi3Instance c, double time, double h, bool kept, bool *event, bool *end, bool *early,
                             double *last)
{
    (void)kept;
    *event = *end = *early = false;
    int done = do_step(c, time, h);
    *last = ((Instance *)c)->time;
    DONE(c, done, NO_STEP);
}
