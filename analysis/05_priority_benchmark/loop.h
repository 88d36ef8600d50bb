/* The loop around one contender, the same for all of them; `one` is defined in the file that includes this.
 *
 * problems holds `count` records of `size` doubles, answers gets `count` records of `width`. All problems are solved
 * `repeats` times over. With ns, each solve of the first time is timed by itself [ns].
 */
#include <time.h>

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

double many(long count, long size, long width, long repeats, const double *problems, double *answers, double *ns);
double many(long count, long size, long width, long repeats, const double *problems, double *answers, double *ns)
{
    if (ns) {
        for (long i = 0; i < count; ++i) {
            const double begin = now();
            one(problems + i * size, answers + i * width);
            ns[i] = now() - begin;
        }
        return 0.0;
    }
    const double begin = now();
    for (long r = 0; r < repeats; ++r) {
        for (long i = 0; i < count; ++i) { one(problems + i * size, answers + i * width); }
    }
    return (now() - begin) / (double)(repeats * count);
}
