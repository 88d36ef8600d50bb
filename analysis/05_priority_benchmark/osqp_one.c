/* OSQP's generated code: new vectors and a new matrix, solve. A record is q (n), l, u (m), values of A by columns. */
#include <math.h>
#include "osqp.h"
#include "workspace.h"

static void one(const double *record, double *answer)
{
    const double *l = record + COLUMNS, *u = l + ROWS, *values = u + ROWS;
    const OSQPInt bad = osqp_update_data_vec(&solver, record, l, u)
        || osqp_update_data_mat(&solver, OSQP_NULL, OSQP_NULL, 0, values, OSQP_NULL, ENTRIES) || osqp_solve(&solver);
    const int solved = !bad && solver.info->status_val == OSQP_SOLVED;
    for (int i = 0; i < COLUMNS; ++i) { answer[i] = solved ? solver.solution->x[i] : NAN; }
}

#include "loop.h"
