/* Accelerations of the normal coordinates. */

static void accelerations(const real *parameter, const real *u, const real *x, real *p_rate)
{
    const real *q = x, *p = x + MODES;
    for (int i = 0; i < MODES; i++)
        p_rate[i] = -OMEGA[i] * (OMEGA[i] * q[i] + 2 * parameter[DAMPING_RATIO] * p[i]);
    add_columns(MODES, MODES, MINUS_D, p, p_rate);
    add_columns(MODES, INPUTS, B, u, p_rate);
}
