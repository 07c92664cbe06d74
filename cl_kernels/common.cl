// Vector type, sentinel and base-2 exponential shared by every kernel.
//
// -D WIDTH=w       lanes of one work-item: 1 on GPUs, the native vector on CPUs.
//                  CPU compilers need the explicit vector; GPU compilers the scalar.
// -D EXP2_BUILTIN  1: the device's exp2(); 0 (default): a polynomial, which CPU
//                  compilers keep in vector registers.
// -D SENTINEL=x    stands for minus infinity; finite, so that the difference of two
//                  sentinels is a number.

#if !defined(WIDTH) || !defined(SENTINEL)
#error "WIDTH and SENTINEL must be given, see above"
#endif
#ifndef EXP2_BUILTIN
#define EXP2_BUILTIN 0
#endif

// Helpers take and return vectors wider than a processor's registers may be. Clang warns that such
// calls depend on the processor. INLINE leaves no call: where PoCL 3.1 left one, results were NaN.
#ifdef __clang__
#pragma clang diagnostic ignored "-Wpsabi"
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

#define CONCAT_(a, b) a##b
#define CONCAT(a, b) CONCAT_(a, b)

// A type or a function of so many lanes: its name ends with their number, but for one lane.
#define OF_LANES(name, lanes) CONCAT(OF_LANES_, lanes)(name)
#define OF_LANES_1(name) name
#define OF_LANES_2(name) name##2
#define OF_LANES_4(name) name##4
#define OF_LANES_8(name) name##8
#define OF_LANES_16(name) name##16

typedef OF_LANES(float, WIDTH) vreal;
typedef OF_LANES(int, WIDTH) vint;
#define AS_VUINT(v) OF_LANES(as_uint, WIDTH)(v)
#define AS_VREAL(v) OF_LANES(as_float, WIDTH)(v)
#if WIDTH == 1
#define VLOAD(offset, p) ((p)[offset])
#define VSTORE(v, offset, p) ((p)[offset] = (v))
#define ANY(v) (v)
#else
#define VLOAD(offset, p) CONCAT(vload, WIDTH)(0, (p) + (offset))
#define VSTORE(v, offset, p) CONCAT(vstore, WIDTH)((v), 0, (p) + (offset))
#define ANY(v) any(v)
#endif

// 2^x for x <= 0 (or above it by a rounding). Arguments under -125 give a number below 2^-124 instead of zero:
// every sum this feeds holds a term 1, or is compared with one.
// Polynomial: degree 5, minimax in relative error (2.3e-7 in float32) on [-1/2, 1/2];
// the nearest integer comes from adding 1.5 * 2^23, whose low bits then are that integer.
INLINE vreal exp2_nonpositive(vreal x)
{
#if EXP2_BUILTIN
    return exp2(x);
#else
    const float magic = 12582912.0f;
    x = max(x, (vreal)(-125.0f));
    const vreal shifted = x + magic;
    const vreal r = x - (shifted - magic);
    vreal p = 1.3276472454890609e-3f;
    p = p * r + 9.675541892647743e-3f;
    p = p * r + 5.550713092088699e-2f;
    p = p * r + 2.4022120237350464e-1f;
    p = p * r + 6.931469440460205e-1f;
    p = p * r + 1.0f;
    return AS_VREAL(AS_VUINT(p) + (AS_VUINT(shifted) << 23)); // unsigned: overflow is defined
#endif
}
