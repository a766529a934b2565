"""The two ways to run the same steps: real time in processes, virtual time in one."""
