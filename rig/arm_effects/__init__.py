"""What the simulated arm does and the model does not assume; one file per effect, registered in `registry`."""
