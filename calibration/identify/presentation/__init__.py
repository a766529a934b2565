"""Results for readers: numbers, report, parameter file."""
