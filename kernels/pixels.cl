// The stages over pixels, one program: compilers start slowly, and these three change together if at all.
#include "list_samples.cl"
#include "reduce.cl"
#include "summarise.cl"
