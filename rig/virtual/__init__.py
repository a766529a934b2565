"""The virtual-time executor: plant and control in this process, rendering and vision in a child process."""
