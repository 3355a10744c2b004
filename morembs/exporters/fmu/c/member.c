/* A planar member of large deflections by global modal parameterisation; docs/howto/gmp.md has the equations.

   q = [x, y, angle of the start, x, y, angle of the end, eta] along the axes of the plane. PLACE has the MODES free
   coordinates first, frames before eta, whose positions and rates are the states x, then the HELD ones, whose motion
   comes in: u = [gravity; loads on LOADED free coordinates of frames; positions, velocities, accelerations of the held].
   Columns of tables hold amplitudes of fields: FUNCTIONS of x, as many of y, others. */

#define RIGID 0
#define SIZE MODES
#define ELASTIC 0
#define RATE MODES
#define ALL (6 + BENDING)
/* The parameters t1, t2, eps, eta of a shape. */
#define INNER (3 + BENDING)
/* Places of d0, k, c and H among the numbers of the table, after the shapes X and A. */
#define CHORD (2 * AMPLITUDES)
#define TENSION (CHORD + 1)
#define BY_MODES (CHORD + 2)
#define TWICE_BY_MODES (BY_MODES + BENDING)
#define FIRST_HELD (2 + LOADED)
#define STIFFNESS_OF(body, kl) (body)->K[kl]
#define DAMPING_OF(body, kl) ((body)->p[DAMPING] * (body)->K_strains[kl])

static int place(int k) { return (int)PLACE[k]; }

/* Chebyshev polynomials of t in the range with their first two derivatives, count numbers each. */
static void polynomials(real t, int count, real *T)
{
    real z = t / REACH, *once = T + count, *twice = T + 2 * count;
    for (int k = 0; k < count; k++) {
        T[k] = k > 1 ? 2 * z * T[k - 1] - T[k - 2] : k ? z : 1;
        once[k] = k > 1 ? 2 * (T[k - 1] + z * once[k - 1]) - once[k - 2] : k;
        twice[k] = k > 1 ? 4 * once[k - 1] + 2 * z * twice[k - 1] - twice[k - 2] : 0;
    }
    for (int k = 0; k < count; k++) {
        once[k] /= REACH;
        twice[k] /= REACH * REACH;
    }
}

/* to = the rows of a table, their derivatives by t1 and t2, and the second ones by t1 t1, t1 t2, t2 t2. */
static void tabulate(const real *t, int count, int rows, const real *table, real *to)
{
    static const int first[6] = {0, 1, 0, 2, 1, 0}, second[6] = {0, 0, 1, 0, 1, 2};
    real a[3 * MOST_POINTS], b[3 * MOST_POINTS], weight[MOST_POINTS * MOST_POINTS];
    polynomials(t[0], count, a);
    polynomials(t[1], count, b);
    for (int order = 0; order < 6; order++, to += rows) {
        for (int j = 0; j < count; j++)
            for (int i = 0; i < count; i++)
                weight[j * count + i] = a[first[order] * count + i] * b[second[order] * count + j];
        for (int i = 0; i < rows; i++)
            to[i] = 0;
        add_columns(rows, count * count, table, weight, to);
    }
}

/* A field from the frame of the chord to the axes of the plane. */
static void turn_field(real c, real s, real *field)
{
    for (int i = 0; i < FUNCTIONS; i++) {
        real x = field[i], y = field[FUNCTIONS + i];
        field[i] = c * x - s * y;
        field[FUNCTIONS + i] = s * x + c * y;
    }
}

/* d p / d q of the parameters p of a shape, by columns, and that of the direction of the chord. */
static void parameter_slopes(real d, real c, real s, const real *number, real *P, real *phi_q)
{
    const real d0 = number[CHORD], *by_t = number + NUMBERS + CHORD;
    for (int k = 0; k < ALL; k++)
        phi_q[k] = 0;
    phi_q[0] = s / d, phi_q[1] = -c / d, phi_q[3] = -s / d, phi_q[4] = c / d;
    for (int k = 0; k < ALL; k++) {
        real *column = P + k * INNER;
        for (int i = 0; i < INNER; i++)
            column[i] = k > 5 && i == k - 3;
        column[0] = (k == 2) - phi_q[k];
        column[1] = (k == 5) - phi_q[k];
        column[2] = -d / (d0 * d0) * (by_t[0] * column[0] + by_t[NUMBERS] * column[1]);
    }
    P[2] -= c / d0, P[INNER + 2] -= s / d0, P[3 * INNER + 2] += c / d0, P[4 * INNER + 2] += s / d0;
}

/* Shape u in the frame of the chord, J = dx/dq by columns and M J. */
static void motion_slopes(Body *body, real eps, real c, real s, const real *phi_q)
{
    const real *X = body->number, *A = X + AMPLITUDES, *eta = body->all_q + 6;
    real *G = body->G, *u = body->shape, *side = body->side;
    for (int i = 0; i < AMPLITUDES; i++) {
        u[i] = X[i] + A[i] * eps;
        for (int k = 0; k < 2; k++)
            G[k * AMPLITUDES + i] = X[(1 + k) * NUMBERS + i] + eps * A[(1 + k) * NUMBERS + i];
        G[2 * AMPLITUDES + i] = A[i];
    }
    for (int i = 0; i < BENDING * AMPLITUDES; i++)
        G[3 * AMPLITUDES + i] = PSI[i];
    add_columns(AMPLITUDES, BENDING, PSI, eta, u);
    for (int i = 0; i < AMPLITUDES; i++)
        side[i] = u[i];
    turn_field(c, s, side);
    for (int i = 0; i < FUNCTIONS; i++) {
        real x = side[i];
        side[i] = -side[FUNCTIONS + i];
        side[FUNCTIONS + i] = x;
    }
    for (int i = 2 * FUNCTIONS; i < AMPLITUDES; i++)
        side[i] = TURN[i - 2 * FUNCTIONS];
    for (int k = 0; k < ALL; k++) {
        real *column = body->J + k * AMPLITUDES, *heavy = body->MJ + k * AMPLITUDES;
        for (int i = 0; i < AMPLITUDES; i++)
            column[i] = heavy[i] = 0;
        add_columns(AMPLITUDES, INNER, G, body->P + k * INNER, column);
        turn_field(c, s, column);
        for (int i = 0; i < AMPLITUDES; i++)
            column[i] += side[i] * phi_q[k];
        for (int i = 0; k < 2 && i < FUNCTIONS; i++)
            column[k * FUNCTIONS + i] += ONE[i];
        add_columns(AMPLITUDES, AMPLITUDES, FIELD_MASS, column, heavy);
    }
}

/* (dJ/dt) q' in body->bend, from second derivatives of the table. */
static void velocity_accelerations(Body *body, const real *gap, real d, real eps, real c, real s)
{
    const real *number = body->number, *v = body->all_v, *u = body->shape, d0 = number[CHORD];
    const real rate[2] = {v[3] - v[0], v[4] - v[1]};
    real *bend = body->bend, *along = body->along, *twice = body->twice;
    real d1 = (gap[0] * rate[0] + gap[1] * rate[1]) / d, d2 = (rate[0] * rate[0] + rate[1] * rate[1] - d1 * d1) / d;
    real phi1 = (gap[0] * rate[1] - gap[1] * rate[0]) / (d * d), phi2 = -2 * phi1 * d1 / d;
    real a = v[2] - phi1, b = v[5] - phi1;
    for (int i = 0; i < NUMBERS; i++) {
        const real *n = number + i;
        along[i] = a * n[NUMBERS] + b * n[2 * NUMBERS];
        twice[i] = a * a * n[3 * NUMBERS] + 2 * a * b * n[4 * NUMBERS] + b * b * n[5 * NUMBERS]
                   - phi2 * (n[NUMBERS] + n[2 * NUMBERS]);
    }
    real c1 = along[CHORD], c2 = twice[CHORD];
    real eps1 = d1 / d0 - d * c1 / (d0 * d0);
    real eps2 = d2 / d0 - (2 * d1 * c1 + d * c2) / (d0 * d0) + 2 * d * c1 * c1 / (d0 * d0 * d0);
    real *u1 = body->side;
    for (int i = 0; i < AMPLITUDES; i++) {
        int A = AMPLITUDES + i;
        u1[i] = along[i] + along[A] * eps + number[A] * eps1;
        bend[i] = twice[i] + twice[A] * eps + 2 * along[A] * eps1 + number[A] * eps2;
    }
    add_columns(AMPLITUDES, BENDING, PSI, v + 6, u1);
    /* In the turning frame of the chord: Coriolis, angular and centripetal acceleration of positions. */
    for (int x = 0, y = FUNCTIONS; x < FUNCTIONS; x++, y++) {
        bend[x] -= 2 * phi1 * u1[y] + phi2 * u[y] + phi1 * phi1 * u[x];
        bend[y] += 2 * phi1 * u1[x] + phi2 * u[x] - phi1 * phi1 * u[y];
    }
    turn_field(c, s, bend);
    for (int i = 2 * FUNCTIONS; i < AMPLITUDES; i++)
        bend[i] += phi2 * TURN[i - 2 * FUNCTIONS];
}

/* dV/dp and damping forces by the parameters p; second derivatives of V, and the part of them that strains resist. */
static void elastic_forces(Body *body, real eps, const real *W, real *force, real *S, real *S_strains)
{
    const real *number = body->number, *c = number + BY_MODES, *H = number + TWICE_BY_MODES, *eta = body->all_q + 6;
    real e = eps, slope[INNER], rate[INNER], k = number[TENSION], along = 0;
    slope[0] = slope[1] = 0, slope[2] = 1;
    for (int l = 0; l < BENDING; l++) {
        real turned = 0;
        for (int i = 0; i < BENDING; i++) {
            turned += H[l * BENDING + i] * eta[i];
            for (int t = 0; t < 2; t++)
                slope[t] += H[(1 + t) * NUMBERS + l * BENDING + i] * eta[l] * eta[i] / 2;
        }
        for (int t = 0; t < 2; t++)
            slope[t] += c[(1 + t) * NUMBERS + l] * eta[l];
        e += c[l] * eta[l] + eta[l] * turned / 2;
        slope[3 + l] = c[l] + turned;
    }
    for (int i = 0; i < INNER; i++) {
        rate[i] = 0;
        for (int n = 0; n < ALL; n++)
            rate[i] += body->P[n * INNER + i] * body->all_v[n];
        along += slope[i] * rate[i];
    }
    for (int i = 0; i < INNER; i++) {
        real stiff = i > 2 ? SQUARES[i - 3] : 0, resisted = k * slope[i] * along + stiff * rate[i];
        for (int t = 0; i < 2 && t < 2; t++)
            resisted += W[3 + i + t] * rate[t];
        force[i] = k * e * slope[i] + body->p[DAMPING] * resisted;
        force[i] += i < 2 ? W[1 + i] + number[(1 + i) * NUMBERS + TENSION] * e * e / 2 : i > 2 ? stiff * eta[i - 3] : 0;
        for (int j = 0; j < INNER; j++) {
            real *to = S_strains + j * INNER + i;
            *to = k * slope[i] * slope[j] + (i == j ? stiff : 0) + (i < 2 && j < 2 ? W[3 + i + j] : 0);
            S[j * INNER + i] = *to;
            if (i > 2 && j > 2)
                S[j * INNER + i] += k * e * H[(i - 3) * BENDING + j - 3];
            else if (i < 2 && j > 2)
                S[j * INNER + i] += k * e * c[(1 + i) * NUMBERS + j - 3];
            else if (j < 2 && i > 2)
                S[j * INNER + i] += k * e * c[(1 + j) * NUMBERS + i - 3];
        }
    }
}

/* to = P' S P of the free coordinates. */
static void stiffness(const Body *body, const real *S, real *to)
{
    for (int k = 0; k < MODES; k++) {
        real moved[INNER];
        for (int i = 0; i < INNER; i++)
            moved[i] = 0;
        add_columns(INNER, INNER, S, body->P + place(k) * INNER, moved);
        for (int i = 0; i < MODES; i++)
            to[k * MODES + i] = dot(body->P + place(i) * INNER, moved, INNER);
    }
}

/* M q'' + force = loads, and the stiffness: body->inertia, force, K, K_strains at states q with rates; 1 beyond the
   tables. */
static int equations(Body *body, const real *state, const real *rate)
{
    real *q = body->all_q, *v = body->all_v, phi_q[ALL], t[2], W[6], inner[INNER], full = 2 * acos((real)-1);
    for (int k = 0; k < ALL; k++) {
        int held = FIRST_HELD + k - MODES;
        q[place(k)] = k < MODES ? state[k] : body->u[held];
        v[place(k)] = k < MODES ? rate[k] : body->u[held + HELD];
    }
    real gap[2] = {q[3] - q[0], q[4] - q[1]}, d = sqrt(gap[0] * gap[0] + gap[1] * gap[1]), phi = atan2(gap[1], gap[0]);
    phi += full * floor((q[2] - phi) / full + (real)0.5);
    t[0] = q[2] - phi, t[1] = q[5] - phi;
    if (!(d > 0) || !(fabs(t[0]) <= REACH) || !(fabs(t[1]) <= REACH))
        return 1;
    real c = cos(phi), s = sin(phi), eps;
    tabulate(t, POINTS, NUMBERS, TABLE, body->number);
    tabulate(t, ENERGY_POINTS, 1, ENERGY, W);
    eps = d / body->number[CHORD] - 1;
    parameter_slopes(d, c, s, body->number, body->P, phi_q);
    motion_slopes(body, eps, c, s, phi_q);
    velocity_accelerations(body, gap, d, eps, c, s);
    elastic_forces(body, eps, W, inner, body->S, body->S_strains);
    stiffness(body, body->S, body->K);
    stiffness(body, body->S_strains, body->K_strains);
    for (int k = 0; k < ALL; k++) {
        const real *heavy = body->MJ + k * AMPLITUDES;
        body->force[k] = dot(heavy, body->bend, AMPLITUDES) + dot(body->P + k * INNER, inner, INNER);
        for (int axis = 0; axis < 2; axis++)
            body->force[k] -= body->u[axis] * dot(heavy + axis * FUNCTIONS, ONE, FUNCTIONS);
        for (int i = 0; i < ALL; i++)
            body->inertia[k * ALL + i] = dot(body->J + i * AMPLITUDES, heavy, AMPLITUDES);
    }
    return 0;
}

/* What is missing to the balance of the coordinate number i of PLACE, with accelerations a of the free ones. */
static real missing(const Body *body, const real *a, int i)
{
    real sum = body->force[place(i)] - (i < LOADED ? body->u[2 + i] : 0);
    for (int k = 0; k < ALL; k++)
        sum += body->inertia[place(k) * ALL + place(i)] * (k < MODES ? a[k] : body->u[FIRST_HELD + 2 * HELD + k - MODES]);
    return sum;
}

/* The stiffness, and the mass matrix in body->stage, of states x that are within the tables. */
static void linearise(Body *body, const real *x)
{
    equations(body, x, x + RATE);
    for (int k = 0; k < MODES; k++)
        for (int i = 0; i < MODES; i++)
            body->stage[k * MODES + i] = body->inertia[place(k) * ALL + place(i)];
}

/* No number where the stage is beyond the tables, with which the step ends. */
static void stage_residual(Body *body, int s, real *to)
{
    int beyond = equations(body, body->q + s * MODES, body->rate + s * MODES);
    for (int i = 0; i < MODES; i++)
        to[i] = beyond ? NAN : missing(body, body->a + s * SIZE, i);
}

/* Accelerations of the free coordinates; 1 beyond the tables. */
static int accelerate(Body *body, real *a)
{
    int order[MODES];
    if (equations(body, body->x, body->x + RATE))
        return 1;
    for (int k = 0; k < MODES; k++)
        a[k] = 0;
    for (int k = 0; k < MODES; k++) {
        body->column[k] = -missing(body, a, k);
        for (int i = 0; i < MODES; i++)
            body->free_inertia[k * MODES + i] = body->inertia[place(k) * ALL + place(i)];
    }
    if (factorise(body->free_inertia, MODES, order))
        return 1;
    solve(body->free_inertia, MODES, order, body->column);
    for (int k = 0; k < MODES; k++)
        a[k] = body->column[k];
    return 0;
}

/* Reactions of what holds frames; positions, velocities and accelerations of free ones. No numbers beyond the tables. */
static void observe(Body *body)
{
    real a[MODES], *y = body->y;
    int beyond = accelerate(body, a);
    for (int i = 0; i < OUTPUTS; i++)
        y[i] = NAN;
    for (int i = 0; !beyond && i < HELD; i++)
        y[i] = missing(body, a, MODES + i);
    for (int i = 0; !beyond && i < LOADED; i++) {
        y[HELD + i] = body->x[i];
        y[HELD + LOADED + i] = body->x[RATE + i];
        y[HELD + 2 * LOADED + i] = a[i];
    }
}
