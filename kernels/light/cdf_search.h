// Selection of a light by inversion of a discrete CDF. Used by light.h, light_list.h and light_tree.h.
#pragma once
#include "util/math.h"

#if FEATURE_LIGHT_LIST || FEATURE_LIGHT_TREE
// Inversion item by item: subtracts the pmf of each from the random number until it is negative. The random number has
// 48 bits, as a double-float, so a pmf far below the last bit of the others is still sampled correctly, and what is
// left of the number has 24 bits or more.
typedef struct {
    float u, u_low;  // what is left of the random number is their sum
    uint item;       // the selected one; before that, or if rounding leaves u >= 0 to the end, the most probable so far
    float pmf;       // of `item`
    float remainder, remainder_low;  // what was left of the random number at `item` is their sum
} CdfSearch;

INLINE CdfSearch begin_cdf_search(float u, float u_low)
{
    CdfSearch s;
    s.u = u;
    s.u_low = u_low;
    s.item = 0u;
    s.pmf = s.remainder = s.remainder_low = 0.0f;
    return s;
}

INLINE void advance_cdf_search(CdfSearch* s, uint item, float pmf)
{
    const float remainder = s->u, remainder_low = s->u_low;
    const bool is_searching = remainder >= 0.0f;
    const float difference = s->u - pmf, rounding = (s->u - difference) - pmf, low = s->u_low + rounding;
    s->u = difference + low;
    s->u_low = low - (s->u - difference);
    const bool selects = is_searching && (s->u < 0.0f || pmf > s->pmf);
    s->item = selects ? item : s->item;
    s->pmf = selects ? pmf : s->pmf;
    s->remainder = selects ? remainder : s->remainder;
    s->remainder_low = selects ? remainder_low : s->remainder_low;
}

// The random number rescaled to [0, 1) within the selected light.
INLINE float rescaled_random(float remainder, float pmf)
{
    return pmf > 0.0f ? MIN(remainder / pmf, 0x1.fffffep-1f) : 0.0f;
}
#endif

#if !FEATURE_LIGHT_LIST && (FEATURE_LIGHT_TREE || (FEATURE_MANY_LIGHTS && FEATURE_NEXT_EVENT))
// The first step of a binary search: the largest power of two below `count`, at least 1.
INLINE uint first_search_step(uint count)
{
    uint step = 1u;
    while (2u * step < count) step *= 2u;
    return step;
}
#endif
