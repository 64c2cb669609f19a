// The stages over pixels, one program: compilers start slowly, and these three change together if at all.
#include "stages/list_samples.cl"
#include "stages/reduce.cl"
#include "stages/summarise.cl"
