/* Rates of all states; 1 beyond the tables. */

static int rates(Body *body, real *x_rate)
{
    for (int i = 0; i < MODES; i++)
        x_rate[i] = body->x[RATE + i];
    return accelerate(body, x_rate + RATE);
}
