/* Steps of any size: the matrix exponential of the held inputs is made when the size changes.

   With A the matrix of the states and Z = A h / 2^k, a Taylor series gives F = exp(Z) - 1, and 2 F + F F squares k
   times; without the unit matrix slow states keep their digits beside fast ones (Higham 2008, ch. 10). Columns of
   inputs follow in the same way. States are scaled so that both halves have one unit. */

#if LINEAR_INPUTS
#define WIDTH (STATES + 2 * INPUTS)
#else
#define WIDTH (STATES + INPUTS)
#endif
#define TERMS 18

static real state_scale(int i)
{
    return i < MODES && OMEGA[i] > 0 ? OMEGA[i] : 1;
}

/* Columns of the states and the inputs, times h. */
static void scaled_columns(Body *body, real h)
{
    real *p_rate = body->change, *A = body->A;
#if LINEAR_INPUTS
    real keep[WIDTH + 1];
#else
    real keep[STATES + INPUTS + 1];
#endif
    for (int j = 0; j < WIDTH; j++) {
        for (int i = 0; i < WIDTH; i++)
            keep[i] = i == j ? 1 : 0;
        accelerations(body->p, keep + STATES, keep, p_rate);
        real of_column = j < STATES ? state_scale(j) : 1;
        for (int i = 0; i < MODES; i++) {
            A[j * STATES + i] = h * keep[MODES + i] * state_scale(i) / of_column;
            A[j * STATES + MODES + i] = h * p_rate[i] / of_column;
        }
    }
}

/* to += factor times the square part of left times right (STATES, columns). */
static void add_product(real factor, const real *left, const real *right, int columns, real *to)
{
    for (int j = 0; j < columns; j++)
        for (int k = 0; k < STATES; k++) {
            real value = factor * right[j * STATES + k];
            if (value != 0)
                for (int i = 0; i < STATES; i++)
                    to[j * STATES + i] += left[k * STATES + i] * value;
        }
}

static void discretise(Body *body, real h)
{
    real *A = body->A, *F = body->F, *work = body->work, size = 0;
    int halvings = 0;
    scaled_columns(body, h);
    for (int j = 0; j < STATES; j++) {
        real sum = 0;
        for (int i = 0; i < STATES; i++)
            sum += fabs(A[j * STATES + i]);
        size = sum > size ? sum : size;
    }
    for (; size > 1 && halvings < 1000; size /= 2)
        halvings++;
    for (int i = 0; i < STATES * WIDTH; i++)
        F[i] = A[i] = ldexp(A[i], -halvings);
#if LINEAR_INPUTS
    /* Inputs grow by their change over the step: by this share of it in 1 / 2^halvings of the step. */
    real share = ldexp((real)1, -halvings), *change = work + STATES * (STATES + INPUTS);
#endif
    for (int term = TERMS; term > 1; term--) {
        for (int i = 0; i < STATES * WIDTH; i++)
            work[i] = A[i];
        add_product((real)1 / term, A, F, WIDTH, work);
#if LINEAR_INPUTS
        for (int i = 0; i < STATES * INPUTS; i++)
            change[i] += share / term * A[STATES * STATES + i];
#endif
        for (int i = 0; i < STATES * WIDTH; i++)
            F[i] = work[i];
    }
    for (; halvings > 0; halvings--) {
        for (int i = 0; i < STATES * WIDTH; i++)
            work[i] = 2 * F[i];
        add_product(1, F, F, WIDTH, work);
#if LINEAR_INPUTS
        for (int i = 0; i < STATES * INPUTS; i++)
            change[i] += share * F[STATES * STATES + i];
        share *= 2;
#endif
        for (int i = 0; i < STATES * WIDTH; i++)
            F[i] = work[i];
    }
    for (int j = 0; j < WIDTH; j++)
        for (int i = 0; i < STATES; i++)
            F[j * STATES + i] *= (j < STATES ? state_scale(j) : 1) / state_scale(i);
    body->h[0] = h;
    body->h_damping[0] = body->p[DAMPING_RATIO];
}

/* Sizes that differ by the round-off of the time are one size. */
static int advance(Body *body, real time, real h)
{
    if (body->h[0] <= 0 || fabs(h - body->h[0]) > 1e-15 * (4 * fabs(time) + 10 * h)
        || body->h_damping[0] != body->p[DAMPING_RATIO])
        discretise(body, h);
    affine_step(body, body->F, body->F + STATES * STATES);
    return 0;
}
