// Vector arithmetic written out. A driver that keeps its library behind calls (PoCL 3.0 does, even for dot and fabs) pays more
// for the call than for the work; operators and casts are inlined everywhere. What is left of the library is rare or heavy.
#pragma once

// Functions of a few lines become part of their caller, so that results travel in registers.
#define INLINE static inline __attribute__((always_inline))

// Long functions of many callers stay functions: with textures in a dozen parameters of each of three materials `shade` took
// PoCL 46 s to compile, and takes 5.
#define OUTLINE static __attribute__((noinline, unused))

// Plain comparisons: one instruction where fmin and fmax need three for their NaN rules.
#define LESSER(a, b) ((a) < (b) ? (a) : (b))
#define GREATER(a, b) ((a) > (b) ? (a) : (b))

#ifdef __has_builtin
#define HAS_BUILTIN(name) __has_builtin(name)
#else
#define HAS_BUILTIN(name) 0
#endif

#if HAS_BUILTIN(__builtin_sqrtf)
#define SQRT(x) __builtin_sqrtf(x)
#else
#define SQRT(x) sqrt(x)
#endif

// A call to `fma` costs PoCL several times what the instruction does.
#ifdef __FMA__
#define FMA(a, b, c) __builtin_fmaf(a, b, c)
#else
#define FMA(a, b, c) fma(a, b, c)
#endif

// 8 lanes times a scalar and a scalar: rounded once where that costs nothing, else twice.
#if defined(__FMA__) && HAS_BUILTIN(__builtin_ia32_vfmaddps256)
#define MAD8(a, b, c) __builtin_ia32_vfmaddps256(a, (float8)(b), (float8)(c))
#elif defined(FP_FAST_FMAF)
#define MAD8(a, b, c) fma(a, (float8)(b), (float8)(c))
#else
#define MAD8(a, b, c) ((a) * (b) + (c))
#endif

// Has the cache line at byte `at` of a buffer fetched, where a work-item runs on a core of its own and would wait for it.
#if (defined(__x86_64__) || defined(__aarch64__)) && HAS_BUILTIN(__builtin_prefetch)
#define FETCH_AHEAD(buffer, at) __builtin_prefetch((const void*)((size_t)(buffer) + (at)))
#else
#define FETCH_AHEAD(buffer, at)
#endif

INLINE float dot3(float3 a, float3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE float dot2(float2 a, float2 b)
{
    return a.x * b.x + a.y * b.y;
}

INLINE float abs1(float v)
{
    return as_float(as_uint(v) & 0x7FFFFFFFu);
}

INLINE float3 abs3(float3 v)
{
    return as_float3(as_uint3(v) & 0x7FFFFFFFu);
}

// |magnitude| with the sign of `sign`.
INLINE float with_sign(float magnitude, float sign)
{
    return as_float((as_uint(magnitude) & 0x7FFFFFFFu) | (as_uint(sign) & 0x80000000u));
}

INLINE float3 with_sign3(float3 magnitude, float3 sign)
{
    return as_float3((as_uint3(magnitude) & 0x7FFFFFFFu) | (as_uint3(sign) & 0x80000000u));
}

INLINE float largest(float3 v)
{
    return GREATER(GREATER(v.x, v.y), v.z);
}

// By the bits: a compiler may fold isfinite away.
INLINE bool is_finite(float x)
{
    return (as_uint(x) & 0x7F800000u) != 0x7F800000u;
}

// Lanes by number.
typedef union {
    float8 all;
    float lane[8];
} Lanes;

typedef union {
    float4 all;
    float lane[4];
} FourLanes;

// The lanes of a mask as bits: one or two instructions where the compiler can be told which.
INLINE uint mask_bits(int8 mask)
{
#if defined(__AVX512VL__) && defined(__AVX512DQ__) && HAS_BUILTIN(__builtin_ia32_cvtd2mask256)
    return (uint)(uchar)__builtin_ia32_cvtd2mask256(mask);
#elif defined(__AVX__) && HAS_BUILTIN(__builtin_ia32_movmskps256)
    return (uint)__builtin_ia32_movmskps256(as_float8(mask));
#else
    const int8 lanes = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 half_lanes = lanes.lo | lanes.hi;
    const int2 quarter = half_lanes.lo | half_lanes.hi;
    return (uint)(quarter.x | quarter.y);
#endif
}

// Place of the lowest bit of a number that is not zero.
INLINE uint lowest_bit(uint bits)
{
#if HAS_BUILTIN(__builtin_ctz)
    return (uint)__builtin_ctz(bits);
#else
    return 31u - clz(bits & -bits);
#endif
}

// The i-th triple of an array without padding. Macros: the address space of `p` may be any.
#define LOAD3(i, p) ((float3)((p)[3 * (i)], (p)[3 * (i) + 1], (p)[3 * (i) + 2]))
#define LOAD3U(i, p) ((uint3)((p)[3 * (i)], (p)[3 * (i) + 1], (p)[3 * (i) + 2]))

INLINE void store3(float3 v, uint i, __global float* p)
{
    p[3 * i] = v.x;
    p[3 * i + 1] = v.y;
    p[3 * i + 2] = v.z;
}
