/* Four sums at a time, which wait for each other less. */
static real dot(const real *a, const real *b, int n)
{
    real sum[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int k = 0; k < 4; k++)
            sum[k] += a[i + k] * b[i + k];
    for (; i < n; i++)
        sum[0] += a[i] * b[i];
    return sum[0] + sum[1] + (sum[2] + sum[3]);
}

/* LU with row exchanges in place, by columns; 1 where there is none. */
static int factorise(real *A, int n, int *pivot)
{
    for (int k = 0; k < n; k++) {
        int best = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[k * n + i]) > fabs(A[k * n + best]))
                best = i;
        pivot[k] = best;
        if (!(fabs(A[k * n + best]) > 0))
            return 1;
        for (int j = 0; best != k && j < n; j++) {
            real kept = A[j * n + k];
            A[j * n + k] = A[j * n + best];
            A[j * n + best] = kept;
        }
        for (int i = k + 1; i < n; i++)
            A[k * n + i] /= A[k * n + k];
        for (int j = k + 1; j < n; j++) {
            real value = A[j * n + k];
            for (int i = k + 1; i < n; i++)
                A[j * n + i] -= A[k * n + i] * value;
        }
    }
    return 0;
}

static void solve(const real *A, int n, const int *pivot, real *b)
{
    for (int k = 0; k < n; k++) {
        real kept = b[pivot[k]];
        b[pivot[k]] = b[k];
        b[k] = kept;
    }
    for (int k = 0; k < n; k++)
        for (int i = k + 1; i < n; i++)
            b[i] -= A[k * n + i] * b[k];
    for (int k = n - 1; k >= 0; k--) {
        b[k] /= A[k * n + k];
        for (int i = 0; i < k; i++)
            b[i] -= A[k * n + i] * b[k];
    }
}
