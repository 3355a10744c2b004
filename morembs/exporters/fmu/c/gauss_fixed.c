/* Steps of one size. */

static int advance(Body *body)
{
    return gauss_step(body, body->x, STEP, 0);
}
