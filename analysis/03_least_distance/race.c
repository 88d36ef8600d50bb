/* Times our solver and DAQP's core on the same problems, alternately, in one process.
 *
 *     race PROBLEMS N M P ROUNDS
 *
 * PROBLEMS holds, for each problem, target (n), J (p n), x (p), rows (m (n + 3)), box (2n), as doubles; the first n
 * rows are the box. Prints one line a round: ns a solve for ours, DAQP's search alone, DAQP with what it has to do
 * for new data (normalise, transform, search, transform back); then the largest difference of the answers.
 */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "daqp/api.h"
#include "daqp/utils.h"

void surctl_tick(const double *target, const double *J, const double *x, const double *rows, const double *box,
                 double *v, double *status);

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 6) { return 2; }
    const int n = atoi(argv[2]), m = atoi(argv[3]), p = atoi(argv[4]), rounds = atoi(argv[5]);
    const int size = n + p * n + p + m * (n + 3) + 2 * n;
    FILE *file = fopen(argv[1], "rb");
    if (!file || fseek(file, 0, SEEK_END)) { return 2; }
    const long bytes = ftell(file);
    const int count = (int)(bytes / (long)sizeof(double) / size);
    double *all = malloc((size_t)bytes);
    rewind(file);
    if (!all || fread(all, (size_t)size * sizeof(double), (size_t)count, file) != (size_t)count) { return 2; }
    fclose(file);

    /* DAQP: H is the identity (NULL), the box as simple bounds, the task as equalities that it keeps active */
    const int total = m + p;
    double *f = calloc((size_t)(count * n), sizeof(double)), *A = calloc((size_t)(count * (total - n) * n), sizeof(double));
    double *upper = calloc((size_t)(count * total), sizeof(double)), *lower = calloc((size_t)(count * total), sizeof(double));
    int *sense = calloc((size_t)total, sizeof(int)), *fresh = calloc((size_t)total, sizeof(int));
    double *ours = calloc((size_t)(count * n), sizeof(double)), *theirs = calloc((size_t)(count * n), sizeof(double));
    for (int k = 0; k < p; ++k) { fresh[m + k] = ACTIVE + IMMUTABLE; }
    for (int c = 0; c < count; ++c) {
        const double *d = all + (size_t)c * (size_t)size, *J = d + n, *x = J + p * n, *rows = x + p;
        for (int i = 0; i < n; ++i) { f[c * n + i] = -d[i]; }
        for (int i = 0; i < m; ++i) {
            if (i >= n) { memcpy(A + (c * (total - n) + i - n) * n, rows + i * (n + 3), (size_t)n * sizeof(double)); }
            lower[c * total + i] = fmax(rows[i * (n + 3) + n], -1e30);
            upper[c * total + i] = fmin(rows[i * (n + 3) + n + 1], 1e30);
        }
        memcpy(A + (c * (total - n) + m - n) * n, J, (size_t)(p * n) * sizeof(double));
        for (int k = 0; k < p; ++k) { lower[c * total + m + k] = upper[c * total + m + k] = x[k]; }
    }
    DAQPProblem qp = {n, total, n, NULL, f, A, upper, lower, sense};
    DAQPWorkspace work;
    memset(&work, 0, sizeof work);
    memcpy(sense, fresh, (size_t)total * sizeof(int));
    double setup = 0.0;
    allocate_daqp_settings(&work);
    daqp_default_settings(work.settings);
    work.settings->primal_tol = 1e-9;
    if (setup_daqp(&qp, &work, &setup) < 0) { return 3; }

    for (int round = 0; round < rounds; ++round) {
        double status = 0.0, bad = 0.0, gap = 0.0, core = 0.0;
        const double begin = now();
        for (int c = 0; c < count; ++c) {
            const double *d = all + (size_t)c * (size_t)size, *J = d + n, *x = J + p * n, *rows = x + p;
            surctl_tick(d, J, x, rows, rows + m * (n + 3), ours + c * n, &status);
            bad += status != 1.0;
        }
        const double middle = now();
        for (int c = 0; c < count; ++c) {
            deactivate_constraints(&work);
            reset_daqp_workspace(&work);
            qp.f = f + c * n;
            qp.A = A + c * (total - n) * n;
            qp.bupper = upper + c * total;
            qp.blower = lower + c * total;
            memcpy(work.sense, fresh, (size_t)total * sizeof(int));
            work.x = theirs + c * n;
            if (update_ldp(UPDATE_M + UPDATE_v + UPDATE_d, &work) < 0 || activate_constraints(&work) < 0) { bad += 1e6; }
            const double start = now();
            if (daqp_ldp(&work) != EXIT_OPTIMAL) { bad += 1e3; }
            core += now() - start;
            ldp2qp_solution(&work);
        }
        const double end = now();
        double clock = 0.0;
        for (int c = 0; c < count; ++c) { const double a = now(); clock += now() - a; }
        for (int i = 0; i < count * n; ++i) { gap = fmax(gap, fabs(ours[i] - theirs[i])); }
        /* subtract the time of reading the clock from the two times that include it */
        printf("%.3f %.3f %.3f %.3e %.0f\n", (middle - begin) / count, (core - clock) / count,
               (end - middle - 2.0 * clock) / count, gap, bad);
    }
    return 0;
}
