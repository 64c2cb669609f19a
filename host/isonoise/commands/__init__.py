"""The commands of the command line: one module each, with `run(options)`, which returns the exit code."""

EXIT_DONE, EXIT_ERROR_NOT_MET, EXIT_BAD_INPUT, EXIT_INTERNAL_ERROR = 0, 1, 2, 70
"""`EXIT_ERROR_NOT_MET`: --error was given and not reached within the other limits. `EXIT_BAD_INPUT`: also a file or
standard output that could not be written. `EXIT_INTERNAL_ERROR`: EX_SOFTWARE of BSD's sysexits.h. After a signal:
128 + its number."""
