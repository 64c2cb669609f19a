// Double-float arithmetic: sums of two floats (high, low) with 48 bits of precision. Used by the statistics kernels.
// Needs a build without contraction and without fast-math.
// Knuth, TAOCP vol. 2, 4.2.2 (two_sum).
// Dekker, "A floating-point technique for extending the available precision", 1971.
#pragma once
#include "util/vec.h"

typedef struct {
    float high, low;
    float padding[3];  // never read; keeps the struct out of vector registers, as in util/vec.h
} Compensated;

// a + b exactly, as the rounded sum and its rounding error. If the sum overflows, the error is 0, not NaN.
INLINE Compensated two_sum(float a, float b)
{
    const float sum = a + b;
    const float b_part = sum - a;
    const float error = (a - (sum - b_part)) + (b - b_part);
    const Compensated result = {sum, !is_finite(sum) ? 0.0f : error};
    return result;
}

// The same for |a| >= |b| or a = 0.
INLINE Compensated quick_two_sum(float a, float b)
{
    const float sum = a + b;
    const Compensated result = {sum, !is_finite(sum) ? 0.0f : b - (sum - a)};
    return result;
}

INLINE Compensated add_compensated(Compensated a, float b)
{
    const Compensated sum = two_sum(a.high, b);
    return quick_two_sum(sum.high, sum.low + a.low);
}

// a + b without normalisation: the low part adds up the rounding errors, for a few additions. `normalize_sum` after
// them. Nothing may overflow.
INLINE Compensated add_error_free(Compensated a, float b)
{
    const float sum = a.high + b;
    const float b_part = sum - a.high;
    const Compensated result = {sum, a.low + ((a.high - (sum - b_part)) + (b - b_part))};
    return result;
}

INLINE Compensated normalize_sum(Compensated a)
{
    return quick_two_sum(a.high, a.low);
}

// a / n. An integer n above 2^24 may not be exact as one float, so it is split in two.
INLINE Compensated divide_compensated(Compensated a, uint n)
{
    const float n_high = (float)(n & 0xFFFFF000u), n_low = (float)(n & 0xFFFu);
    const float inverse = 1.0f / (n_high + n_low);
    const float quotient = a.high * inverse;
    const float remainder = FMA(-quotient, n_low, FMA(-quotient, n_high, a.high)) + a.low;
    return quick_two_sum(quotient, remainder * inverse);
}
