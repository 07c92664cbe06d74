// Powers of two and their sums, in float32 or far more exact, as bounds of a transport value need.
//
// Included after row_loop.cl, whose exponents it sums.
//
// -D BOUNDED 0: float32.
//            1: in the width of the exponents, which must be PRECISE (see exponents.cl). With
//            float64 powers are exact to 2^-44 and additions to 2^-53, with unevaluated sums of
//            two float32 to 2^-31 and to 2^-45. The reference m of the powers is a whole number,
//            so that sums for another one are rescaled without an error.
//            2: exponents in float64 (PRECISE must be 2), their distances from m, the powers, and
//            sums of UNROLL powers in float32, and all other sums in float64. Between pairs of
//            tiles that the host chooses, exponents are float32 too (add_tile_in_float32).
// -D FLOAT32_UNROLL  columns taken together where exponents are float32, divides TILE
// -D MASKED_UNROLL   columns of a mask taken together (MASKED, see row_loop.cl), at most UNROLL

#if !defined(BOUNDED) || MASKED && !defined(MASKED_UNROLL) || BOUNDED == 2 && !defined(FLOAT32_UNROLL)
#error "BOUNDED, with it FLOAT32_UNROLL, and with MASKED also MASKED_UNROLL must be given, see above"
#endif

#if !BOUNDED
typedef vreal sreal;
#define NO_SUM ((vreal)(0.0f))
#define SUM_PLANES 1

// Powers of e are taken from a reference that is not under e, but for a rounding: e itself.
INLINE vreal about(const ereal e)
{
    return e_nearest(e);
}

INLINE vreal reference_for(const vreal highest)
{
    return highest;
}

// 2^(e - m) for e up to m.
INLINE sreal power_above(const ereal e, const vreal m)
{
    return exp2_nonpositive(e_above(e, m));
}

// s 2^n for n <= 0.
INLINE sreal rescaled(const sreal s, const vreal n)
{
    return s * exp2_nonpositive(n);
}

INLINE sreal sum_of(const sreal a, const sreal b)
{
    return a + b;
}

INLINE void store_sum(const sreal s, const size_t at, const size_t plane, __global float* p)
{
    VSTORE(s, at, p);
}
#else
typedef ereal sreal;
#define NO_SUM e_constant(0.0f, 0.0f)
#define SUM_PLANES 2

#if PRECISE == 2
#define AS_ULONGS(v) OF_LANES(as_ulong, WIDTH)(v)
#define AS_DOUBLES(v) OF_LANES(as_double, WIDTH)(v)
#endif

// A whole number not under x, but for a rounding of x.
INLINE vreal whole_above(const vreal x)
{
    return ceil(x + fabs(x) * 2.3841858e-7f);
}

// Powers of e are taken from a reference that is not under e, but for a rounding: a whole number.
INLINE vreal about(const ereal e)
{
#if PRECISE == 2
    return TO_VREAL(e);
#else
    return HIGH(e); // the sum of both parts stops a simulator (Oclgrind 21.10)
#endif
}

INLINE vreal reference_for(const vreal highest)
{
    return whole_above(highest);
}

// 2^n for a whole n <= 0; under -125 it is 2^-125.
INLINE vreal whole_power(const vreal n)
{
    const float magic = 12582912.0f; // 1.5 * 2^23: its low bits then hold n
    const vreal shifted = max(n, (vreal)(-125.0f)) + magic;
    return AS_VREAL((AS_VUINT(shifted) << 23) + 0x3f800000u);
}

// 2^(e - m) for e up to about m: the series of the exponential, to the term that the width can
// still tell, in the distance from the nearest whole number.
INLINE sreal power_above(const ereal e, const vreal m)
{
#if PRECISE == 2
    const double magic = 6755399441055744.0; // 1.5 * 2^52
    const ereal x = max(e - TO_EREAL(m), (ereal)(-1000.0));
    const ereal shifted = x + magic;
    const ereal r = x - (shifted - magic);
    ereal p = (ereal)(4.44553827187081e-10);
    p = p * r + 7.054911620801121e-09;
    p = p * r + 1.0178086009239696e-07;
    p = p * r + 1.3215486790144305e-06;
    p = p * r + 1.5252733804059838e-05;
    p = p * r + 0.00015403530393381606;
    p = p * r + 0.0013333558146428441;
    p = p * r + 0.009618129107628477;
    p = p * r + 0.055504108664821576;
    p = p * r + 0.2402265069591007;
    p = p * r + 0.6931471805599453;
    p = p * r + 1.0;
    return AS_DOUBLES(AS_ULONGS(p) + (AS_ULONGS(shifted) << 52));
#else
    const float magic = 12582912.0f;
    const ereal x = e_sum(e, e_pair(-m, (vreal)(0.0f)));
    const vreal high = max(HIGH(x), (vreal)(-125.0f));
    const vreal shifted = high + magic;
    const vreal rest = high - (shifted - magic);
    // Where high parts have canceled, the low one is no longer small beside it.
    const vreal low = select(LOW(x), (vreal)(0.0f), HIGH(x) < (vreal)(-125.0f));
    const vreal nearest = rest + low;
    const vreal t = nearest - rest;
    const ereal r = e_pair(nearest, (rest - (nearest - t)) + (low - t));
    vreal tail = (vreal)(1.0178086e-07f);
    tail = tail * HIGH(r) + 1.3215486e-06f;
    tail = tail * HIGH(r) + 1.5252734e-05f;
    tail = tail * HIGH(r) + 1.540353e-04f;
    tail = tail * HIGH(r) + 1.3333558e-03f;
    tail = tail * HIGH(r) + 9.618129e-03f;
    ereal p = e_pair(tail, (vreal)(0.0f));
    p = e_sum(e_product(p, r), e_constant(0.05550410971045494f, -1.0456333576769339e-09f));
    p = e_sum(e_product(p, r), e_constant(0.24022650718688965f, -2.277889543655931e-10f));
    p = e_sum(e_product(p, r), e_constant(0.6931471824645996f, -1.9046542121259336e-09f));
    p = e_sum(e_product(p, r), e_constant(1.0f, 0.0f));
    const vreal scale = AS_VREAL((AS_VUINT(shifted) << 23) + 0x3f800000u);
    return e_pair(HIGH(p) * scale, LOW(p) * scale);
#endif
}

// s 2^n for a whole n <= 0.
INLINE sreal rescaled(const sreal s, const vreal n)
{
#if PRECISE == 2
    return s * TO_EREAL(whole_power(n));
#else
    return e_pair(HIGH(s) * whole_power(n), LOW(s) * whole_power(n));
#endif
}

INLINE sreal sum_of(const sreal a, const sreal b)
{
    return e_sum(a, b);
}

// Both parts of s as float32: the nearest, and in the next plane what it rounds off.
INLINE void store_sum(const sreal s, const size_t at, const size_t plane, __global float* p)
{
    const vreal high = e_nearest(s);
    VSTORE(high, at, p);
#if PRECISE == 2
    VSTORE(TO_VREAL(s - TO_EREAL(high)), at + plane, p);
#else
    VSTORE((HIGH(s) - high) + LOW(s), at + plane, p);
#endif
}
#endif // BOUNDED

// Raise the maximum to that of further exponents, and rescale the sums of powers relative to it.
INLINE void raise_maximum(const vreal highest, vreal* maximum, sreal* sum, sreal* of_tile)
{
    const vreal m_new = max(*maximum, reference_for(highest));
    const vreal n = *maximum - m_new;
    *maximum = m_new;
#if MASKED // few columns are taken together: to ask whether the maximum has grown takes less time
    if (!ANY(n < 0.0f))
        return;
#endif
    *sum = rescaled(*sum, n);
    *of_tile = rescaled(*of_tile, n);
}

// Add some staged columns (see row_loop.cl), UNROLL at most, to the maximum m = max_j reference_for(e_ij) and
// to the sum of their tile. The sum over the tiles before, sum_j 2^(e_ij - m), is rescaled.
INLINE void add_columns(
    const ereal* u, const __local staged_real* staged, const uint* columns, const int count,
    vreal* maximum, sreal* sum, sreal* of_tile)
{
    ereal e[UNROLL];
    vreal highest = (vreal)(0.5f * SENTINEL);
#pragma unroll
    for (int c = 0; c < count; ++c) {
        e[c] = exponent(u, staged, columns[c]);
        highest = max(highest, about(e[c]));
    }
    raise_maximum(highest, maximum, sum, of_tile);
#if BOUNDED == 2
    vreal few = (vreal)(0.0f);
#pragma unroll
    for (int c = 0; c < count; ++c)
        few += exp2_nonpositive(e_above(e[c], *maximum));
    *of_tile += TO_EREAL(few);
#else
    sreal few = NO_SUM;
#pragma unroll
    for (int c = 0; c < count; ++c)
        few = sum_of(few, power_above(e[c], *maximum));
    *of_tile = sum_of(*of_tile, few);
#endif
}

#if TOPS
// The same where no exponent of the tile is above the maximum, with the same bits.
INLINE void add_columns_below(
    const ereal* u, const __local staged_real* staged, const uint* columns, const int count,
    vreal* maximum, sreal* sum, sreal* of_tile)
{
    const vreal m = *maximum;
    sreal few = NO_SUM;
#pragma unroll
    for (int c = 0; c < count; ++c)
        few = sum_of(few, power_above(exponent(u, staged, columns[c]), m));
    *of_tile = sum_of(*of_tile, few);
}
#endif

// Add the needed columns of a tile by a function that adds some: all columns, or with MASKED those of `mask`.
#define ADD_ALL(add, unroll)                                                                   \
    for (uint j = 0; j < TILE; j += (unroll)) {                                                \
        uint columns[unroll];                                                                  \
        for (int c = 0; c < (unroll); ++c)                                                     \
            columns[c] = j + c;                                                                \
        add(u, staged, columns, unroll, &m, &s, &s_tile);                                      \
    }
#if MASKED
#define ADD_NEEDED(add, unroll)                                                                \
    if (is_full(mask)) {                                                                       \
        ADD_ALL(add, unroll)                                                                   \
    } else {                                                                                   \
        for (uint w = 0; w < MASK_WORDS; ++w) {                                                \
            for (ulong bits = mask[w]; bits;) {                                                \
                uint columns[MASKED_UNROLL];                                                   \
                for (int c = 0; c < MASKED_UNROLL; ++c)                                        \
                    columns[c] = take_column(&bits, 64 * w);                                   \
                add(u, staged, columns, MASKED_UNROLL, &m, &s, &s_tile);                       \
            }                                                                                  \
        }                                                                                      \
    }
#else
#define ADD_NEEDED ADD_ALL
#endif

// Add the staged columns to m and s, but for the sum over these columns themselves, which is returned:
// sums of sums round less than one long sum. With `is_below` no exponent is above m.
INLINE sreal add_tile(
    const ereal* u, const __local staged_real* staged, const __global ulong* mask,
    const bool is_below, vreal* maximum, sreal* sum)
{
    vreal m = *maximum;
    sreal s = *sum;
    sreal s_tile = NO_SUM;
#if TOPS
    if (is_below) {
        ADD_NEEDED(add_columns_below, UNROLL)
        return s_tile;
    }
#endif
    ADD_NEEDED(add_columns, UNROLL)
    *maximum = m;
    *sum = s;
    return s_tile;
}

#if BOUNDED == 2
// The staged columns, rounded to float32.
INLINE void stage_in_float32(
    const __local staged_real* staged, __local float* rounded)
{
    for (uint j = get_local_id(0) * WIDTH; j < TILE; j += GROUP * WIDTH) {
        for (int d = 0; d <= DIM; ++d)
            VSTORE(TO_VREAL(VLOAD(0, staged + d * STAGED_ROW + j)), 0, rounded + d * STAGED_ROW + j);
    }
}

// As add_columns and exponent (exponents.cl), in float32.
INLINE void add_columns_in_float32(
    const vreal* u, const __local float* staged, const uint* columns, const int count,
    vreal* maximum, sreal* sum, sreal* of_tile)
{
    vreal e[FLOAT32_UNROLL];
    vreal highest = (vreal)(0.5f * SENTINEL);
#pragma unroll
    for (int c = 0; c < count; ++c) {
        e[c] = u[0] * staged[columns[c]];
#pragma unroll
        for (int d = 1; d < DIM; ++d)
            e[c] += u[d] * staged[d * STAGED_ROW + columns[c]];
        e[c] += staged[DIM * STAGED_ROW + columns[c]];
        highest = max(highest, e[c]);
    }
    raise_maximum(highest, maximum, sum, of_tile);
    vreal few = (vreal)(0.0f);
#pragma unroll
    for (int c = 0; c < count; ++c)
        few += exp2_nonpositive(e[c] - *maximum);
    *of_tile += TO_EREAL(few);
}

// As add_tile, with exponents in float32.
INLINE sreal add_tile_in_float32(
    const vreal* u, const __local float* staged, const __global ulong* mask, vreal* maximum,
    sreal* sum)
{
    vreal m = *maximum;
    sreal s = *sum;
    sreal s_tile = NO_SUM;
    ADD_NEEDED(add_columns_in_float32, FLOAT32_UNROLL)
    *maximum = m;
    *sum = s;
    return s_tile;
}
#endif
