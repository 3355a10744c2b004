/* Rates of all states; 1 where the mass matrix has no inverse. */

static int rates(Body *body, real *x_rate)
{
    const real *x = body->x, *w = x + SPIN;
    real *force = body->residual, *M = body->matrix, R[9];
    for (int i = 0; i < SIZE; i++)
        body->stage[i] = 0;
    residual(body, x + QUATERNION, w, x + ELASTIC, x + RATE, body->stage, force);
    mass_matrix(body, M);
    body->h[0] = 0; /* the factor of steps is gone */
    if (factorise(M, SIZE, body->pivot))
        return 1;
    solve(M, SIZE, body->pivot, force);
    for (int i = 0; i < SIZE; i++)
        force[i] = -force[i];
    rotation(x + QUATERNION, R);
    turned(R, force, x_rate + VELOCITY);
    for (int i = 0; i < 3; i++) {
        x_rate[POSITION + i] = x[VELOCITY + i];
        x_rate[SPIN + i] = force[3 + i];
    }
    quaternion_rate(x + QUATERNION, w, x_rate + QUATERNION);
    for (int l = 0; l < MODES; l++) {
        x_rate[ELASTIC + l] = x[RATE + l];
        x_rate[RATE + l] = force[6 + l];
    }
    return 0;
}
