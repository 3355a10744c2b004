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

/* Size of a change of place and turn of the frame and of q, by its mass without coupling, per length of the body. */
static real relative_size(const real *place, const real *turn, const real *q)
{
    real elastic = 0;
    for (int l = 0; l < MODES; l++)
        elastic += ME[l * MODES + l] * q[l] * q[l];
    return sqrt((dot(place, place, 3) + elastic / MASS) / (LENGTH * LENGTH) + dot(turn, turn, 3));
}

/* The matrix of Newton's method for steps of size h, factorised in the place of that number. */
static int prepare(Body *body, const real *x, real h, int place)
{
    real *M = body->stage, *A = body->matrix + place * LARGE * LARGE, zeta = body->p[DAMPING_RATIO];
    inertia(body, x + SPIN, x + ELASTIC, x + RATE, body->residual);
    mass_matrix(body, M);
    for (int s = 0; s < STAGES; s++)
        for (int t = 0; t < STAGES; t++) {
            real once = h * GAUSS[s * STAGES + t], twice = 0;
            for (int r = 0; r < STAGES; r++)
                twice += h * h * GAUSS[s * STAGES + r] * GAUSS[r * STAGES + t];
            for (int k = 0; k < SIZE; k++)
                for (int i = 0; i < SIZE; i++) {
                    int kl = (k - 6) * MODES + i - 6, elastic = k > 5 && i > 5;
                    A[(t * SIZE + k) * LARGE + s * SIZE + i] = (s == t ? M[k * SIZE + i] : 0)
                        + (elastic ? twice * KE[kl] + once * (DE[kl] + zeta * D_UNIT[kl]) : 0);
                }
        }
    body->h[place] = h;
    body->convergence[place] = 1;
    return factorise(A, LARGE, body->pivot + place * LARGE);
}

/* Angular velocity, elastic coordinates and rates of stage s; and where its quaternion moves. */
static void stage_motion(const Body *body, const real *x, real h, int s, real *w, real *q, real *rate)
{
    for (int i = 0; i < 3; i++)
        w[i] = x[SPIN + i];
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
        for (int i = 0; i < 3; i++)
            w[i] += once * a[3 + i];
        for (int l = 0; l < MODES; l++) {
            rate[l] += once * a[6 + l];
            q[l] += twice * a[6 + l] + (t == 0 ? h * row * x[RATE + l] : 0);
        }
    }
}

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

/* One iteration: the size of its correction. */
static real iterate(Body *body, const real *x, real h, int place)
{
    real size = 0, *all = body->stage;
    for (int s = 0; s < STAGES; s++)
        stage_motion(body, x, h, s, body->w + 3 * s, body->q + s * MODES, body->rate + s * MODES);
    real turn = turn_stages(body, x, h);
    for (int s = 0; s < STAGES; s++)
        residual(body, body->turns + 4 * s, body->w + 3 * s, body->q + s * MODES, body->rate + s * MODES,
                 body->a + s * SIZE, all + s * SIZE);
    solve(body->matrix + place * LARGE * LARGE, LARGE, body->pivot + place * LARGE, all);
    for (int s = 0; s < STAGES; s++) {
        real *d = all + s * SIZE, part = h * h * relative_size(d, d + 3, d + 6);
        size = part > size || part != part ? part : size;
        for (int i = 0; i < SIZE; i++)
            body->a[s * SIZE + i] -= d[i];
    }
    return size + turn;
}

/* From the stages to the end of the step. */
static void finish(Body *body, real *x, real h)
{
    real R[9], a[3], moved[4 * STAGES], share = (real)1 / STAGES;
    for (int i = 0; i < 3; i++)
        x[POSITION + i] += h * x[VELOCITY + i];
    for (int l = 0; l < MODES; l++)
        x[ELASTIC + l] += h * x[RATE + l];
    for (int t = 0; t < STAGES; t++) {
        real twice = 0;
        for (int s = 0; s < STAGES; s++)
            twice += h * h * share * GAUSS[s * STAGES + t];
        rotation(body->turns + 4 * t, R);
        turned(R, body->a + t * SIZE, a);
        for (int i = 0; i < 3; i++) {
            x[POSITION + i] += twice * a[i];
            x[VELOCITY + i] += h * share * a[i];
            x[SPIN + i] += h * share * body->a[t * SIZE + 3 + i];
        }
        for (int l = 0; l < MODES; l++) {
            x[ELASTIC + l] += twice * body->a[t * SIZE + 6 + l];
            x[RATE + l] += h * share * body->a[t * SIZE + 6 + l];
        }
        quaternion_rate(body->turns + 4 * t, body->w + 3 * t, moved + 4 * t);
    }
    for (int t = 0; t < STAGES; t++)
        for (int i = 0; i < 4; i++)
            x[QUATERNION + i] += h * share * moved[4 * t + i];
}

/* x moves by h; 1 where the iteration does not converge, and then x stays. The factor is kept in one of the places. */
static int gauss_step(Body *body, real *x, real h, int place)
{
    real last = 0;
    /* Sizes that are nearly one do with one matrix. */
    if (fabs(h - body->h[place]) > (real)1e-3 * body->h[place] && prepare(body, x, h, place))
        return 1;
    for (int s = 0; s < STAGES; s++)
        for (int i = 0; i < 4; i++)
            body->turns[4 * s + i] = x[QUATERNION + i];
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
