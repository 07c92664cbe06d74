// Stand-ins for a vendor's library of builtins, so that kernels compile alone for its cards: what
// cards have as instructions, and functions of float64 as polynomials of the usual length.

#define STAND_IN __attribute__((overloadable, always_inline))

#ifdef __NVPTX__
#define LOCAL_ID(dimension) __nvvm_read_ptx_sreg_tid_##dimension()
#define LOCAL_SIZE(dimension) __nvvm_read_ptx_sreg_ntid_##dimension()
#define GROUP_ID(dimension) __nvvm_read_ptx_sreg_ctaid_##dimension()
#define GROUP_COUNT(dimension) __nvvm_read_ptx_sreg_nctaid_##dimension()
STAND_IN void barrier(cl_mem_fence_flags flags) { __syncthreads(); }
STAND_IN float exp2(float x) { return __nvvm_ex2_approx_ftz_f(x); }
STAND_IN float log2(float x) { return __nvvm_lg2_approx_f(x); }
STAND_IN float sqrt(float x) { return __nvvm_sqrt_rn_f(x); }
STAND_IN double sqrt(double x) { return __nvvm_sqrt_rn_d(x); }
#else
#define LOCAL_ID(dimension) __builtin_amdgcn_workitem_id_##dimension()
#define LOCAL_SIZE(dimension) __builtin_amdgcn_workgroup_size_##dimension()
#define GROUP_ID(dimension) __builtin_amdgcn_workgroup_id_##dimension()
#define GROUP_COUNT(dimension) (__builtin_amdgcn_grid_size_##dimension() / LOCAL_SIZE(dimension))
STAND_IN void barrier(cl_mem_fence_flags flags)
{
    __builtin_amdgcn_fence(__ATOMIC_SEQ_CST, "workgroup");
    __builtin_amdgcn_s_barrier();
}
STAND_IN float exp2(float x) { return __builtin_exp2f(x); }
STAND_IN float log2(float x) { return __builtin_log2f(x); }
STAND_IN float sqrt(float x) { return __builtin_sqrtf(x); }
STAND_IN double sqrt(double x) { return __builtin_sqrt(x); }
#endif

#define OF_DIMENSION(name, macro) \
    STAND_IN size_t name(uint d) { return d == 0 ? macro(x) : d == 1 ? macro(y) : macro(z); }
#define GLOBAL_ID(dimension) (GROUP_ID(dimension) * LOCAL_SIZE(dimension) + LOCAL_ID(dimension))
#define GLOBAL_SIZE(dimension) (GROUP_COUNT(dimension) * LOCAL_SIZE(dimension))
OF_DIMENSION(get_local_id, LOCAL_ID)
OF_DIMENSION(get_group_id, GROUP_ID)
OF_DIMENSION(get_num_groups, GROUP_COUNT)
OF_DIMENSION(get_global_id, GLOBAL_ID)
OF_DIMENSION(get_global_size, GLOBAL_SIZE)

#define ORDERED(type) \
    STAND_IN type min(type a, type b) { return b < a ? b : a; } \
    STAND_IN type max(type a, type b) { return a < b ? b : a; } \
    STAND_IN type clamp(type x, type low, type high) { return min(max(x, low), high); }
ORDERED(int)
ORDERED(uint)
#define ORDERED_REAL(type, suffix) \
    STAND_IN type min(type a, type b) { return __builtin_fmin##suffix(a, b); } \
    STAND_IN type max(type a, type b) { return __builtin_fmax##suffix(a, b); } \
    STAND_IN type clamp(type x, type low, type high) { return min(max(x, low), high); }
ORDERED_REAL(float, f)
ORDERED_REAL(double, )
STAND_IN float2 clamp(float2 x, float2 low, float2 high)
{
    return (float2)(clamp(x.x, low.x, high.x), clamp(x.y, low.y, high.y));
}
STAND_IN uint abs(int x) { return x < 0 ? -x : x; }
STAND_IN ulong clz(ulong x) { return __builtin_clzl(x); }
STAND_IN ulong popcount(ulong x) { return __builtin_popcountl(x); }
STAND_IN float fabs(float x) { return __builtin_fabsf(x); }
STAND_IN float rint(float x) { return __builtin_rintf(x); }
STAND_IN float ceil(float x) { return __builtin_ceilf(x); }
STAND_IN float floor(float x) { return __builtin_floorf(x); }
STAND_IN float2 floor(float2 x) { return (float2)(floor(x.x), floor(x.y)); }
STAND_IN double fabs(double x) { return __builtin_fabs(x); }
STAND_IN double fmax(double a, double b) { return __builtin_fmax(a, b); }
STAND_IN double fmin(double a, double b) { return __builtin_fmin(a, b); }
STAND_IN float dot(float2 a, float2 b) { return a.x * b.x + a.y * b.y; }
STAND_IN float2 mix(float2 a, float2 b, float t) { return a + (b - a) * t; }
STAND_IN float4 mix(float4 a, float4 b, float t) { return a + (b - a) * t; }
STAND_IN float mix(float a, float b, float t) { return a + (b - a) * t; }
STAND_IN float select(float a, float b, int c) { return c ? b : a; }
STAND_IN int select(int a, int b, int c) { return c ? b : a; }

// The same for vectors of 2 and 4.
#define EACH_LANE(type, n, name) \
    STAND_IN type##n name(type##n x) \
    { \
        type##n y; \
        for (int i = 0; i < n; ++i) \
            y[i] = name(x[i]); \
        return y; \
    }
#define VECTORS_OF(n) \
    EACH_LANE(float, n, exp2) \
    EACH_LANE(float, n, ceil) \
    EACH_LANE(float, n, fabs) \
    LARGEST_OF(float, n) \
    LARGEST_OF(double, n) \
    LOADS_AND_STORES(float, n, __global) \
    LOADS_AND_STORES(float, n, __local) \
    LOADS_AND_STORES(float, n, __private) \
    LOADS_AND_STORES(double, n, __local) \
    STAND_IN double##n convert_double##n(float##n x) { return __builtin_convertvector(x, double##n); } \
    STAND_IN float##n convert_float##n(double##n x) { return __builtin_convertvector(x, float##n); }
#define LARGEST_OF(type, n) \
    STAND_IN type##n max(type##n a, type##n b) \
    { \
        type##n c; \
        for (int i = 0; i < n; ++i) \
            c[i] = max(a[i], b[i]); \
        return c; \
    }
#define LOADS_AND_STORES(type, n, space) \
    STAND_IN type##n vload##n(size_t place, const space type* from) \
    { \
        type##n x; \
        for (int i = 0; i < n; ++i) \
            x[i] = from[n * place + i]; \
        return x; \
    } \
    STAND_IN void vstore##n(type##n x, size_t place, space type* to) \
    { \
        for (int i = 0; i < n; ++i) \
            to[n * place + i] = x[i]; \
    }
VECTORS_OF(2)
VECTORS_OF(4)
STAND_IN int any(int2 x) { return (x.x | x.y) < 0; }
STAND_IN int any(int4 x) { return (x.x | x.y | x.z | x.w) < 0; }

STAND_IN double expm1(double x)
{
    double sum = 1.0;
    for (int n = 12; n > 1; --n)
        sum = 1.0 + x * sum / n;
    return x * sum;
}
STAND_IN double exp2(double x)
{
    const double whole = __builtin_rint(x);
    const double part = 1.0 + expm1((x - whole) * M_LN2);
    return part * as_double((ulong)((long)whole + 1023) << 52);
}
STAND_IN double exp(double x) { return exp2(x * M_LOG2E); }
STAND_IN double log2(double x)
{
    const ulong bits = as_ulong(x);
    const double y = as_double((bits & 0x000fffffffffffffUL) | 0x3ff0000000000000UL);
    const double s = (y - 1.0) / (y + 1.0);
    double sum = 0.0;
    for (int n = 15; n > 0; n -= 2)
        sum = sum * s * s + 1.0 / n;
    return (double)((long)(bits >> 52) - 1023) + 2.0 * M_LOG2E * s * sum;
}
STAND_IN double log(double x) { return M_LN2 * log2(x); }
