// Arithmetic of the exponents e_ij of row_loop.cl, in one of three widths. What follows them,
// exponentials of numbers near 0 and their sums, is float32 in all.
//
// -D PRECISE  0: float32; an error of about 2e-8 C / epsilon nats.
//             1: unevaluated sums of two float32 (about 48 bits), for devices without
//             float64; 4 times the time. Dekker 1971; Ogita, Rump, Oishi 2005 (Dot2).
//             2: float64; on CPUs 2.3 times the time.
// Inputs are float32 in all: PLANES of them, the second with what the first rounds off.
// -D DIM or SLICE, TILE, MASKED  see row_loop.cl

#if PRECISE
#define PLANES 2
#else
#define PLANES 1
#endif
#if PRECISE == 1
#pragma OPENCL FP_CONTRACT OFF // an error term must belong to the rounding that made it
#define STAGED_PLANES 2
#else
#define STAGED_PLANES 1
#endif

#if PRECISE == 2
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double staged_real;
typedef OF_LANES(double, WIDTH) ereal;
#if WIDTH == 1
// Casts: clang has no built-in function of one lane for NVPTX, and Intel's compiler, with one, computes wrongly.
#define TO_EREAL(v) ((double)(v))
#define TO_VREAL(v) ((float)(v))
#else
#define TO_EREAL(v) CONCAT(convert_double, WIDTH)(v)
#define TO_VREAL(v) CONCAT(convert_float, WIDTH)(v)
#endif
#elif PRECISE == 1
typedef float staged_real;
#if WIDTH == 1
typedef float2 ereal; // a struct's functions, inlined, leave intrinsics that simulators lack
#define HIGH(e) ((e).s0)
#define LOW(e) ((e).s1)
#else
typedef struct { vreal high, low; } ereal;
#define HIGH(e) ((e).high)
#define LOW(e) ((e).low)
#endif

INLINE ereal e_pair(const vreal high, const vreal low)
{
    ereal e;
    HIGH(e) = high;
    LOW(e) = low;
    return e;
}
#else
typedef float staged_real;
typedef vreal ereal;
#define TO_EREAL(v) (v)
#define TO_VREAL(v) (v)
#endif

// Length of a row of staged numbers, one for each column of a tile. With MASKED a column without mass follows
// them.
#if MASKED
#define STAGED_ROW (TILE + WIDTH)
#else
#define STAGED_ROW TILE
#endif
#define STAGED_PLANE ((STAGED_COORDINATES + 1) * STAGED_ROW)
#define STAGED_SIZE (STAGED_PLANES * STAGED_PLANE)

// --- WIDTH exponents at a time: load, sum, difference, product

INLINE ereal e_load(const __global float* p, const size_t plane)
{
#if PRECISE == 0
    return VLOAD(0, p);
#elif PRECISE == 1
    return e_pair(VLOAD(0, p), VLOAD(0, p + plane));
#else
    return TO_EREAL(VLOAD(0, p)) + TO_EREAL(VLOAD(0, p + plane));
#endif
}

#if PRECISE == 1
INLINE ereal e_sum(const ereal a, const ereal b)
{
    const vreal s = HIGH(a) + HIGH(b);
    const vreal t = s - HIGH(a);
    return e_pair(s, ((HIGH(a) - (s - t)) + (HIGH(b) - t)) + (LOW(a) + LOW(b)));
}

INLINE ereal e_product(const ereal a, const ereal b)
{
    const vreal p = HIGH(a) * HIGH(b);
    return e_pair(p, fma(HIGH(a), HIGH(b), -p) + (HIGH(a) * LOW(b) + LOW(a) * HIGH(b)));
}

INLINE ereal e_negative(const ereal a) { return e_pair(-HIGH(a), -LOW(a)); }
INLINE ereal e_constant(const float high, const float low) { return e_pair((vreal)(high), (vreal)(low)); }
#else
INLINE ereal e_sum(const ereal a, const ereal b) { return a + b; }
INLINE ereal e_product(const ereal a, const ereal b) { return a * b; }
INLINE ereal e_negative(const ereal a) { return -a; }
INLINE ereal e_constant(const float high, const float low)
{
#if PRECISE == 2
    return (ereal)((double)high + (double)low);
#else
    return (ereal)(high);
#endif
}
#endif

// Nearest float32 of e; and e - m for a float32 m near it, to float32's own precision.
INLINE vreal e_nearest(const ereal e)
{
#if PRECISE == 1
    return HIGH(e) + LOW(e);
#else
    return TO_VREAL(e);
#endif
}

INLINE vreal e_above(const ereal e, const vreal m)
{
#if PRECISE == 1
    return (HIGH(e) - m) + LOW(e);
#else
    return TO_VREAL(e - TO_EREAL(m));
#endif
}

// --- columns in local memory, read by all rows of a group

INLINE void e_stage(const ereal e, __local staged_real* p)
{
#if PRECISE == 1
    VSTORE(HIGH(e), 0, p);
    VSTORE(LOW(e), 0, p + STAGED_PLANE);
#else
    VSTORE(e, 0, p);
#endif
}

#ifdef SLICE
// A staged number, the same for all rows.
INLINE ereal e_staged(const __local staged_real* p)
{
#if PRECISE == 1
    return e_constant(p[0], p[STAGED_PLANE]);
#else
    return (ereal)(p[0]);
#endif
}

// WIDTH staged numbers.
INLINE ereal e_unstage(const __local staged_real* p)
{
#if PRECISE == 1
    return e_pair(VLOAD(0, p), VLOAD(0, p + STAGED_PLANE));
#else
    return VLOAD(0, p);
#endif
}

// e_ij of WIDTH rows and staged column j, which stage_exponents (row_loop.cl) has formed.
INLINE ereal exponent(const ereal* u, const __local staged_real* staged, const uint j)
{
    return u[j];
}
#else
// e_ij of WIDTH rows and staged column j: sum_d u[d] staged[d][j] + staged[DIM][j]. The sum and the last
// term are often large and of opposite signs, so that beginning with the last term would round more.
INLINE ereal exponent(const ereal* u, const __local staged_real* staged, const uint j)
{
#if PRECISE == 1
    const __local float* low = staged + STAGED_PLANE;
    ereal e = e_constant(staged[DIM * STAGED_ROW + j], low[DIM * STAGED_ROW + j]);
#pragma unroll
    for (int d = 0; d < DIM; ++d)
        e = e_sum(e, e_product(u[d], e_constant(staged[d * STAGED_ROW + j],
                                                low[d * STAGED_ROW + j])));
#else
    ereal e = u[0] * staged[j];
#pragma unroll
    for (int d = 1; d < DIM; ++d)
        e += u[d] * staged[d * STAGED_ROW + j];
    e += staged[DIM * STAGED_ROW + j];
#endif
    return e;
}
#endif
