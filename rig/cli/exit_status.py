"""Exit statuses of the commands."""

DONE, FAULT, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
