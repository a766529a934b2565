"""What the simulated arm does and the model does not assume."""
