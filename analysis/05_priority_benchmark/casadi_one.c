/* C that CasADi generated, called as its header says: GENERATED is the file, ENTRY the function.
 *
 * INPUTS lists the sizes of the arguments in a record; their places follow from it. UNITY is an argument that is not
 * in the record but 1 everywhere (a Hessian), -1 if there is none.
 */
#include <math.h>
#include GENERATED

static const long sizes[] = {INPUTS};

static void one(const double *record, double *answer)
{
    static const casadi_real ones[WIDTH * WIDTH] = {UNITS};
    static casadi_int iw[SIZE_IW + 1];
    static casadi_real w[SIZE_W + 1];
    const casadi_real *arg[SIZE_ARG + 1] = {0};
    casadi_real *res[SIZE_RES + 1] = {0};
    int place = 0;
    for (int k = 0; k < (int)(sizeof sizes / sizeof sizes[0]); ++k) {
        if (place == UNITY) { arg[place++] = ones; }
        arg[place++] = record;
        record += sizes[k];
    }
    res[0] = answer;
    if (ENTRY(arg, res, iw, w, 0)) { answer[0] = NAN; }
}

#include "loop.h"
