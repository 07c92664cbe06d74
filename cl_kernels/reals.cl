// The numbers of iterations on the device: float64, or unevaluated sums of two float32 (about 46 bits) for devices
// without it, as in exponents.cl. The kernels call functions for all arithmetic, so that formulas stand once.
//
//   real, reals           one number, and LANES of them: of as many entries of a vector
//   PLUS .. LARGER        of two numbers of the same type;  BELOW(x, y, a, b): a where x < y, else b
//   EXP .. ROOT           exp(x), expm1(x), log(x), 2^x, log2(x), the square root
//   REAL, REALS, SPREAD   of a float32 constant, and of one number for all lanes;  TO_REALS, TO_VSINGLE: float32
//
// Pairs: Dekker, "A floating-point technique for extending the available precision" (1971). Their exponents end at
// 2^-126 and 2^127, so that the parts of numbers below 2^-100 lose digits.
//
// -D FLOAT64  1: float64; 0: pairs of float32
// -D LANES    numbers that a work-item takes at once: float64 lanes on CPUs, else 1; divides TILE

#if !defined(LANES) || !defined(FLOAT64)
#error "LANES and FLOAT64 must be given, see above"
#endif
typedef OF_LANES(float, LANES) vsingle;
#if LANES == 1
#define DLOAD(i, p) ((p)[i])
#define DSTORE(v, i, p) ((p)[i] = (v))
#else
#define DLOAD(i, p) CONCAT(vload, LANES)(0, (p) + (i))
#define DSTORE(v, i, p) CONCAT(vstore, LANES)((v), 0, (p) + (i))
#endif

#if FLOAT64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef OF_LANES(double, LANES) reals;
#if LANES == 1
// Casts: clang has no built-in function of one lane for NVPTX, and Intel's compiler, with one, computes wrongly.
#define TO_REALS(v) ((double)(v))
#define TO_VSINGLE(v) ((float)(v))
#else
#define TO_REALS(v) CONCAT(convert_double, LANES)(v)
#define TO_VSINGLE(v) CONCAT(convert_float, LANES)(v)
#endif
#define REAL(x) ((double)(x))
#define REALS(x) ((reals)((double)(x)))
#define SPREAD(x) ((reals)(x))
#define TO_SINGLE(x) ((float)(x))
#define OF_BITS(low, high) as_double(((ulong)(high) << 32) | (low))
#define PLUS(a, b) ((a) + (b))
#define MINUS(a, b) ((a) - (b))
#define TIMES(a, b) ((a) * (b))
#define OVER(a, b) ((a) / (b))
#define NEGATIVE(a) (-(a))
#define SIZE(a) fabs(a)
#define LARGER(a, b) fmax(a, b)
#define SMALLER(a, b) fmin(a, b)
#define EXP(x) exp(x)
#define EXPM1(x) expm1(x)
#define EXP2(x) exp2(x)
#define LOG(x) log(x)
#define LOG2(x) log2(x)
#define ROOT(x) sqrt(x)
#define BELOW(x, y, a, b) ((x) < (y) ? (a) : (b))
#define IS_BELOW(x, y) ((x) < (y))
#define LEAST_REAL DBL_MIN
#define ONE_AND(tiny_trillionths) (1.0 + 1e-12 * (double)(tiny_trillionths))
#else
#define double float64_is_missing // so that nothing takes it by mistake
#pragma OPENCL FP_CONTRACT OFF // an error term must belong to the rounding that made it
#if LANES != 1
#error "LANES must be 1 for pairs of float32"
#endif
typedef struct { float x, y; } real; // the number, rounded, and what this rounds off: no vector, whose + is another
typedef real reals;
#define REAL(x) (r_pair((float)(x), 0.0f))
#define REALS(x) REAL(x)
#define SPREAD(x) (x)
#define TO_REALS(v) REAL(v)
#define TO_VSINGLE(v) ((v).x + (v).y)
#define TO_SINGLE(x) TO_VSINGLE(x)
#define OF_BITS(low, high) (r_pair(as_float(low), as_float(high)))
#define EXP(x) r_power_of_e(x, false)
#define EXPM1(x) r_power_of_e(x, true)
#define EXP2(x) EXP(TIMES(x, r_pair(0.69314718f, -1.9046542e-9f)))
#define LOG2(x) TIMES(LOG(x), r_pair(1.442695f, 1.925963e-8f))
#define MINUS(a, b) PLUS(a, NEGATIVE(b))
#define BELOW(x, y, a, b) (IS_BELOW(x, y) ? (a) : (b))
#define LEAST_REAL REAL(FLT_MIN)
#define ONE_AND(tiny_trillionths) (r_pair(1.0f, 1e-12f * (float)(tiny_trillionths)))

// Compilers would take minutes for as many copies of a longer function as there are calls.
#define FUNCTION static __attribute__((noinline))

INLINE real r_pair(const float high, const float low)
{
    real pair;
    pair.x = high;
    pair.y = low;
    return pair;
}

INLINE real NEGATIVE(const real a) { return r_pair(-a.x, -a.y); }

INLINE real r_exact_sum(const float a, const float b)
{
    const float sum = a + b, of_b = sum - a;
    return r_pair(sum, (a - (sum - of_b)) + (b - of_b));
}

INLINE real PLUS(const real a, const real b)
{
    const real high = r_exact_sum(a.x, b.x);
    return r_exact_sum(high.x, high.y + (a.y + b.y));
}

INLINE real TIMES(const real a, const real b)
{
    const float high = a.x * b.x;
    return r_exact_sum(high, fma(a.x, b.x, -high) + (a.x * b.y + a.y * b.x));
}

INLINE real OVER(const real a, const real b)
{
    const float high = a.x / b.x;
    const real rest = MINUS(a, TIMES(b, REAL(high)));
    return r_exact_sum(high, rest.x / b.x);
}

INLINE bool IS_BELOW(const real a, const real b)
{
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

INLINE real LARGER(const real a, const real b) { return IS_BELOW(a, b) ? b : a; }
INLINE real SMALLER(const real a, const real b) { return IS_BELOW(b, a) ? b : a; }
INLINE real SIZE(const real a) { return a.x < 0.0f ? NEGATIVE(a) : a; }

INLINE real ROOT(const real x)
{
    const float near = sqrt(x.x);
    return x.x > 0.0f
        ? PLUS(REAL(near), REAL(TO_SINGLE(MINUS(x, TIMES(REAL(near), REAL(near)))) / (2.0f * near))) : REAL(0);
}

// e^x, or e^x - 1 without cancellation, for x up to 88: x = n log(2) + 16 r, the series of e^r - 1, and e^2r - 1
// from it four times.
FUNCTION real r_power_of_e(const real given, const bool less_one)
{
    const real x = LARGER(given, REAL(-87));
    const float n = rint(1.442695f * x.x);
    real r = PLUS(x, REAL(-0.69314575f * n)); // of 16 bits, so that the product is exact
    r = MINUS(r, TIMES(REAL(n), r_pair(1.4286068e-6f, 5.497923e-14f)));
    r = r_pair(0.0625f * r.x, 0.0625f * r.y);
    real p = REAL((1.984127e-4f * r.x + 1.3888889e-3f) * r.x + 8.333333e-3f);
    p = PLUS(TIMES(p, r), r_pair(0.041666668f, -1.2417635e-9f));
    p = PLUS(TIMES(p, r), r_pair(0.16666667f, -4.967054e-9f));
    p = PLUS(TIMES(p, r), REAL(0.5f));
    p = PLUS(TIMES(p, r), REAL(1));
    p = TIMES(p, r);
    for (int k = 0; k < 4; ++k)
        p = PLUS(r_pair(2.0f * p.x, 2.0f * p.y), TIMES(p, p));
    const float scale = as_float(((int)n + 127) << 23);
    const real less = r_pair(scale * p.x, scale * p.y);
    if (less_one)
        return PLUS(less, PLUS(REAL(scale), REAL(-1)));
    return given.x < -87.0f ? REAL(0) : PLUS(REAL(scale), less);
}

// log(x) from that in float32, by a step of Newton's method and the next term.
FUNCTION real LOG(const real x)
{
    const real near = REAL(log(x.x));
    const real off = PLUS(TIMES(x, EXP(NEGATIVE(near))), REAL(-1));
    return PLUS(near, MINUS(off, REAL(0.5f * off.x * off.x)));
}
#endif
