/* Steps of one size, whose matrices were made with the body. */

static int advance(Body *body)
{
    affine_step(body, STEP_X, STEP_U);
    return 0;
}
