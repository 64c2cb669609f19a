"""The names of the samplers, which `kernels/util/random.h` implements."""

SAMPLERS = ("sobol", "independent")
"""`sobol`: Owen-scrambled (0,2)-sequences, the default. `independent`: independent random numbers."""
