"""The commands of the command line: one module each, with `run(options)`, which returns the exit code."""

EXIT_DONE, EXIT_ERROR_NOT_MET, EXIT_BAD_INPUT = 0, 1, 2
"""`EXIT_ERROR_NOT_MET`: --error was given and not reached within the other limits. After a signal: 128 + its number."""
