"""The real-time executor: supervisor, control, observer, watchdog and tip controller as processes."""
