"""What numba compiles, and nothing else."""
