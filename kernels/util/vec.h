// Scalar and vector arithmetic, included by every kernel file.
// It is written out because PoCL 3.0 calls its library even for dot and fabs, and the call costs more than the work.
// Operators and casts are inlined everywhere. Library functions are used only where they are rare or expensive.
#pragma once

// Inlined functions return their results in registers. A build option may replace INLINE and HAS_BUILTIN: tools that
// interpret kernels support neither.
#ifndef INLINE
#define INLINE inline __attribute__((always_inline))
#endif

// `<Record>_at(table, index)` functions: host/isonoise/device/program.py, `record_reader`.
#include "generated/records.h"

// For long functions with many callers. PoCL compiled `shade`, with textures in a dozen parameters of each of three
// materials, in 46 s with these functions inlined and in 5 s without.
#define NOINLINE static __attribute__((noinline, unused))

// One instruction each; fmin and fmax need three because of their rules for NaN.
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

#ifdef HAS_BUILTIN
#elif defined(__has_builtin) && !defined(NO_BUILTINS)
#define HAS_BUILTIN(name) __has_builtin(name)
#else
#define HAS_BUILTIN(name) 0
#endif

#if HAS_BUILTIN(__builtin_sqrtf)
#define SQRT(x) __builtin_sqrtf(x)
#else
#define SQRT(x) sqrt(x)
#endif

// On PoCL a call of `fma` costs several times as much as the instruction.
#ifdef __FMA__
#define FMA(a, b, c) __builtin_fmaf(a, b, c)
#else
#define FMA(a, b, c) fma(a, b, c)
#endif

// a * b + c for 8 or 4 vector lanes of `a` and scalars b, c: rounded once where the device has a fast fma, else twice.
#if defined(__FMA__) && HAS_BUILTIN(__builtin_ia32_vfmaddps256)
#define MAD8(a, b, c) __builtin_ia32_vfmaddps256(a, (float8)(b), (float8)(c))
#define MAD4(a, b, c) __builtin_ia32_vfmaddps(a, (float4)(b), (float4)(c))
#elif defined(FP_FAST_FMAF)
#define MAD8(a, b, c) fma(a, (float8)(b), (float8)(c))
#define MAD4(a, b, c) fma(a, (float4)(b), (float4)(c))
#else
#define MAD8(a, b, c) ((a) * (b) + (c))
#define MAD4(a, b, c) ((a) * (b) + (c))
#endif

// Before a loop over pixels whose iterations are independent. PoCL does not vectorise across work-items, but such loops.
#if defined(__clang__) && (defined(__x86_64__) || defined(__aarch64__))
#define VECTORIZE_PIXELS _Pragma("clang loop vectorize(assume_safety) interleave(disable)")
#pragma clang diagnostic ignored "-Wpass-failed"  // a loop that is not vectorised is slow, not wrong
#else
#define VECTORIZE_PIXELS
#endif

// Before a loop whose iterations would need too many registers side by side.
#define NO_UNROLL _Pragma("unroll 1")

// Prefetches the cache line at `byte_offset` of a buffer, on CPUs: there a work-item would wait for it.
#if (defined(__x86_64__) || defined(__aarch64__)) && HAS_BUILTIN(__builtin_prefetch)
#define PREFETCH(buffer, byte_offset) __builtin_prefetch((const void*)((size_t)(buffer) + (byte_offset)))
#else
#define PREFETCH(buffer, byte_offset)
#endif

// Structs of scalars, not OpenCL vectors: LLVM vectorises loops over paths, and it cannot vectorise operations that are
// vectors already. Each function below is one operator, applied per component, so rounding is that of C.
// `padding` is never read. It makes the structs longer than 16 bytes: x86 passes shorter ones in vector registers.
typedef struct {
    float x, y;
    float padding[3];
} Vec2;

typedef struct {
    float x, y, z;
    float padding[2];
} Vec3;

typedef struct {
    float x, y, z, w;
    float padding;
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

// One division, which costs as much as a dozen multiplications. |s| must be above 2^-126, else its inverse is infinite.
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

// Tests the bits: a compiler may fold isfinite away.
INLINE bool is_finite(float x)
{
    return (as_uint(x) & 0x7F800000u) != 0x7F800000u;
}

// Vectors whose elements (vector lanes) can be accessed by index.
typedef union {
    float8 vector;
    float lane[8];
} Float8Lanes;

typedef union {
    float4 vector;
    float lane[4];
} Float4Lanes;

// One bit per vector lane of a mask. Builtins need one or two instructions.
INLINE uint mask_bits(int8 mask)
{
#if defined(__AVX512VL__) && defined(__AVX512DQ__) && HAS_BUILTIN(__builtin_ia32_cvtd2mask256)
    return (uint)(uchar)__builtin_ia32_cvtd2mask256(mask);
#elif defined(__AVX__) && HAS_BUILTIN(__builtin_ia32_movmskps256)
    return (uint)__builtin_ia32_movmskps256(as_float8(mask));
#else
    const int8 lanes = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 half_lanes = lanes.lo | lanes.hi;
    const int2 quarter_lanes = half_lanes.lo | half_lanes.hi;
    return (uint)(quarter_lanes.x | quarter_lanes.y);
#endif
}

INLINE uint mask_bits4(int4 mask)
{
    const int4 lanes = mask & (int4)(1, 2, 4, 8);
    const int2 half_lanes = lanes.lo | lanes.hi;
    return (uint)(half_lanes.x | half_lanes.y);
}

// Number of leading zero bits; `bits` must not be 0.
INLINE uint leading_zeros(uint bits)
{
#if HAS_BUILTIN(__builtin_clz)
    return (uint)__builtin_clz(bits);
#else
    return clz(bits);
#endif
}

// Index of the lowest set bit; `bits` must not be 0.
INLINE uint lowest_set_bit(uint bits)
{
#if HAS_BUILTIN(__builtin_ctz)
    return (uint)__builtin_ctz(bits);
#else
    return 31u - clz(bits & -bits);
#endif
}

// The three floats from `offset` on, and the i-th triple of an array. Macros, so that `p` may have any address space.
#define LOAD3_AT(offset, p) vec3((p)[(int)(offset)], (p)[(int)(offset) + 1], (p)[(int)(offset) + 2])
#define LOAD3(i, p) LOAD3_AT(3 * (int)(i), p)

#define STORE3(v, i, p)                    \
    do {                                   \
        const Vec3 stored_ = (v);          \
        (p)[3 * (int)(i)] = stored_.x;     \
        (p)[3 * (int)(i) + 1] = stored_.y; \
        (p)[3 * (int)(i) + 2] = stored_.z; \
    } while (0)

#define ADD3(v, i, p) STORE3(add3(LOAD3(i, p), v), i, p)
