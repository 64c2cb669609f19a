// Transmittance of a rough dielectric coat, from the tables of host/isonoise/scene/material/rough_transmittance.py.
#pragma once
#include "bsdf/context.h"

#if HAS_ROUGH_TRANSMITTANCE
#define ROUGH_TRANSMITTANCE_NODES 64  // NODES of that file

// Share of the light that the coat transmits, interpolated in table number `table` over the cosine.
INLINE float rough_transmittance(const BsdfContext* ctx, uint table, float cos_w)
{
    __global const float* nodes = ctx->rough_transmittances + ROUGH_TRANSMITTANCE_NODES * table;
    const float place = cos_w * (ROUGH_TRANSMITTANCE_NODES - 1);
    const int node = MIN((int)place, ROUGH_TRANSMITTANCE_NODES - 2);
    return nodes[node] + (place - (float)node) * (nodes[node + 1] - nodes[node]);
}
#endif
