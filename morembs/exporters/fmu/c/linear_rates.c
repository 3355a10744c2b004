/* Rates of all states. */

static int rates(Body *body, real *x_rate)
{
    for (int i = 0; i < MODES; i++)
        x_rate[i] = body->x[MODES + i];
    accelerations(body->p, body->u, body->x, x_rate + MODES);
    return 0;
}
