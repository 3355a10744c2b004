/* What both versions of the interface share: an instance of the body with its time, and values by reference. */

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

#include "model.h"

/* References of the first of each kind. */
#define FIRST_INPUT (1 + PARAMETERS)
#if LINEAR_INPUTS
#define FIRST_STATE (FIRST_INPUT + INPUTS + INPUT_RATES)
#else
#define FIRST_STATE (FIRST_INPUT + INPUTS)
#endif
#define FIRST_RATE (FIRST_STATE + STATES)
#define FIRST_OUTPUT (FIRST_RATE + STATES)
#define REFERENCES (FIRST_OUTPUT + OUTPUTS)
#if LINEAR_INPUTS
#define STATE_BYTES ((1 + PARAMETERS + 2 * INPUTS + STATES) * sizeof(double))
#else
#define STATE_BYTES ((1 + PARAMETERS + INPUTS + STATES) * sizeof(double))
#endif

#define NO_INSTANCE "no instance: the token of the description is not that of this library, or memory is short"
#define NO_VALUE "no such value, or none that is finite at these inputs and states"
#define NOT_SET "a value that cannot be set: a parameter is zero or more, and every value a finite number"
#define NO_MEMORY "memory is short, or these bytes are no state of this body"
#define NO_STATE "no state of this body: a parameter is zero or more, and every value a finite number"
#define NOT_OFFERED "this body does not offer that; its description says so"
#define NO_STEP "the step did not succeed: expected a step above zero, and inputs for which the deflection stays small"

typedef struct {
    Body body;
    double time;
    double x_rate[STATES];
    double before[STATES]; /* states before a step */
#if LINEAR_INPUTS
    double u_rate[INPUTS]; /* of inputs over the next steps of co-simulation */
#endif
    int rates_known, outputs_known;
    const void *callbacks; /* of version 2 */
    void (*log)(void *environment, int status, const char *category, const char *text); /* of version 3 */
    void *environment;
    char name[64];
} Instance;

static void changed(Instance *instance) { instance->rates_known = instance->outputs_known = 0; }

static void start_instance(Instance *instance)
{
    body_start(&instance->body);
#if LINEAR_INPUTS
    memset(instance->u_rate, 0, sizeof instance->u_rate);
#endif
    instance->time = 0;
    changed(instance);
}

static Instance *make_instance(const char *name, const char *token)
{
    Instance *instance = token && strcmp(token, TOKEN) == 0 ? calloc(1, sizeof *instance) : NULL;
    if (instance) {
        strncpy(instance->name, name ? name : "", sizeof instance->name - 1);
        start_instance(instance);
    }
    return instance;
}

static void free_instance(void *instance) { free(instance); }

static int finite_numbers(const double *value, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!isfinite(value[i]))
            return 0;
    return 1;
}

static int set_time(Instance *instance, double time)
{
    if (isfinite(time))
        instance->time = time;
    return isfinite(time);
}

static int know_rates(Instance *instance)
{
    if (!instance->rates_known)
        instance->rates_known = body_rates(&instance->body, instance->x_rate) == 0
                                && finite_numbers(instance->x_rate, STATES);
    return instance->rates_known;
}

static int know_outputs(Instance *instance)
{
    if (!instance->outputs_known) {
        body_observe(&instance->body);
        instance->outputs_known = finite_numbers(instance->body.y, OUTPUTS);
    }
    return instance->outputs_known;
}

/* Parameters, inputs and states, which may be set; NULL for all else. */
static double *settable(Instance *instance, unsigned reference)
{
    if (reference < 1 || reference >= FIRST_RATE)
        return NULL;
    if (reference < FIRST_INPUT)
        return instance->body.p + reference - 1;
#if LINEAR_INPUTS
    if (reference >= FIRST_INPUT + INPUTS && reference < FIRST_STATE)
        return instance->u_rate + reference - FIRST_INPUT - INPUTS;
#endif
    if (reference < FIRST_STATE)
        return instance->body.u + reference - FIRST_INPUT;
    return instance->body.x + reference - FIRST_STATE;
}

static int get_values(Instance *instance, const unsigned *reference, size_t n, double *value)
{
    for (size_t i = 0; i < n; i++) {
        unsigned r = reference[i];
        if (r >= REFERENCES || (r >= FIRST_OUTPUT && !know_outputs(instance))
            || (r >= FIRST_RATE && r < FIRST_OUTPUT && !know_rates(instance)))
            return 0;
        if (r >= FIRST_OUTPUT) {
            value[i] = instance->body.y[r - FIRST_OUTPUT];
        } else if (r >= FIRST_RATE) {
            value[i] = instance->x_rate[r - FIRST_RATE];
        } else {
            value[i] = r ? *settable(instance, r) : instance->time;
        }
    }
    return 1;
}

static int set_values(Instance *instance, const unsigned *reference, size_t n, const double *value)
{
    for (size_t i = 0; i < n; i++)
        if (!settable(instance, reference[i]) || !isfinite(value[i]) || (reference[i] < FIRST_INPUT && value[i] < 0))
            return 0;
    for (size_t i = 0; i < n; i++)
        *settable(instance, reference[i]) = value[i];
    changed(instance);
    return 1;
}

static int get_all_states(Instance *instance, double *x, size_t n)
{
    if (n == STATES)
        memcpy(x, instance->body.x, STATES * sizeof(double));
    return n == STATES;
}

static int set_all_states(Instance *instance, const double *x, size_t n)
{
    if (n != STATES || !finite_numbers(x, n))
        return 0;
    memcpy(instance->body.x, x, STATES * sizeof(double));
    changed(instance);
    return 1;
}

static int get_rates(Instance *instance, double *rate, size_t n)
{
    if (n != STATES || !know_rates(instance))
        return 0;
    memcpy(rate, instance->x_rate, STATES * sizeof(double));
    return 1;
}

static int get_nominals(double *nominal, size_t n)
{
    for (size_t i = 0; i < n; i++)
        nominal[i] = n == STATES ? NOMINAL[i] : 1;
    return n == STATES;
}

/* Where the step does not succeed, the states stay. */
static int do_step(Instance *instance, double time, double h)
{
    Body *body = &instance->body;
    if (!(h > 0) || !isfinite(h) || !isfinite(time))
        return 0;
    memcpy(instance->before, body->x, STATES * sizeof(double));
#if LINEAR_INPUTS
    for (int i = 0; i < INPUTS; i++)
        body->u_change[i] = h * instance->u_rate[i];
#endif
    if (body_advance(body, time, h)) {
        memcpy(body->x, instance->before, STATES * sizeof(double));
        changed(instance);
        return 0;
    }
    instance->time = time + h;
    changed(instance);
    return 1;
}

#if LINEAR_INPUTS
/* A state is [time; parameters; inputs; rates of inputs; states]. */
#else
/* A state is [time; parameters; inputs; states]. */
#endif
static int is_state(const double *value)
{
    for (int i = 0; i < PARAMETERS; i++)
        if (!(value[1 + i] >= 0))
            return 0;
    return finite_numbers(value, STATE_BYTES / sizeof(double));
}

static int set_state(Instance *instance, const void *state)
{
    const double *value = state;
    Body *body = &instance->body;
    if (!value || !is_state(value))
        return 0;
    instance->time = value[0];
    memcpy(body->p, value + 1, PARAMETERS * sizeof(double));
    memcpy(body->u, value + FIRST_INPUT, INPUTS * sizeof(double));
#if LINEAR_INPUTS
    memcpy(instance->u_rate, value + FIRST_INPUT + INPUTS, INPUTS * sizeof(double));
    memcpy(body->x, value + FIRST_INPUT + 2 * INPUTS, STATES * sizeof(double));
#else
    memcpy(body->x, value + FIRST_STATE, STATES * sizeof(double));
#endif
    changed(instance);
    return 1;
}

static int get_state(const Instance *instance, void **state)
{
    const Body *body = &instance->body;
    double *value = *state ? *state : malloc(STATE_BYTES);
    if (!value)
        return 0;
    value[0] = instance->time;
    memcpy(value + 1, body->p, PARAMETERS * sizeof(double));
    memcpy(value + FIRST_INPUT, body->u, INPUTS * sizeof(double));
#if LINEAR_INPUTS
    memcpy(value + FIRST_INPUT + INPUTS, instance->u_rate, INPUTS * sizeof(double));
    memcpy(value + FIRST_INPUT + 2 * INPUTS, body->x, STATES * sizeof(double));
#else
    memcpy(value + FIRST_STATE, body->x, STATES * sizeof(double));
#endif
    *state = value;
    return 1;
}

static int restore_state(const void *bytes, void **state)
{
    double value[STATE_BYTES / sizeof(double)];
    memcpy(value, bytes, STATE_BYTES);
    if (!is_state(value))
        return 0;
    if (!*state)
        *state = malloc(STATE_BYTES);
    if (*state)
        memcpy(*state, value, STATE_BYTES);
    return *state != NULL;
}

static void free_state(void **state)
{
    free(*state);
    *state = NULL;
}
