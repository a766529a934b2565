"""The virtual-time executor: the whole run in one process."""
