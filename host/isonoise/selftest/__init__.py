"""`isonoise selftest`: what kernels and allocation rules do at the edge of their numbers, on the user's device."""
