"""The virtual-time executor: plant and control in this process, rendering and vision in two child processes."""
