/* The body by the Functional Mock-up Interface 2.0: model exchange and co-simulation. Value references count
   time, parameters, inputs, states, rates and outputs in this order. */

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "instance.h"

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef int fmi2Status;
typedef int fmi2Boolean;
typedef const char *fmi2String;
enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending };

typedef struct {
    void (*logger)(void *environment, fmi2String instance, fmi2Status status, fmi2String category, fmi2String text, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *place);
    void (*stepFinished)(void *environment, fmi2Status status);
    void *environment;
} fmi2Callbacks;

#if LINEAR_INPUTS
#define NO_RATE "expected finite first derivatives of inputs"

#endif
typedef struct {
    fmi2Boolean newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
        valuesOfContinuousStatesChanged, nextEventTimeDefined;
    double nextEventTime;
} fmi2EventInfo;

static int failed(Instance *instance, const char *text)
{
    const fmi2Callbacks *callbacks = instance->callbacks;
    if (callbacks && callbacks->logger)
        callbacks->logger(callbacks->environment, instance->name, fmi2Error, "logStatusError", "%s", text);
    return fmi2Error;
}

#define DONE(c, done, text) return (done) ? fmi2OK : failed((Instance *)(c), text)

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String token, fmi2String resources,
                                     const fmi2Callbacks *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)type, (void)resources, (void)visible, (void)logging;
    Instance *instance = make_instance(name, token);
    if (instance)
        instance->callbacks = callbacks;
    else if (callbacks && callbacks->logger)
        callbacks->logger(callbacks->environment, name, fmi2Error, "logStatusError", "%s", NO_INSTANCE);
    return instance;
}

EXPORT void fmi2FreeInstance(fmi2Component c) { free_instance(c); }

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, double tolerance, double start,
                                      fmi2Boolean has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    DONE(c, set_time(c, start), NOT_SET);
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2Reset(fmi2Component c) { start_instance(c); return fmi2OK; }

EXPORT fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, double value[])
{
    DONE(c, get_values(c, vr, n, value), NO_VALUE);
}

EXPORT fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const double value[])
{
    DONE(c, set_values(c, vr, n, value), NOT_SET);
}

#define OTHER_TYPE(name, type)                                                                          \
    EXPORT fmi2Status fmi2Get##name(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) \
    {                                                                                                   \
        (void)vr, (void)value;                                                                          \
        DONE(c, n == 0, NO_VALUE);                                                                      \
    }                                                                                                   \
    EXPORT fmi2Status fmi2Set##name(fmi2Component c, const fmi2ValueReference vr[], size_t n, const type value[]) \
    {                                                                                                   \
        (void)vr, (void)value;                                                                          \
        DONE(c, n == 0, NO_VALUE);                                                                      \
    }
OTHER_TYPE(Integer, int)
OTHER_TYPE(Boolean, fmi2Boolean)
OTHER_TYPE(String, fmi2String)

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, void **state) { DONE(c, get_state(c, state), NO_MEMORY); }
EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, void *state) { DONE(c, set_state(c, state), NO_STATE); }
EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, void **state) { (void)c; free_state(state); return fmi2OK; }

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, void *state, size_t *size)
{
    (void)c, (void)state;
    *size = STATE_BYTES;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, void *state, char bytes[], size_t size)
{
    if (size >= STATE_BYTES)
        memcpy(bytes, state, STATE_BYTES);
    DONE(c, size >= STATE_BYTES, NO_MEMORY);
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const char bytes[], size_t size, void **state)
{
    DONE(c, size == STATE_BYTES && restore_state(bytes, state), NO_MEMORY);
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                               const fmi2ValueReference known[], size_t knowns, const double seed[],
                                               double sensitivity[])
{
    (void)unknown, (void)unknowns, (void)known, (void)knowns, (void)seed, (void)sensitivity;
    DONE(c, 0, NOT_OFFERED);
}

/* Model exchange. */
EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) { (void)c; return fmi2OK; }
EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { (void)c; return fmi2OK; }

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)c;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean kept, fmi2Boolean *event, fmi2Boolean *end)
{
    (void)c, (void)kept;
    *event = *end = 0;
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetTime(fmi2Component c, double time) { DONE(c, set_time(c, time), NOT_SET); }

EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const double x[], size_t n)
{
    DONE(c, set_all_states(c, x, n), NOT_SET);
}

EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, double x[], size_t n)
{
    DONE(c, get_all_states(c, x, n), NO_VALUE);
}

EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, double rate[], size_t n)
{
    DONE(c, get_rates(c, rate, n), NO_VALUE);
}

EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, double nominal[], size_t n)
{
    DONE(c, get_nominals(nominal, n), NO_VALUE);
}

EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, double indicator[], size_t n)
{
    (void)indicator;
    DONE(c, n == 0, NO_VALUE);
}

/* Co-simulation. */
EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                              const int order[], const double value[])
{
#if LINEAR_INPUTS
    int known = finite_numbers(value, n);
    for (size_t i = 0; i < n; i++)
        known = known && order[i] == 1 && vr[i] >= FIRST_INPUT && vr[i] < FIRST_STATE;
    for (size_t i = 0; i < n && known; i++)
        ((Instance *)c)->u_rate[vr[i] - FIRST_INPUT] = value[i];
    DONE(c, known, NO_RATE);
#else
    (void)vr, (void)order, (void)value;
    DONE(c, n == 0, NOT_OFFERED);
#endif
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                               const int order[], double value[])
{
    (void)vr, (void)order, (void)value;
    DONE(c, n == 0, NOT_OFFERED);
}

EXPORT fmi2Status fmi2DoStep(fmi2Component c, double time, double h, fmi2Boolean kept)
{
    (void)kept;
    DONE(c, do_step(c, time, h), NO_STEP);
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { DONE(c, 0, NOT_OFFERED); }

#define STATUS(name, type)                                                     \
    EXPORT fmi2Status fmi2Get##name(fmi2Component c, int kind, type *value)    \
    {                                                                          \
        (void)c, (void)kind, (void)value;                                      \
        return fmi2Discard;                                                    \
    }
STATUS(Status, fmi2Status)
STATUS(IntegerStatus, int)
STATUS(BooleanStatus, fmi2Boolean)
STATUS(StringStatus, fmi2String)

EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, int kind, double *value)
{
    *value = ((Instance *)c)->time;
    return kind == 2 ? fmi2OK : fmi2Discard; /* the last successful time */
}
