/* One step by the method of Gauss with STAGES stages: of order 2 STAGES, stable for all elastic frequencies; with one
   stage the implicit midpoint rule (Hairer and Wanner 1996, ch. IV). Simplified Newton with the mass matrix of the
   start; quaternions follow by fixed point. Inputs are held. */

#if STAGES == 1
static const real GAUSS[1] = {(real)0.5};
#else
static const real GAUSS[4] = {(real)0.25, (real)-0.038675134594812866, (real)0.53867513459481288, (real)0.25};
#endif
#define LARGE (STAGES * SIZE)
#define ROUND_OFF (sizeof(real) == 4 ? (real)1.2e-7 : (real)2.2e-16)
#define MOST_ITERATIONS 30
/* What the last correction may be where a tolerance stands for more. */
#ifdef TOLERANCE
#define NEWTON(body) ((real)1e-4 * body->p[TOLERANCE] + 10 * ROUND_OFF)
#else
#define NEWTON(body) (10 * ROUND_OFF)
#endif

/* Size of a change of place and turn of the frame, if any, and of q, by its mass without coupling, per length of the
   body. */
static real relative_size(const real *change)
{
    const real *q = change + RIGID;
    real square = 0;
    for (int l = 0; l < MODES; l++)
        square += ME[l * MODES + l] * q[l] * q[l];
    square /= MASS * LENGTH * LENGTH;
#if RIGID
    square += dot(change, change, 3) / (LENGTH * LENGTH) + dot(change + 3, change + 3, 3);
#endif
    return sqrt(square);
}

/* The matrix of Newton's method for steps of size h, factorised in the place of that number. */
static int prepare(Body *body, const real *x, real h, int place)
{
    real *M = body->stage, *A = body->matrix + place * LARGE * LARGE;
    linearise(body, x);
    for (int s = 0; s < STAGES; s++)
        for (int t = 0; t < STAGES; t++) {
            real once = h * GAUSS[s * STAGES + t], twice = 0;
            for (int r = 0; r < STAGES; r++)
                twice += h * h * GAUSS[s * STAGES + r] * GAUSS[r * STAGES + t];
            for (int k = 0; k < SIZE; k++)
                for (int i = 0; i < SIZE; i++) {
                    int kl = (k - RIGID) * MODES + i - RIGID, elastic = k >= RIGID && i >= RIGID;
                    A[(t * SIZE + k) * LARGE + s * SIZE + i] = (s == t ? M[k * SIZE + i] : 0)
                        + (elastic ? twice * STIFFNESS_OF(body, kl) + once * DAMPING_OF(body, kl) : 0);
                }
        }
    body->h[place] = h;
    body->convergence[place] = 1;
    return factorise(A, LARGE, body->pivot + place * LARGE);
}

/* Angular velocity, if any, elastic coordinates and rates of stage s. */
static void stage_motion(Body *body, const real *x, real h, int s)
{
    real *q = body->q + s * MODES, *rate = body->rate + s * MODES;
#if RIGID
    real *w = body->w + 3 * s;
    for (int i = 0; i < 3; i++)
        w[i] = x[SPIN + i];
#endif
    for (int l = 0; l < MODES; l++) {
        rate[l] = x[RATE + l];
        q[l] = x[ELASTIC + l];
    }
    for (int t = 0; t < STAGES; t++) {
        const real *a = body->a + t * SIZE;
        real once = h * GAUSS[s * STAGES + t], twice = 0, row = 0;
        for (int r = 0; r < STAGES; r++) {
            twice += h * h * GAUSS[s * STAGES + r] * GAUSS[r * STAGES + t];
            row += GAUSS[s * STAGES + r];
        }
#if RIGID
        for (int i = 0; i < 3; i++)
            w[i] += once * a[3 + i];
#endif
        for (int l = 0; l < MODES; l++) {
            rate[l] += once * a[RIGID + l];
            q[l] += twice * a[RIGID + l] + (t == 0 ? h * row * x[RATE + l] : 0);
        }
    }
}

#if RIGID
/* Quaternions of all stages once more; the largest change. */
static real turn_stages(Body *body, const real *x, real h)
{
    real moved[4 * STAGES], *turns = body->turns, largest = 0;
    for (int s = 0; s < STAGES; s++)
        quaternion_rate(turns + 4 * s, body->w + 3 * s, moved + 4 * s);
    for (int s = 0; s < STAGES; s++)
        for (int i = 0; i < 4; i++) {
            real value = x[QUATERNION + i];
            for (int t = 0; t < STAGES; t++)
                value += h * GAUSS[s * STAGES + t] * moved[4 * t + i];
            largest = fabs(value - turns[4 * s + i]) > largest ? fabs(value - turns[4 * s + i]) : largest;
            turns[4 * s + i] = value;
        }
    return largest;
}
#endif

/* One iteration: the size of its correction. */
static real iterate(Body *body, const real *x, real h, int place)
{
    real size = 0, turn = 0, *all = body->stage;
    for (int s = 0; s < STAGES; s++)
        stage_motion(body, x, h, s);
#if RIGID
    turn = turn_stages(body, x, h);
#endif
#if LINEAR_INPUTS
    for (int s = 0; s < STAGES; s++) {
        real node = 0;
        for (int t = 0; t < STAGES; t++)
            node += GAUSS[s * STAGES + t];
        set_inputs(body, body->part[0] + node * body->part[1]);
        stage_residual(body, s, all + s * SIZE);
    }
#else
    for (int s = 0; s < STAGES; s++)
        stage_residual(body, s, all + s * SIZE);
#endif
    solve(body->matrix + place * LARGE * LARGE, LARGE, body->pivot + place * LARGE, all);
    for (int s = 0; s < STAGES; s++) {
        real *d = all + s * SIZE, part = h * h * relative_size(d);
        size = part > size || part != part ? part : size;
        for (int i = 0; i < SIZE; i++)
            body->a[s * SIZE + i] -= d[i];
    }
    return size + turn;
}

/* From the stages to the end of the step. */
static void finish(Body *body, real *x, real h)
{
    real share = (real)1 / STAGES;
#if RIGID
    real R[9], a[3], moved[4 * STAGES];
    for (int i = 0; i < 3; i++)
        x[POSITION + i] += h * x[VELOCITY + i];
#endif
    for (int l = 0; l < MODES; l++)
        x[ELASTIC + l] += h * x[RATE + l];
    for (int t = 0; t < STAGES; t++) {
        real twice = 0;
        for (int s = 0; s < STAGES; s++)
            twice += h * h * share * GAUSS[s * STAGES + t];
        for (int l = 0; l < MODES; l++) {
            x[ELASTIC + l] += twice * body->a[t * SIZE + RIGID + l];
            x[RATE + l] += h * share * body->a[t * SIZE + RIGID + l];
        }
#if RIGID
        rotation(body->turns + 4 * t, R);
        turned(R, body->a + t * SIZE, a);
        for (int i = 0; i < 3; i++) {
            x[POSITION + i] += twice * a[i];
            x[VELOCITY + i] += h * share * a[i];
            x[SPIN + i] += h * share * body->a[t * SIZE + 3 + i];
        }
        quaternion_rate(body->turns + 4 * t, body->w + 3 * t, moved + 4 * t);
#endif
    }
#if RIGID
    for (int t = 0; t < STAGES; t++)
        for (int i = 0; i < 4; i++)
            x[QUATERNION + i] += h * share * moved[4 * t + i];
#endif
}

/* x moves by h; 1 where the iteration does not converge, and then x stays. The factor is kept in one of the places. */
static int gauss_step(Body *body, real *x, real h, int place)
{
    real last = 0;
    /* Sizes that are nearly one do with one matrix. */
    if (fabs(h - body->h[place]) > (real)1e-3 * body->h[place] && prepare(body, x, h, place))
        return 1;
#if RIGID
    for (int s = 0; s < STAGES; s++)
        for (int i = 0; i < 4; i++)
            body->turns[4 * s + i] = x[QUATERNION + i];
#endif
    for (int count = 0; count < MOST_ITERATIONS; count++) {
        real size = iterate(body, x, h, place);
        if (!(size < (real)1e30))
            break;
        /* What is left is smaller by the rate of convergence; of one iteration by that of steps before, with growing
           doubt, until it is measured again. */
        real rate = count ? size / last : 2 * body->convergence[place];
        body->convergence[place] = rate > (real)1e-4 ? rate : (real)1e-4;
        if (size * (rate < 1 ? rate : 1) <= NEWTON(body) || (count > 2 && rate > (real)0.5 && size <= 10 * NEWTON(body))) {
            finish(body, x, h);
            return 0;
        }
        if (count == 12 && prepare(body, x, h, place))
            break;
        last = size;
    }
    body->h[place] = 0;
    for (int i = 0; i < LARGE; i++)
        body->a[i] = 0;
    return 1;
}
