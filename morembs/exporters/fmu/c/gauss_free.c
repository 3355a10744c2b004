/* A step of any size, in parts: each is made whole and in halves, the halves stay if both agree. */

#define FINEST 20
/* How far the halves are nearer to the solution than the whole, for order four. */
#define GAIN 15

static void copy(const real *from, real *to)
{
    for (int i = 0; i < STATES; i++)
        to[i] = from[i];
}

/* Distance of two states per length of the body, velocities as far as they carry in h. */
static real distance(Body *body, const real *a, const real *b, real h)
{
    real *change = body->column, size = 0;
    for (int part = 0; part < 2; part++) {
        real scale = part ? h : 1;
#if RIGID
        int at = part ? VELOCITY : POSITION;
        for (int i = 0; i < 3; i++) {
            change[i] = scale * (a[at + i] - b[at + i]);
            change[3 + i] = part ? h * (a[SPIN + i] - b[SPIN + i])
                                 : 2 * (a[QUATERNION + 1 + i] - b[QUATERNION + 1 + i]);
        }
#endif
        for (int l = 0; l < MODES; l++)
            change[RIGID + l] = scale * (a[(part ? RATE : ELASTIC) + l] - b[(part ? RATE : ELASTIC) + l]);
        real found = relative_size(change);
        size = found > size || found != found ? found : size;
    }
#if RIGID
    real real_part = fabs(a[QUATERNION] - b[QUATERNION]);
    size = real_part > size ? real_part : size;
#endif
    return size;
}

/* From body->x by h; the result is body->halves, the error what is returned; negative where it does not converge. */
static real tried(Body *body, real h)
{
    copy(body->x, body->halves);
    copy(body->x, body->whole);
#if LINEAR_INPUTS
    real *part = body->part;
    int failed = gauss_step(body, body->whole, h, 0);
    part[1] /= 2;
    failed = failed || gauss_step(body, body->halves, h / 2, 1);
    part[0] += part[1];
    if (failed || gauss_step(body, body->halves, h / 2, 1))
        return -1;
#else
    if (gauss_step(body, body->whole, h, 0) || gauss_step(body, body->halves, h / 2, 1)
        || gauss_step(body, body->halves, h / 2, 1))
        return -1;
#endif
    return distance(body, body->halves, body->whole, h) / GAIN;
}

static int advance(Body *body, real time, real h)
{
    long parts = 1L << body->level[0], done = 0;
    (void)time;
    while (done < parts) {
#if LINEAR_INPUTS
        body->part[1] = (real)1 / parts;
        body->part[0] = done * body->part[1];
#endif
        real error = tried(body, h / parts), tolerance = body->p[TOLERANCE];
        if (error >= 0 && error <= tolerance) {
            copy(body->halves, body->x);
            done++;
            if (error * 64 < tolerance && done % 2 == 0 && body->level[0] > 0) {
                body->level[0]--;
                parts /= 2;
                done /= 2;
            }
        } else if (body->level[0] < FINEST) {
            body->level[0]++;
            parts *= 2;
            done *= 2;
        } else {
            return 1;
        }
    }
    return 0;
}
