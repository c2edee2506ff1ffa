"""Exit codes of every command.

`foundation.errors` has the exit code of each exception. `scenario.verdict` has the exit code of a
run.
"""

DONE = 0
BAD_INPUT = 2
STOPPED = 3
"""A run diverged unexpectedly, failed or was interrupted, or its results could not be written."""
