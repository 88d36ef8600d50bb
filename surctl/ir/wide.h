#include <math.h>
#include <string.h>

/* number of runs side by side, unless defined by the caller */
#ifndef LANES
#if defined(__GNUC__) && defined(__AVX512DQ__)
#define LANES 8
#elif defined(__GNUC__) && defined(__AVX__)
#define LANES 4
#elif defined(__GNUC__) && (defined(__ARM_NEON) || defined(__VSX__))
#define LANES 2
#else
#define LANES 1
#endif
#endif

/* number of runs in one vector */
#if defined(__GNUC__) && defined(__AVX512DQ__) && LANES % 8 == 0
#define WIDTH 8
#elif defined(__GNUC__) && defined(__AVX__) && LANES % 4 == 0
#define WIDTH 4
#elif defined(__GNUC__) && (defined(__SSE2__) || defined(__ARM_NEON) || defined(__VSX__)) && LANES % 2 == 0
#define WIDTH 2
#else
#define WIDTH 1
#endif

#if WIDTH > 2
#include <immintrin.h>
#endif

#if defined(__GNUC__)
#define APART __attribute__((noinline))
#else
#define APART
#endif

#if WIDTH == 8

typedef __m512d vec;
typedef __mmask8 truth;
#define SET(x) _mm512_set1_pd(x)
#define TRUTH(a) _mm512_cmp_pd_mask(a, _mm512_setzero_pd(), _CMP_NEQ_UQ)
#define NUMBER(m) _mm512_maskz_mov_pd(m, _mm512_set1_pd(1.0))
#define LT(a, b) _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ)
#define LE(a, b) _mm512_cmp_pd_mask(a, b, _CMP_LE_OQ)
#define EQ(a, b) _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ)
#define NE(a, b) _mm512_cmp_pd_mask(a, b, _CMP_NEQ_UQ)
#define AND(a, b) _kand_mask8(a, b)
#define OR(a, b) _kor_mask8(a, b)
#define NOT(a) _knot_mask8(a)
#define SELECT(m, a, b) _mm512_mask_blend_pd(m, b, a)
#define ONLY_IF(m, a) _mm512_maskz_mov_pd(m, a)
#define FABS(a) _mm512_abs_pd(a)
/* the second operand if both are equal or one is a NaN */
#define FMIN(a, b) _mm512_min_pd(b, a)
#define FMAX(a, b) _mm512_max_pd(b, a)
#define ROOT(v) v = _mm512_sqrt_pd(v)
#define ROUND_DOWN(v) v = _mm512_floor_pd(v)
#define FUSED(v, b, c) v = _mm512_fmadd_pd(v, b, c)
#define BITS(m) ((unsigned)(m))

#elif WIDTH == 4

typedef __m256d vec;
typedef __m256d truth;
#define SET(x) _mm256_set1_pd(x)
#define TRUTH(a) _mm256_cmp_pd(a, _mm256_setzero_pd(), _CMP_NEQ_UQ)
#define NUMBER(m) _mm256_and_pd(m, _mm256_set1_pd(1.0))
#define LT(a, b) _mm256_cmp_pd(a, b, _CMP_LT_OQ)
#define LE(a, b) _mm256_cmp_pd(a, b, _CMP_LE_OQ)
#define EQ(a, b) _mm256_cmp_pd(a, b, _CMP_EQ_OQ)
#define NE(a, b) _mm256_cmp_pd(a, b, _CMP_NEQ_UQ)
#define AND(a, b) _mm256_and_pd(a, b)
#define OR(a, b) _mm256_or_pd(a, b)
#define NOT(a) _mm256_xor_pd(a, _mm256_castsi256_pd(_mm256_set1_epi64x(-1LL)))
#define SELECT(m, a, b) _mm256_blendv_pd(b, a, m)
#define ONLY_IF(m, a) _mm256_and_pd(m, a)
#define FABS(a) _mm256_andnot_pd(_mm256_set1_pd(-0.0), a)
#define FMIN(a, b) _mm256_min_pd(b, a)
#define FMAX(a, b) _mm256_max_pd(b, a)
#define ROOT(v) v = _mm256_sqrt_pd(v)
#define ROUND_DOWN(v) v = _mm256_floor_pd(v)
#if defined(__FMA__)
#define FUSED(v, b, c) v = _mm256_fmadd_pd(v, b, c)
#endif
#define BITS(m) ((unsigned)_mm256_movemask_pd(m))

#elif WIDTH == 2

typedef double vec __attribute__((vector_size(8 * WIDTH)));
typedef long long truth __attribute__((vector_size(8 * WIDTH)));
#define SET(x) ((x) - (vec){0.0})
#define TRUTH(a) ((truth)((a) != (vec){0.0}))
#define NUMBER(m) ((vec)((m) & (truth)SET(1.0)))
#define LT(a, b) ((truth)((a) < (b)))
#define LE(a, b) ((truth)((a) <= (b)))
#define EQ(a, b) ((truth)((a) == (b)))
#define NE(a, b) ((truth)((a) != (b)))
#define AND(a, b) ((a) & (b))
#define OR(a, b) ((a) | (b))
#define NOT(a) (~(a))
#define SELECT(m, a, b) ((vec)(((m) & (truth)(a)) | (~(m) & (truth)(b))))
#define ONLY_IF(m, a) ((vec)((m) & (truth)(a)))
#define FABS(a) ((vec)((truth)(a) & 0x7fffffffffffffffLL))
#define BITS(m) ((unsigned)(((m)[0] & 1LL) | ((m)[1] & 2LL)))
#define FMIN(a, b) SELECT(LT(b, a), b, a)
#define FMAX(a, b) SELECT(LT(a, b), b, a)
#define ROOT(v) LIBRARY(sqrt, v)
#define ROUND_DOWN(v) LIBRARY(floor, v)

#if defined(__FMA__)
#include <immintrin.h>
#define FUSED(v, b, c) v = (vec)_mm_fmadd_pd((__m128d)(v), (__m128d)(b), (__m128d)(c))
#endif

#else

typedef double vec;
typedef int truth;
#define SET(x) (x)
#define TRUTH(a) ((a) != 0.0)
#define NUMBER(m) ((m) ? 1.0 : 0.0)
#define LT(a, b) ((a) < (b))
#define LE(a, b) ((a) <= (b))
#define EQ(a, b) ((a) == (b))
#define NE(a, b) ((a) != (b))
#define AND(a, b) ((a) & (b))
#define OR(a, b) ((a) | (b))
#define NOT(a) (!(a))
#define SELECT(m, a, b) ((m) ? (a) : (b))
#define ONLY_IF(m, a) ((m) ? (a) : 0.0)
#define FABS(a) fabs(a)
#define BITS(m) ((unsigned)(m))
#define FMIN(a, b) (((b) < (a)) ? (b) : (a))
#define FMAX(a, b) (((a) < (b)) ? (b) : (a))
#define ROOT(v) LIBRARY(sqrt, v)
#define ROUND_DOWN(v) LIBRARY(floor, v)

#endif

#define ADD(a, b) ((a) + (b))
#define SUB(a, b) ((a) - (b))
#define MUL(a, b) ((a) * (b))
#define DIV(a, b) ((a) / (b))
#define NEG(a) (-(a))
#define INV(a) (SET(1.0) / (a))
#define SQ(a) ((a) * (a))
#define TWICE(a) ((a) + (a))

#define EACH_LANE for (int lane = 0; lane < LANES; lane += WIDTH)
#if WIDTH == 1
#define LOAD(from, at) (from)[(at) * LANES + lane]
#define STORE(to, at, v) (to)[(at) * LANES + lane] = (v)
#define LIBRARY(f, v) v = f(v)
#define LIBRARY_2(f, v, w) v = f(v, w)
#define FUSED(v, b, c) v = fma(v, b, c)
#else
typedef double loose __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));
#define LOAD(from, at) ((vec) * (const loose *)((from) + (at) * LANES + lane))
#define STORE(to, at, v) (*(loose *)((to) + (at) * LANES + lane) = (loose)(v))
#define LIBRARY(f, v) for (int k = 0; k < WIDTH; ++k) { v[k] = f(v[k]); }
#define LIBRARY_2(f, v, w) { const vec other = w; for (int k = 0; k < WIDTH; ++k) { v[k] = f(v[k], other[k]); } }
#if !defined(FUSED)
#define FUSED(v, b, c) \
    { const vec by = b, to = c; for (int k = 0; k < WIDTH; ++k) { v[k] = fma(v[k], by[k], to[k]); } }
#endif
#endif

/* helper functions; clang would warn about an unused static function */
#define HELPER static inline __attribute__((unused))

#define ALL_LANES ((1U << LANES) - 1U)

/* the lanes whose flag is 0, as bits */
HELPER unsigned running(const double *flag)
{
    unsigned run = 0U;
    EACH_LANE { run |= BITS(EQ(LOAD(flag, 0), SET(0.0))) << lane; }
    return run;
}

/* the piece with this index: rounded down, limited to the pieces that exist, 0 for a NaN */
HELPER int piece(double index, double last)
{
    return (int)((index >= 1.0) ? ((index < last) ? index : last) : 0.0);
}

HELPER void copy(double *to, const double *from, int size)
{
    memmove(to, from, (size_t)size * LANES * sizeof *to);
}

HELPER void fill(double *to, double value)
{
    for (int lane = 0; lane < LANES; ++lane) { to[lane] = value; }
}

/* new numbers for the lanes whose flag is 0 */
HELPER void keep(double *to, const double *fresh, const double *flag, int size)
{
    EACH_LANE {
        const truth run = EQ(LOAD(flag, 0), SET(0.0));
        for (int k = 0; k < size; ++k) {
            STORE(to, k, SELECT(run, LOAD(fresh, k), LOAD(to, k)));
        }
    }
}
