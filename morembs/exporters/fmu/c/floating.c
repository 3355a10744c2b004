/* An elastic body in a floating frame with all inertia terms of second order (Wallrapp 1994).

   A point is at r + R (x + phi q). States x = [r, Q, q, v, w, q']: position and quaternion of the frame, elastic
   coordinates, velocity of the frame along the inertial axes, angular velocity along those of the body, elastic rates.
   Accelerations have the parts [R' r'', w', q''], axes of the frame. Inputs u = [gravity; force and moment on each
   marker], along the inertial axes. */

#define RIGID 6
#define SIZE (RIGID + MODES)
#define POSITION 0
#define QUATERNION 3
#define ELASTIC 7
#define VELOCITY (7 + MODES)
#define SPIN (10 + MODES)
#define RATE (13 + MODES)
#define STIFFNESS_OF(body, kl) KE[kl]
#define DAMPING_OF(body, kl) (DE[kl] + (body)->p[DAMPING_RATIO] * D_UNIT[kl])

static void cross(const real *a, const real *b, real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* R (3, 3) by rows of a quaternion (w, x, y, z) of any length. */
static void rotation(const real *Q, real *R)
{
    real s = 2 / dot(Q, Q, 4), w = Q[0], x = Q[1], y = Q[2], z = Q[3];
    R[0] = 1 - s * (y * y + z * z), R[1] = s * (x * y - w * z), R[2] = s * (x * z + w * y);
    R[3] = s * (x * y + w * z), R[4] = 1 - s * (x * x + z * z), R[5] = s * (y * z - w * x);
    R[6] = s * (x * z - w * y), R[7] = s * (y * z + w * x), R[8] = 1 - s * (x * x + y * y);
}

static void product(const real *P, const real *Q, real *to)
{
    to[0] = P[0] * Q[0] - P[1] * Q[1] - P[2] * Q[2] - P[3] * Q[3];
    to[1] = P[0] * Q[1] + P[1] * Q[0] + P[2] * Q[3] - P[3] * Q[2];
    to[2] = P[0] * Q[2] - P[1] * Q[3] + P[2] * Q[0] + P[3] * Q[1];
    to[3] = P[0] * Q[3] + P[1] * Q[2] - P[2] * Q[1] + P[3] * Q[0];
}

static void turned(const real *R, const real *a, real *to)
{
    for (int i = 0; i < 3; i++)
        to[i] = dot(R + 3 * i, a, 3);
}

static void turned_back(const real *R, const real *a, real *to)
{
    for (int i = 0; i < 3; i++)
        to[i] = R[i] * a[0] + R[3 + i] * a[1] + R[6 + i] * a[2];
}

/* to = T a with T = 1 + b hat(turn) + c hat(turn)^2: the angular velocity, along the unmoved axes, of a rate a of turn. */
static void spin_of_turn(const real *turn, const real *a, int transposed, real *to)
{
    real square = dot(turn, turn, 3), angle = sqrt(square), once[3], twice[3];
    real b = (real)0.5 - square / 24, c = (real)1 / 6 - square / 120;
    if (square > (real)1e-6) {
        real half = sin(angle / 2);
        b = 2 * half * half / square;
        c = (angle - sin(angle)) / (angle * square);
    }
    cross(turn, a, once);
    cross(turn, once, twice);
    for (int i = 0; i < 3; i++)
        to[i] = a[i] + (transposed ? -b : b) * once[i] + c * twice[i];
}

/* Parts of the mass matrix that change with q and the velocity forces, axes of the frame. */
static void inertia(Body *body, const real *w, const real *q, const real *rate, real *force)
{
    real *at_q = body->at_q, *at_rate = body->at_rate, *J = body->J, *Cr = body->Cr, *moment = body->moment;
    real flow[3], G[9], N[9], spin[9], a[3], b[3];
    for (int i = 0; i < 9 * MODES; i++)
        at_q[i] = 0;
    for (int i = 0; i < 3 * MODES; i++)
        at_rate[i] = 0;
    add_columns(9 * MODES, MODES, PHI_PHI, q, at_q);
    add_columns(3 * MODES, MODES, CR_Q, rate, at_rate);
    for (int i = 0; i < 3; i++) {
        moment[i] = FIRST[i] + dot(CT + i * MODES, q, MODES);
        flow[i] = dot(CT + i * MODES, rate, MODES);
        const real *plus = at_q + (3 * ((i + 1) % 3) + (i + 2) % 3) * MODES;
        const real *minus = at_q + (3 * ((i + 2) % 3) + (i + 1) % 3) * MODES;
        for (int l = 0; l < MODES; l++)
            Cr[i * MODES + l] = CR[i * MODES + l] + plus[l] - minus[l];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int ij = 3 * i + j, ji = 3 * j + i;
            G[ij] = dot(X_PHI + ij * MODES, q, MODES) + dot(X_PHI + ji * MODES, q, MODES)
                    + dot(at_q + ij * MODES, q, MODES);
            N[ij] = dot(X_PHI + ij * MODES, rate, MODES) + dot(at_q + ij * MODES, rate, MODES);
            spin[ij] = w[i] * w[j] - (i == j ? dot(w, w, 3) : 0);
        }
    for (int i = 0; i < 9; i++)
        J[i] = INERTIA[i] - G[i] + (i % 4 == 0 ? G[0] + G[4] + G[8] : 0);
    cross(w, flow, a);
    for (int i = 0; i < 3; i++)
        force[i] = 2 * a[i] + dot(spin + 3 * i, moment, 3);
    turned(J, w, a);
    cross(w, a, b);
    turned_back(N, w, a);
    for (int i = 0; i < 3; i++)
        force[3 + i] = 2 * ((N[0] + N[4] + N[8]) * w[i] - a[i]) + b[i];
    for (int l = 0; l < MODES; l++)
        force[6 + l] = 0;
    for (int i = 0; i < 9; i++)
        for (int l = 0; l < MODES; l++)
            force[6 + l] += spin[i] * (X_PHI[i * MODES + l] + at_q[i * MODES + l]);
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < MODES; l++)
            force[6 + l] += 2 * w[i] * at_rate[i * MODES + l];
}

/* to += M a, after inertia(). */
static void add_mass_times(const Body *body, const real *a, real *to)
{
    real b[3];
    cross(a + 3, body->moment, b);
    for (int i = 0; i < 3; i++)
        to[i] += MASS * a[i] + b[i] + dot(CT + i * MODES, a + 6, MODES);
    cross(body->moment, a, b);
    for (int i = 0; i < 3; i++)
        to[3 + i] += b[i] + dot(body->J + 3 * i, a + 3, 3) + dot(body->Cr + i * MODES, a + 6, MODES);
    add_columns(MODES, MODES, ME, a + 6, to + 6);
    for (int i = 0; i < 3; i++)
        for (int l = 0; l < MODES; l++)
            to[6 + l] += CT[i * MODES + l] * a[i] + body->Cr[i * MODES + l] * a[3 + i];
}

/* M (SIZE, SIZE), after inertia(). */
static void mass_matrix(Body *body, real *M)
{
    real *a = body->column;
    for (int i = 0; i < SIZE; i++)
        a[i] = 0;
    for (int k = 0; k < SIZE; k++) {
        for (int i = 0; i < SIZE; i++)
            M[k * SIZE + i] = 0;
        a[k] = 1;
        add_mass_times(body, a, M + k * SIZE);
        a[k] = 0;
    }
}

/* Place of a marker in the frame: its point and its small rotation. */
static void in_frame(int marker, const real *q, real *arm, real *turn)
{
    for (int i = 0; i < 3; i++) {
        arm[i] = POINT[3 * marker + i] + dot(MOTION + (6 * marker + i) * MODES, q, MODES);
        turn[i] = dot(MOTION + (6 * marker + 3 + i) * MODES, q, MODES);
    }
}

#if COMPLIANCE
/* (3, 3): what the spin loads modes by, (w.w if i is j) - w_i w_j. */
static void centrifugal(const real *w, real *to)
{
    for (int i = 0; i < 9; i++)
        to[i] = (i % 4 == 0 ? dot(w, w, 3) : 0) - w[i / 3] * w[i % 3];
}

/* Static deflection of all markers, by the modes that a step does not resolve, under loads and spin; its rate where
   loads keep their inertial directions and the spin stays. */
static void deflect(Body *body, const real *R, const real *w)
{
    real loads[6 * MARKERS], turning[6 * MARKERS], spin[9];
    for (int k = 0; k < 2 * MARKERS; k++) {
        turned_back(R, body->u + 3 + 3 * k, loads + 3 * k);
        cross(loads + 3 * k, w, turning + 3 * k);
    }
    centrifugal(w, spin);
    for (int i = 0; i < 6 * MARKERS; i++)
        body->deflection[i] = body->deflection_rate[i] = 0;
    add_columns(6 * MARKERS, 6 * MARKERS, COMPLIANCE, loads, body->deflection);
    add_columns(6 * MARKERS, 9, SPIN_COMPLIANCE, spin, body->deflection);
    add_columns(6 * MARKERS, 6 * MARKERS, COMPLIANCE, turning, body->deflection_rate);
}

static void add_deflection(const Body *body, int marker, real *arm, real *turn)
{
    for (int i = 0; i < 3; i++) {
        arm[i] += body->deflection[6 * marker + i];
        turn[i] += body->deflection[6 * marker + 3 + i];
    }
}

#endif
/* to -= generalised forces of the inputs on all markers. */
static void subtract_loads(const Body *body, const real *R, const real *q, real *to)
{
    for (int k = 0; k < MARKERS; k++) {
        real arm[3], turn[3], both[6], lever[3];
        in_frame(k, q, arm, turn);
#if COMPLIANCE
        add_deflection(body, k, arm, turn);
#endif
        turned_back(R, body->u + 3 + 6 * k, both);
        turned_back(R, body->u + 6 + 6 * k, both + 3);
        cross(arm, both, lever);
        for (int i = 0; i < 3; i++) {
            to[i] -= both[i];
            to[3 + i] -= lever[i] + both[3 + i];
        }
        spin_of_turn(turn, both + 3, 1, lever);
        for (int i = 0; i < 3; i++)
            both[3 + i] = lever[i];
        for (int i = 0; i < 6; i++)
            for (int l = 0; l < MODES; l++)
                to[6 + l] -= MOTION[(6 * k + i) * MODES + l] * both[i];
    }
}

/* What is missing to equilibrium: M (a - gravity) + velocity, elastic and damping forces - loads. */
static void residual(Body *body, const real *Q, const real *w, const real *q, const real *rate, const real *a, real *to)
{
    real R[9], *b = body->column;
    rotation(Q, R);
    turned_back(R, body->u, b);
    for (int i = 0; i < SIZE; i++)
        b[i] = i < 3 ? a[i] - b[i] : a[i];
    inertia(body, w, q, rate, to);
    add_mass_times(body, b, to);
    add_columns(MODES, MODES, KE, q, to + 6);
    add_columns(MODES, MODES, DE, rate, to + 6);
    if (body->p[DAMPING_RATIO] > 0) {
        for (int l = 0; l < MODES; l++)
            b[l] = body->p[DAMPING_RATIO] * rate[l];
        add_columns(MODES, MODES, D_UNIT, b, to + 6);
    }
#if COMPLIANCE
    deflect(body, R, w);
#endif
    subtract_loads(body, R, q, to);
}

/* The mass matrix of x in body->stage. */
static void linearise(Body *body, const real *x)
{
    inertia(body, x + SPIN, x + ELASTIC, x + RATE, body->residual);
    mass_matrix(body, body->stage);
}

static void stage_residual(Body *body, int s, real *to)
{
    residual(body, body->turns + 4 * s, body->w + 3 * s, body->q + s * MODES, body->rate + s * MODES,
             body->a + s * SIZE, to);
}

static void quaternion_rate(const real *Q, const real *w, real *to)
{
    real half[4] = {0, w[0] / 2, w[1] / 2, w[2] / 2};
    product(Q, half, to);
}

/* Where the markers are and how they move; stresses with the loads, along the axes of the frame. */
static void observe(Body *body)
{
    const real *x = body->x;
    real *y = body->y;
    const real *q = x + ELASTIC, *rate = x + RATE, *w = x + SPIN;
    real R[9], Q[4], loads[6 * MARKERS], length = sqrt(dot(x + QUATERNION, x + QUATERNION, 4));
    rotation(x + QUATERNION, R);
    for (int i = 0; i < 4; i++)
        Q[i] = x[QUATERNION + i] / length;
#if COMPLIANCE
    deflect(body, R, w);
#endif
    for (int k = 0; k < MARKERS; k++, y += 13) {
        real arm[3], turn[3], a[3], b[3], small[4];
        in_frame(k, q, arm, turn);
#if COMPLIANCE
        add_deflection(body, k, arm, turn);
#endif
        turned(R, arm, a);
        real angle = sqrt(dot(turn, turn, 3));
        real share = angle > (real)1e-3 ? sin(angle / 2) / angle : (real)0.5 - angle * angle / 48;
        small[0] = (real)cos(angle / 2);
        for (int i = 0; i < 3; i++) {
            y[i] = x[POSITION + i] + a[i];
            small[1 + i] = share * turn[i];
        }
        product(Q, small, y + 3);
        cross(w, arm, a);
        for (int i = 0; i < 3; i++)
            a[i] += dot(MOTION + (6 * k + i) * MODES, rate, MODES);
#if COMPLIANCE
        for (int i = 0; i < 3; i++)
            a[i] += body->deflection_rate[6 * k + i];
#endif
        turned(R, a, y + 7);
        for (int i = 0; i < 3; i++)
            a[i] = dot(MOTION + (6 * k + 3 + i) * MODES, rate, MODES);
#if COMPLIANCE
        for (int i = 0; i < 3; i++)
            a[i] += body->deflection_rate[6 * k + 3 + i];
#endif
        spin_of_turn(turn, a, 0, b);
        for (int i = 0; i < 3; i++) {
            y[7 + i] += x[VELOCITY + i];
            b[i] += w[i];
        }
        turned(R, b, y + 10);
        turned_back(R, body->u + 3 + 6 * k, loads + 6 * k);
        turned_back(R, body->u + 6 + 6 * k, loads + 6 * k + 3);
    }
    for (int i = 0; i < 6 * STRESSES; i++)
        y[i] = 0;
    add_columns(6 * STRESSES, MODES, STRESS, q, y);
    add_columns(6 * STRESSES, 6 * MARKERS, STRESS_LOAD, loads, y);
#if COMPLIANCE
    real spin[9];
    centrifugal(w, spin);
    add_columns(6 * STRESSES, 9, SPIN_STRESS, spin, y);
#endif
    von_mises(y, y + 6 * STRESSES);
}
