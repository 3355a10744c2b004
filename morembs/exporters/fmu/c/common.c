/* 1 where a parameter is below zero, or a parameter, an input or a state is no finite number. */
static int unsound(const Body *body)
{
    for (int i = 0; i < PARAMETERS; i++)
        if (!isfinite(body->p[i]) || body->p[i] < 0)
            return 1;
    for (int i = 0; i < INPUTS; i++)
        if (!isfinite(body->u[i]))
            return 1;
    for (int i = 0; i < STATES; i++)
        if (!isfinite(body->x[i]))
            return 1;
#if LINEAR_INPUTS
    for (int i = 0; i < INPUTS; i++)
        if (!isfinite(body->u_change[i]))
            return 1;
#endif
    return 0;
}

/* to += the columns (rows each) of a table times a vector; four at a time, so that sums stay in registers. */
static void add_columns(int rows, int columns, const real *restrict table, const real *restrict vector,
                        real *restrict to)
{
    int k = 0;
    for (; k + 4 <= columns; k += 4, table += 4 * rows, vector += 4)
        for (int i = 0; i < rows; i++)
            to[i] += table[i] * vector[0] + table[rows + i] * vector[1] + table[2 * rows + i] * vector[2]
                     + table[3 * rows + i] * vector[3];
    for (; k < columns; k++, table += rows, vector++)
        for (int i = 0; i < rows; i++)
            to[i] += table[i] * vector[0];
}
