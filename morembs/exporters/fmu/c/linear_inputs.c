/* Inputs that go in a line over a step, from u_start by u_change. */

static void set_inputs(Body *body, real share)
{
    for (int i = 0; i < INPUTS; i++)
        body->u[i] = body->u_start[i] + share * body->u_change[i];
}

/* part: where a part of the step begins, and how long it is, over the whole. */
static void begin_inputs(Body *body)
{
    for (int i = 0; i < INPUTS; i++)
        body->u_start[i] = body->u[i];
    body->part[0] = 0;
    body->part[1] = 1;
}

/* Where the step did not succeed, inputs are those of its start. */
static void end_inputs(Body *body, int failed) { set_inputs(body, failed ? 0 : 1); }
