// Vector arithmetic written out. A driver that keeps its library behind calls (PoCL 3.0 does, even for dot and fabs) pays more
// for the call than for the work; operators and casts are inlined everywhere. What is left of the library is rare or heavy.
#pragma once

// Functions of a few lines become part of their caller, so that results travel in registers. A build option may say otherwise,
// as it may of HAS_BUILTIN: tools that interpret kernels have neither.
#ifndef INLINE
#define INLINE inline __attribute__((always_inline))
#endif

// `<Record>_at(table, index)` functions: host/isonoise/device/program.py, `record_reader`.
#include "generated/records.h"

// Long functions of many callers stay functions: with textures in a dozen parameters of each of three materials `shade` took
// PoCL 46 s to compile, and takes 5.
#define NOINLINE static __attribute__((noinline, unused))

// Plain comparisons: one instruction where fmin and fmax need three for their NaN rules.
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

#ifdef HAS_BUILTIN
#elif defined(__has_builtin)
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
#define PREFETCH(buffer, at) __builtin_prefetch((const void*)((size_t)(buffer) + (at)))
#else
#define PREFETCH(buffer, at)
#endif

// Triples and the like are records of numbers, not OpenCL's vectors: a compiler that makes one vector instruction of the same
// operation of several paths (PoCL's does) has no lanes for vectors of vectors. C rounds no differently: each function stands
// for one operator, number by number. The members that nobody reads make a record longer than 16 bytes: shorter ones x86 hands
// to functions as pieces of registers, that is as vectors again.
typedef struct {
    float x, y;
    float unused[3];
} Vec2;

typedef struct {
    float x, y, z;
    float unused[2];
} Vec3;

typedef struct {
    float x, y, z, w;
    float unused;
} Vec4;

INLINE Vec2 vec2(float x, float y)
{
    Vec2 v;
    v.x = x;
    v.y = y;
    return v;
}

INLINE Vec3 vec3(float x, float y, float z)
{
    Vec3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

INLINE Vec4 vec4(float x, float y, float z, float w)
{
    Vec4 v;
    v.x = x;
    v.y = y;
    v.z = z;
    v.w = w;
    return v;
}

INLINE Vec3 xyz(Vec4 v)
{
    return vec3(v.x, v.y, v.z);
}

INLINE Vec4 vec4_from(Vec3 v, float w)
{
    return vec4(v.x, v.y, v.z, w);
}

INLINE Vec2 splat2(float s)
{
    return vec2(s, s);
}

INLINE Vec2 neg2(Vec2 v)
{
    return vec2(-v.x, -v.y);
}

INLINE Vec2 add2(Vec2 a, Vec2 b)
{
    return vec2(a.x + b.x, a.y + b.y);
}

INLINE Vec2 sub2(Vec2 a, Vec2 b)
{
    return vec2(a.x - b.x, a.y - b.y);
}

INLINE Vec2 scale2(Vec2 v, float s)
{
    return vec2(v.x * s, v.y * s);
}

INLINE Vec3 splat3(float s)
{
    return vec3(s, s, s);
}

INLINE Vec3 neg3(Vec3 v)
{
    return vec3(-v.x, -v.y, -v.z);
}

INLINE Vec3 add3(Vec3 a, Vec3 b)
{
    return vec3(a.x + b.x, a.y + b.y, a.z + b.z);
}

INLINE Vec3 sub3(Vec3 a, Vec3 b)
{
    return vec3(a.x - b.x, a.y - b.y, a.z - b.z);
}

INLINE Vec3 mul3(Vec3 a, Vec3 b)
{
    return vec3(a.x * b.x, a.y * b.y, a.z * b.z);
}

INLINE Vec3 div3(Vec3 a, Vec3 b)
{
    return vec3(a.x / b.x, a.y / b.y, a.z / b.z);
}

INLINE Vec3 scale3(Vec3 v, float s)
{
    return vec3(v.x * s, v.y * s, v.z * s);
}

// One division, which costs as much as a dozen products; |s| has to be above 2^-126, else its inverse is infinite.
INLINE Vec3 div_scalar3(Vec3 v, float s)
{
    return scale3(v, 1.0f / s);
}

INLINE Vec4 scale4(Vec4 v, float s)
{
    return vec4(v.x * s, v.y * s, v.z * s, v.w * s);
}

INLINE float dot3(Vec3 a, Vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE float dot2(Vec2 a, Vec2 b)
{
    return a.x * b.x + a.y * b.y;
}

INLINE float abs_float(float v)
{
    return as_float(as_uint(v) & 0x7FFFFFFFu);
}

INLINE Vec3 abs3(Vec3 v)
{
    return vec3(abs_float(v.x), abs_float(v.y), abs_float(v.z));
}

// |magnitude| with the sign of `sign`.
INLINE float copy_sign(float magnitude, float sign)
{
    return as_float((as_uint(magnitude) & 0x7FFFFFFFu) | (as_uint(sign) & 0x80000000u));
}

INLINE Vec3 copy_sign3(Vec3 magnitude, Vec3 sign)
{
    return vec3(copy_sign(magnitude.x, sign.x), copy_sign(magnitude.y, sign.y), copy_sign(magnitude.z, sign.z));
}

INLINE float max_component3(Vec3 v)
{
    return MAX(MAX(v.x, v.y), v.z);
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
} Float8Lanes;

typedef union {
    float4 all;
    float lane[4];
} Float4Lanes;

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
INLINE uint lowest_set_bit(uint bits)
{
#if HAS_BUILTIN(__builtin_ctz)
    return (uint)__builtin_ctz(bits);
#else
    return 31u - clz(bits & -bits);
#endif
}

// Three numbers from one place of an array on, and its i-th triple. Macros: the address space of `p` may be any.
#define LOAD3_AT(at, p) vec3((p)[(int)(at)], (p)[(int)(at) + 1], (p)[(int)(at) + 2])
#define LOAD3(i, p) LOAD3_AT(3 * (int)(i), p)

#define STORE3(v, i, p)                \
    do {                               \
        const Vec3 stored_ = (v);      \
        (p)[3 * (int)(i)] = stored_.x;      \
        (p)[3 * (int)(i) + 1] = stored_.y;  \
        (p)[3 * (int)(i) + 2] = stored_.z;  \
    } while (0)

#define ADD3(v, i, p) STORE3(add3(LOAD3(i, p), v), i, p)
