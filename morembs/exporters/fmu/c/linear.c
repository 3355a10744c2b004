/* A linear body in normal coordinates q with rates p; x = [q; p], and held inputs u.

   p' = -OMEGA^2 q - D p - 2 zeta OMEGA p + B u,   y = YX x + YU u, and where there are reactions + YA p'. */

static void observe(Body *body)
{
    real *y = body->y;
    for (int i = 0; i < LINEAR_OUTPUTS; i++)
        y[i] = 0;
    add_columns(LINEAR_OUTPUTS, STATES, YX, body->x, y);
    add_columns(LINEAR_OUTPUTS, INPUTS, YU, body->u, y);
#if REACTIONS
    accelerations(body->p, body->u, body->x, body->change);
    add_columns(LINEAR_OUTPUTS, MODES, YA, body->change, y);
#endif
    von_mises(y + LINEAR_OUTPUTS - 6 * STRESSES, y + LINEAR_OUTPUTS);
}

/* x += X x + U u: one step with held inputs. */
static void affine_step(Body *body, const real *X, const real *U)
{
    real *change = body->change;
    for (int i = 0; i < STATES; i++)
        change[i] = 0;
    add_columns(STATES, STATES, X, body->x, change);
    add_columns(STATES, INPUTS, U, body->u, change);
#if LINEAR_INPUTS
    add_columns(STATES, INPUTS, U + STATES * INPUTS, body->u_change, change);
#endif
    for (int i = 0; i < STATES; i++)
        body->x[i] += change[i];
}
